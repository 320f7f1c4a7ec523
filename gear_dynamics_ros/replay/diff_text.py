"""Difference of two recordings as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from gear_dynamics_ros.analysis.comparison import ChannelDifference
from gear_dynamics_ros.analysis.summary import QUANTITY_UNITS
from gear_dynamics_ros.recording import Recording
from gear_dynamics_ros.replay.diff import RecordingDifference
from gear_dynamics_ros.replay.pairing import Pair

LISTED: Final = 6  # entries of one kind; the JSON file has all


def difference_lines(difference: RecordingDifference) -> list[str]:
    """The difference as lines: recordings, what only one of them has, table of channels, verdict."""
    both = difference.pair
    return [
        *(_recording_line(name, bag) for name, bag in zip("AB", (both.a, both.b), strict=True)),
        f"compared: {difference.samples} samples of {len(both.channels)} channels, "
        f"{_seconds(both, both.first)} to {_seconds(both, both.end)} of A" + _shift_text(both),
        *_extra_lines(both),
        *_input_lines(both),
        "",
        *_table_lines(difference),
        *_undefined_lines(difference.differences),
        "",
        "the same to the bit" if difference.same() else _verdict(difference),
    ]


def _recording_line(name: str, bag: Recording) -> str:
    """Path, samples, channels and time of one recording."""
    interval = bag.parameters.solver.sample_interval
    count = bag.end_sample - bag.first_sample
    span = f"{bag.first_sample * interval:.9g} s to {bag.end_sample * interval:.9g} s"
    return f"{name}: {bag.path}: {count} samples of {len(bag.channel_names)} channels, {span}"


def _seconds(both: Pair, sample: int) -> str:
    """Simulated time of a sample index of A."""
    return f"{sample * both.interval:.9g} s"


def _shift_text(both: Pair) -> str:
    """By how much B is shifted if it isn't aligned by simulated time."""
    return f"; B is {both.shift * both.interval:.9g} s later" if both.shift else ""


def _extra_lines(both: Pair) -> list[str]:
    """Samples and channels that only one of them has."""
    lines = []
    for name, extra, channels in zip("AB", both.extra, both.extra_channels, strict=True):
        if extra.before:
            lines.append(f"only {name}: {extra.before} samples before {_seconds(both, both.first)}")
        if extra.after:
            lines.append(f"only {name}: {extra.after} samples from {_seconds(both, both.end)} on")
        if channels:
            lines.append(f"only {name}: channels {', '.join(channels)}")
    return lines


def _input_lines(both: Pair) -> list[str]:
    """Parameters, commands and events that differ."""
    parameters = [f"{name}: {ours} in A, {theirs} in B" for name, (ours, theirs) in both.parameters().items()]
    commands = [
        f"commands from {_seconds(both, entry.sample)} on: {entry.a or 'none'} in A, {entry.b or 'none'} in B"
        for entry in both.commands()
    ]
    events = [
        f"only {name}: {event.kind} at {_seconds(both, event.sample)} (sample {event.sample}) "
        f"{', '.join(f'{key} = {value}' for key, value in event.parameters.items())}".rstrip()
        for name, alone in zip("AB", both.events(), strict=True)
        for event in alone
    ]
    return [line for lines in (parameters, commands, events) for line in _shortened(lines)]


def _shortened(entries: Sequence[str]) -> list[str]:
    """At most LISTED of ``entries``, and how many more there are."""
    more = len(entries) - LISTED
    return [*entries[:LISTED], f"and {more} more"] if more > 0 else list(entries)


def _table_lines(difference: RecordingDifference) -> list[str]:
    """A table with a row for each channel."""
    interval = difference.pair.interval
    rows: list[Sequence[str]] = [
        ("channel", "unit", "first differs at (s)", "max |A-B|", "at (s)", "RMS of A-B", "RMS of A")
    ]
    for name, found in difference.differences.items():
        times = [
            "-" if sample is None else f"{sample * interval:.9g}"
            for sample in (found.first_difference, found.maximum_at)
        ]
        numbers = [f"{value:.4g}" for value in (found.maximum, found.rms, found.rms_a)]
        rows.append((name, QUANTITY_UNITS[name] or "-", times[0], numbers[0], times[1], *numbers[1:]))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(_aligned(row, widths)).rstrip() for row in rows]


def _aligned(row: Sequence[str], widths: Iterable[int]) -> list[str]:
    """The cells padded to ``widths``: the first two columns to the left, numbers to the right."""
    return [
        cell.ljust(width) if column < 2 else cell.rjust(width)
        for column, (cell, width) in enumerate(zip(row, widths, strict=True))
    ]


def _undefined_lines(differences: dict[str, ChannelDifference]) -> list[str]:
    """The channels of which the table leaves samples out."""
    return [
        f"{name}: {found.undefined_samples} samples are left out of maximum and RMS: "
        "their difference is not finite"
        for name, found in differences.items()
        if found.undefined_samples
    ]


def _verdict(difference: RecordingDifference) -> str:
    """Where the recordings begin to differ."""
    firsts = {
        name: found.first_difference
        for name, found in difference.differences.items()
        if found.first_difference is not None
    }
    if not firsts:
        return "what both have is the same to the bit, but one has more"
    first = min(firsts.values())
    names = ", ".join(_shortened([name for name, sample in firsts.items() if sample == first]))
    return f"differ from {_seconds(difference.pair, first)} (sample {first}) on, first in {names}"
