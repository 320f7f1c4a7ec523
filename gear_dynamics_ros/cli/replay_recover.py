"""``replay recover``: a whole recording of a broken one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from gear_dynamics_ros.cli.common import Progress
from gear_dynamics_ros.recording.recover import PartReport, Report, Span, default_target, recover


def add_recover(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb."""
    verb = verbs.add_parser("recover", help="make a whole recording of what a broken one still holds")
    verb.add_argument("bag", metavar="BAG", help="broken recording, only read: a folder or an .mcap file")
    verb.add_argument("--output", metavar="DIR", help="new folder (default: BAG with _recovered)")
    verb.set_defaults(command=recover_bag)


def recover_bag(arguments: argparse.Namespace) -> int:
    """Recover the recording and tell what was kept and lost."""
    source = Path(arguments.bag)
    target = default_target(source) if arguments.output is None else Path(arguments.output)
    with Progress("recovered", 100) as progress:
        report = recover(source, target, lambda share: progress(int(100 * share)))
    print("\n".join(_lines(report)))
    return 0


def _lines(report: Report) -> Iterator[str]:
    yield f"{report.source}: recovered to {report.target}"
    for part in report.parts:
        yield f"  {part.name}  {part.size / 1e6:.1f} MB  {_state(part)}"
        yield f"    {_kept(part, report)}{_spoilt(part)}"
    for name in report.left_out:
        yield f"  {name}  no MCAP file: left out"
    for gap in report.gaps:
        yield f"missing in between: {gap.end - gap.first} samples, {_times(gap, report)}"
    if not report.described:
        yield "metadata.yaml was missing: made anew"
    yield f"read {report.size / 1e6:.1f} MB, {_kept(report, report)}"
    yield _verdict(report)


def _state(part: PartReport) -> str:
    if part.finished and part.ended:
        return "whole" if part.whole else "complete, but spoilt in places"
    if part.ended:
        return "complete, but for the index at its end"
    tail = part.size - part.break_at
    behind = f"the {tail} bytes behind it hold no whole record" if tail else "its last record is whole"
    return f"breaks off at byte {part.break_at}: {behind}"


def _kept(of: PartReport | Report, report: Report) -> str:
    if of.span is None:
        return f"kept {of.messages} messages, no samples"
    return f"kept {of.messages} messages, {of.samples} samples, {_times(of.span, report)}"


def _spoilt(part: PartReport) -> str:
    counts = (
        (part.spoilt_chunks, "chunks"),
        (part.spoilt_attachments, "attachments"),
        (part.spoilt_metadata, "metadata records"),
    )
    return "".join(f"; {count} spoilt {what} left out" for count, what in counts if count)


def _times(span: Span, report: Report) -> str:
    """First and last sample; where there are samples, their interval is known."""
    first, last = (sample * (report.sample_interval_ns or 0) / 1e9 for sample in (span.first, span.end - 1))
    return f"{span.first} to {span.end - 1} ({first:.6f} s to {last:.6f} s)"


def _verdict(report: Report) -> str:
    if report.whole:
        return "nothing was lost"
    if not report.messages:
        return "nothing had been flushed yet: there was no message to keep"
    return "what had not been flushed, or is spoilt, is lost"
