"""Writes the difference of two recordings to files: numbers and a figure."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from gear_dynamics_ros.analysis.comparison import ChannelDifference
from gear_dynamics_ros.analysis.summary import QUANTITY_UNITS
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.replay.diff import SAMPLES_AFTER, RecordingDifference, first_above, window_around
from gear_dynamics_ros.replay.pairing import ExtraSamples
from gear_dynamics_ros.system.files import output_file

if TYPE_CHECKING:
    from gear_dynamics_ros.analysis import figures

NUMBERS_FILE: Final = "diff.json"
FIGURE_FILE: Final = "diff.png"
PREFERRED: Final = ("dte", "mesh_force", "driving_speed", "driving_contact_force_x")
DRAWN_CHANNELS: Final = 4
VISIBLE_SHARE: Final = 0.1  # of the maximum of |A - B|, at which the curves of A and B separate visibly


def write_difference(difference: RecordingDifference, folder: Path, align: str) -> list[Path]:
    """Write NUMBERS_FILE, and FIGURE_FILE if any values differ, into ``folder``; returns their paths.

    Each file appears whole or not at all. ``align`` is how the recordings were aligned, BY_TIME or BY_START.
    Raises GearboxError if a file can't be written.
    """
    written = [folder / NUMBERS_FILE]
    text = json.dumps(difference_json(difference, align), indent=2, allow_nan=False)
    with output_file(written[0]) as stream:
        stream.write(f"{text}\n".encode())
    if drawn := channels_to_draw(difference.differences):
        written.append(folder / FIGURE_FILE)
        _write_figure(difference, drawn, written[-1])
    return written


def _write_figure(difference: RecordingDifference, drawn: Sequence[str], path: Path) -> None:
    from gear_dynamics_ros.analysis import figures

    figure = figures.divergence_figure(
        difference.envelope,
        {name: difference.differences[name] for name in drawn},
        difference.pair.interval,
        _overlays(difference, drawn[0]),
    )
    with output_file(path) as stream:
        figures.write_png(figure, stream)


def channels_to_draw(differences: dict[str, ChannelDifference]) -> list[str]:
    """At most DRAWN_CHANNELS of the channels whose values differ, the PREFERRED ones first."""
    preferred = [name for name in PREFERRED if name in differences]
    others = [name for name in differences if name not in PREFERRED]
    return [name for name in (*preferred, *others) if differences[name].maximum > 0.0][:DRAWN_CHANNELS]


def _overlays(difference: RecordingDifference, name: str) -> list[figures.Overlay]:
    """Overlays of one channel where its bits first differ, and where the curves separate visibly."""
    from gear_dynamics_ros.analysis import figures

    both, found = difference.pair, difference.differences[name]
    first = both.first if found.first_difference is None else found.first_difference
    places = {f"Around the first difference of {name}": first}
    seen = first_above(both, name, VISIBLE_SHARE * found.maximum)
    if seen >= first + SAMPLES_AFTER:
        places["Where |A - B| reaches a tenth of its maximum"] = seen
    return [
        figures.Overlay(title, name, *window_around(both, name, sample), sample * both.interval)
        for title, sample in places.items()
    ]


def difference_json(difference: RecordingDifference, align: str) -> dict[str, Any]:
    """All numbers as a mapping for JSON: SI units, indices and times of A, None where there is none.

    ``align`` is how the recordings were aligned, BY_TIME or BY_START.
    """
    both = difference.pair
    return {
        "a": _recording_json(both.a, both.extra[0], both.extra_channels[0]),
        "b": _recording_json(both.b, both.extra[1], both.extra_channels[1]),
        "same": difference.same(),
        "align": align,
        "shift": both.shift,
        "sample_interval": both.interval,
        "from": both.first * both.interval,
        "to": both.end * both.interval,
        "samples": difference.samples,
        "channels": {
            name: _channel_json(name, found, both.interval) for name, found in difference.differences.items()
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
            f"only_{name}": [_event_json(event) for event in alone]
            for name, alone in zip("ab", both.events(), strict=True)
        },
    }


def _recording_json(bag: Recording, extra: ExtraSamples, channels: Sequence[str]) -> dict[str, Any]:
    """One of the recordings, and what only it has."""
    return {
        "recording": str(bag.path),
        "complete": bag.complete,
        "version": bag.version,
        "kernel_hash": bag.kernel_hash,
        "first_sample": bag.first_sample,
        "end_sample": bag.end_sample,
        "only": {"samples_before": extra.before, "samples_after": extra.after, "channels": list(channels)},
    }


def _channel_json(name: str, found: ChannelDifference, interval: float) -> dict[str, Any]:
    return {
        "unit": QUANTITY_UNITS[name],
        "first_difference": _sample_json(found.first_difference, interval),
        "differing_samples": found.differing_samples,
        "max_difference": found.maximum,
        "max_difference_at": _sample_json(found.maximum_at, interval),
        "rms_difference": _finite_or_none(found.rms),
        "rms_a": _finite_or_none(found.rms_a),
        "undefined_samples": found.undefined_samples,
    }


def _sample_json(sample: int | None, interval: float) -> dict[str, Any] | None:
    """A sample index with its time in s."""
    return None if sample is None else {"sample": sample, "time": sample * interval}


def _finite_or_none(value: float) -> float | None:
    """``value``, or None for what JSON can't hold."""
    return value if math.isfinite(value) else None


def _event_json(event: OperatorEvent) -> dict[str, Any]:
    """The event without the checkpoint of a restore."""
    return {
        "sample": event.sample,
        "time": event.time,
        "event": event.kind,
        "message": event.message,
        "parameters": dict(event.parameters),
    }
