"""Report of a recovery as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gear_dynamics_ros.recording.coverage import SampleRange
from gear_dynamics_ros.recording.recover import RecoveredPart, Recovery


def recovery_lines(report: Recovery) -> Iterator[str]:
    """What was kept and lost, for each file and in total, as lines of text."""
    yield f"{report.source}: recovered to {report.target}"
    for part in report.parts:
        yield f"  {part.name}  {part.size} bytes  {_state(part)}"
        yield f"    kept {_kept(part, report)}"
    for name, reason in report.left_out.items():
        yield f"  {name}  {reason}: left out"
    for gap in report.gaps:
        yield f"missing in between: {gap.end - gap.first} samples, {_times(gap, report)}"
    for name in report.missing:
        yield f"missing: {name}, which metadata.yaml lists"
    if not report.metadata_whole:
        yield "metadata.yaml was missing or damaged: written again"
    yield f"read {report.size} bytes, kept {_kept(report, report)}"
    yield _verdict(report)


def _state(part: RecoveredPart) -> str:
    damaged = _damaged([part])
    left_out = f"; left out as damaged: {', '.join(damaged)}" if damaged else ""
    if part.behind:
        return f"{part.behind} bytes behind its end{left_out or ': left out'}"
    if part.whole:
        return "whole" if part.finished else "whole but for the index at its end"
    if part.ended:
        return f"complete{left_out}"
    behind = f"the {part.tail} bytes behind it hold no whole record" if part.tail else "nothing is behind it"
    return f"breaks off at byte {part.break_at}: {behind}{left_out}"


def _kept(result: RecoveredPart | Recovery, report: Recovery) -> str:
    if result.span is None:
        return f"{result.messages} messages, no samples"
    return f"{result.messages} messages, {result.samples} samples, {_times(result.span, report)}"


def _damaged(parts: Sequence[RecoveredPart]) -> list[str]:
    counts = {
        "chunk": sum(part.damaged_chunks for part in parts),
        "attachment": sum(part.damaged_attachments for part in parts),
        "metadata record": sum(part.damaged_metadata for part in parts),
    }
    return [f"{count} {what}{'s' if count > 1 else ''}" for what, count in counts.items() if count]


def _times(span: SampleRange, report: Recovery) -> str:
    return span.text(report.sample_interval_ns or 0)  # if there are samples, their interval is known


def _verdict(report: Recovery) -> str:
    if report.whole:
        return "nothing was lost"
    tail = sum(part.tail for part in report.parts)
    behind = sum(part.behind for part in report.parts)
    missing = sum(gap.end - gap.first for gap in report.gaps)
    lost = [
        *([f"{tail} bytes without a whole record"] if tail else []),
        *_damaged(report.parts),
        *([f"{missing} samples in between"] if missing else []),
        *([f"{len(report.left_out)} files"] if report.left_out else []),
        *([f"missing files: {len(report.missing)}"] if report.missing else []),
        *([f"{behind} bytes behind the end of files"] if behind else []),
    ]
    verdict = f"lost: {', '.join(lost)}" if lost else "lost: what had not been flushed"
    if report.messages:
        return verdict
    damaged = any(part.damaged_chunks for part in report.parts)
    return f"{'no message is whole' if damaged else 'nothing had been flushed yet'}; {verdict}"
