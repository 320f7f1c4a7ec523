"""How two recordings part: the comparison of all channels, told as text, numbers and a figure."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.comparison import ANGLES, Comparison, Difference, distance
from gear_dynamics_ros.analysis.statistics import Envelope, Quantities
from gear_dynamics_ros.analysis.summary import UNITS
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.replay.pairing import Ends, Pair

if TYPE_CHECKING:
    from gear_dynamics_ros.analysis.figures import Overlay

NUMBERS_FILE: Final = "diff.json"
FIGURE_FILE: Final = "diff.png"
PREFERRED: Final = ("dte", "mesh_force", "driving_speed", "driving_contact_force_x")
SHOWN: Final = 4  # channels in the figure
LISTED: Final = 6  # of a kind on stdout; diff.json has all
VISIBLE: Final = 0.1  # of the greatest difference: there the overlaid curves are seen to part
SAMPLES_BEFORE: Final = 40
SAMPLES_AFTER: Final = 120


class Compared(NamedTuple):
    """What one pass through both recordings gave."""

    pair: Pair
    differences: dict[str, Difference]
    envelope: Envelope

    @property
    def samples(self) -> int:
        """Samples compared."""
        return self.pair.beyond - self.pair.first

    @property
    def same(self) -> bool:
        """Whether all samples and channels are in both, the same to the bit."""
        more = any(self.pair.lone_channels) or any(map(any, self.pair.ends))
        return not more and not any(found.unlike for found in self.differences.values())


def compare(both: Pair, progress: Callable[[int], None] = lambda samples: None) -> Compared:
    """One pass through both, in pieces; ``progress`` is called with the samples compared so far."""
    names = both.channels
    found, envelope = Comparison(names), Envelope()
    for a, b in both.stretches(names):
        apart = found.add(a.first, a.values, b.values)
        envelope.add(a, Quantities(names, apart))
        progress(found.samples)
    return Compared(both, found.differences, envelope)


def report(compared: Compared) -> list[str]:
    """What stdout tells."""
    both = compared.pair
    return [
        *(described(name, bag) for name, bag in zip("AB", (both.a, both.b), strict=True)),
        f"compared: {compared.samples} samples of {len(both.channels)} channels, "
        f"{seconds(both, both.first)} to {seconds(both, both.beyond)} of A" + shifted(both),
        *lone(both),
        *otherwise(both),
        "",
        *table(compared),
        *undefined(compared.differences),
        "",
        "the same to the bit" if compared.same else verdict(compared),
    ]


def described(name: str, bag: Recording) -> str:
    """One line about one recording."""
    interval = bag.parameters.solver.sample_interval
    count = bag.end_sample - bag.first_sample
    span = f"{bag.first_sample * interval:.9g} s to {bag.end_sample * interval:.9g} s"
    return f"{name}: {bag.path}: {count} samples of {len(bag.channel_names)} channels, {span}"


def seconds(both: Pair, sample: int) -> str:
    """Simulated time of a sample of A."""
    return f"{sample * both.interval:.9g} s"


def shifted(both: Pair) -> str:
    """How B is aligned, if not by simulated time."""
    return f"; B is {both.shift * both.interval:.9g} s later" if both.shift else ""


def lone(both: Pair) -> list[str]:
    """What one has and the other not, a line each."""
    lines = []
    for name, ends, channels in zip("AB", both.ends, both.lone_channels, strict=True):
        if ends.before:
            lines.append(f"only {name}: {ends.before} samples before {seconds(both, both.first)}")
        if ends.after:
            lines.append(f"only {name}: {ends.after} samples from {seconds(both, both.beyond)} on")
        if channels:
            lines.append(f"only {name}: channels {', '.join(channels)}")
    return lines


def otherwise(both: Pair) -> list[str]:
    """Parameters, commands and events that differ, a line each."""
    parameters = [f"{name}: {ours} in A, {theirs} in B" for name, (ours, theirs) in both.parameters().items()]
    commands = [
        f"commands from {seconds(both, entry.sample)} on: "
        f"{commanded(entry.a)} in A, {commanded(entry.b)} in B"
        for entry in both.commands()
    ]
    events = [
        f"only {name}: {event.kind} at {seconds(both, event.sample)} (sample {event.sample}) "
        f"{', '.join(f'{key} = {value}' for key, value in event.parameters.items())}".rstrip()
        for name, alone in zip("AB", both.events(), strict=True)
        for event in alone
    ]
    return [line for lines in (parameters, commands, events) for line in shortened(lines)]


def commanded(commands: Commands | None) -> str:
    """Commands in force in short."""
    if commands is None:
        return "none"
    return (
        f"drive {commands.drive_torque:g} N m, load {commands.load_torque:g} N m, "
        f"speed {commands.speed:g} rad/s"
    )


def shortened(entries: Sequence[str]) -> list[str]:
    """The first of ``entries``, and how many more there are."""
    more = len(entries) - LISTED
    return [*entries[:LISTED], f"and {more} more"] if more > 0 else list(entries)


def table(compared: Compared) -> list[str]:
    """A line for each channel."""
    interval = compared.pair.interval
    rows: list[Sequence[str]] = [
        ("channel", "unit", "first differs at (s)", "max |A-B|", "at (s)", "RMS of A-B", "RMS of A")
    ]
    for name, found in compared.differences.items():
        times = [
            "-" if sample is None else f"{sample * interval:.9g}"
            for sample in (found.first, found.greatest_at)
        ]
        numbers = [f"{value:.4g}" for value in (found.greatest, found.rms, found.scale)]
        rows.append((name, UNITS[name] or "-", times[0], numbers[0], times[1], *numbers[1:]))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(aligned(row, widths)).rstrip() for row in rows]


def aligned(row: Sequence[str], widths: Iterable[int]) -> list[str]:
    """Names to the left, numbers to the right."""
    return [
        cell.ljust(width) if column < 2 else cell.rjust(width)
        for column, (cell, width) in enumerate(zip(row, widths, strict=True))
    ]


def undefined(differences: dict[str, Difference]) -> list[str]:
    """What the table leaves out, a line each channel."""
    return [
        f"{name}: {found.undefined} samples are left out of maximum and RMS: "
        "their difference is no finite number"
        for name, found in differences.items()
        if found.undefined
    ]


def verdict(compared: Compared) -> str:
    """How recordings that differ do so."""
    firsts = {name: found.first for name, found in compared.differences.items() if found.first is not None}
    if not firsts:
        return "what both have is the same to the bit, but one has more"
    first = min(firsts.values())
    names = ", ".join(shortened([name for name, sample in firsts.items() if sample == first]))
    return f"differ from {seconds(compared.pair, first)} (sample {first}) on, first in {names}"


def write(compared: Compared, output: Path, align: str) -> list[Path]:
    """Write the numbers, and the figure if there is a difference of values to see; returns the files."""
    written = [output / NUMBERS_FILE]
    text = json.dumps(block(compared, align), indent=2, allow_nan=False)
    written[0].write_text(text + "\n", encoding="utf-8")
    shown = chosen(compared.differences)
    if shown:
        from gear_dynamics_ros.analysis import figures

        written.append(output / FIGURE_FILE)
        name = next(iter(shown))
        differences = {name: compared.differences[name] for name in shown}
        overlays = close_views(compared, name)
        figure = figures.divergence(compared.envelope, differences, compared.pair.interval, overlays)
        figure.savefig(written[-1])
    return written


def chosen(differences: dict[str, Difference]) -> list[str]:
    """Channels for the figure: of those that differ in value the telling ones, then the others."""
    telling = [name for name in PREFERRED if name in differences]
    others = [name for name in differences if name not in PREFERRED]
    return [name for name in (*telling, *others) if differences[name].greatest > 0.0][:SHOWN]


def close_views(compared: Compared, name: str) -> list[Overlay]:
    """Overlays of one channel: where its bits first differ, and where that can be seen, if that is later."""
    from gear_dynamics_ros.analysis.figures import Overlay

    both, found = compared.pair, compared.differences[name]
    first = both.first if found.first is None else found.first
    places = {f"Around the first difference of {name}": first}
    seen = first_apart(both, name, VISIBLE * found.greatest)
    if seen >= first + SAMPLES_AFTER:
        places["Where |A - B| is a tenth of its greatest"] = seen
    return [
        Overlay(title, name, *surroundings(both, name, sample), sample * both.interval)
        for title, sample in places.items()
    ]


def first_apart(both: Pair, name: str, threshold: float) -> int:
    """The first sample whose |A - B| is ``threshold`` or more; one past the last if there is none."""
    for a, b in both.stretches([name]):
        reached = distance(a.values, b.values, [0] if name in ANGLES else []) >= threshold
        if reached.any():
            return a.first + int(reached.argmax())
    return both.beyond


def surroundings(both: Pair, name: str, sample: int) -> tuple[Samples, NDArray[np.float64]]:
    """Samples of A around ``sample``, and the values of B (n,) beside them."""
    near = both._replace(
        first=max(sample - SAMPLES_BEFORE, both.first), beyond=min(sample + SAMPLES_AFTER, both.beyond)
    )
    ours, theirs = zip(*near.stretches([name]), strict=True)
    values = np.concatenate([samples.values for samples in ours])
    others = np.concatenate([samples.values[:, 0] for samples in theirs])
    return Samples(near.first, near.interval, (name,), values), others


def block(compared: Compared, align: str) -> dict[str, Any]:
    """All numbers for JSON; SI units, samples and times of A, null where there is none."""
    both = compared.pair
    return {
        "a": origin(both.a, both.ends[0], both.lone_channels[0]),
        "b": origin(both.b, both.ends[1], both.lone_channels[1]),
        "same": compared.same,
        "align": align,
        "shift": both.shift,
        "sample_interval": both.interval,
        "from": both.first * both.interval,
        "to": both.beyond * both.interval,
        "samples": compared.samples,
        "channels": {
            name: channel_block(name, found, both.interval) for name, found in compared.differences.items()
        },
        "parameters": {name: {"a": ours, "b": theirs} for name, (ours, theirs) in both.parameters().items()},
        "commands": [
            {
                "sample": entry.sample,
                "time": entry.sample * both.interval,
                "a": entry.a and entry.a._asdict(),
                "b": entry.b and entry.b._asdict(),
            }
            for entry in both.commands()
        ],
        "events": {
            f"only_{name}": [event_block(event) for event in alone]
            for name, alone in zip("ab", both.events(), strict=True)
        },
    }


def origin(bag: Recording, ends: Ends, channels: Sequence[str]) -> dict[str, Any]:
    """One of the recordings, and what it alone has."""
    return {
        "recording": str(bag.path),
        "complete": bag.complete,
        "version": bag.version,
        "kernel_hash": bag.kernel_hash,
        "first_sample": bag.first_sample,
        "end_sample": bag.end_sample,
        "only": {"samples_before": ends.before, "samples_after": ends.after, "channels": list(channels)},
    }


def channel_block(name: str, found: Difference, interval: float) -> dict[str, Any]:
    """One channel's difference."""
    return {
        "unit": UNITS[name],
        "first_difference": moment(found.first, interval),
        "differing_samples": found.unlike,
        "max_difference": found.greatest,
        "max_difference_at": moment(found.greatest_at, interval),
        "rms_difference": finite(found.rms),
        "rms_a": finite(found.scale),
        "undefined_samples": found.undefined,
    }


def moment(sample: int | None, interval: float) -> dict[str, Any] | None:
    """A sample with its time in s."""
    return None if sample is None else {"sample": sample, "time": sample * interval}


def finite(value: float) -> float | None:
    """None for what JSON can't hold."""
    return value if math.isfinite(value) else None


def event_block(event: OperatorEvent) -> dict[str, Any]:
    """An event without the state that a restore brought."""
    return {
        "sample": event.sample,
        "time": event.time,
        "event": event.kind,
        "message": event.message,
        "parameters": dict(event.parameters),
    }
