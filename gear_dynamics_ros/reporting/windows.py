"""The window of a recording that is analysed in detail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES
from gear_dynamics_ros.analysis.summary import TimeSpan, distinct_times, steady_window
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.recording import Recording

MAX_SAMPLES: Final = 1_000_000  # of a window, which is held in memory


def whole_span(recording: Recording) -> TimeSpan:
    """Simulated time that the recording covers."""
    interval = recording.parameters.solver.sample_interval
    return TimeSpan(recording.first_sample * interval, recording.end_sample * interval)


def change_times(recording: Recording) -> list[float]:
    """Times in s of commands and events after the first sample."""
    samples = [sample for sample, _ in recording.commands] + [event.sample for event in recording.events]
    inside = [sample for sample in samples if recording.first_sample < sample < recording.end_sample]
    return distinct_times(inside, recording.parameters.solver.sample_interval)


def choose_window(
    recording: Recording, changes: Sequence[float], start: float | None, end: float | None
) -> TimeSpan:
    """The window from ``start`` to before ``end`` (s); without both, the latest steady one.

    ``changes`` are the times in s of commands and events. Raises UsageError if the requested window is not
    finite, leaves the recording, or has fewer than MIN_SAMPLES or more than MAX_SAMPLES samples.
    """
    whole = whole_span(recording)
    if start is None and end is None:
        return steady_window(whole, changes)
    window = TimeSpan(whole.start if start is None else start, whole.end if end is None else end)
    _require_usable(window, whole, recording.parameters.solver.sample_interval)
    return window


def _require_usable(window: TimeSpan, whole: TimeSpan, interval: float) -> None:
    asked = f"--from {window.start:g} --to {window.end:g} s"
    if not (math.isfinite(window.start) and math.isfinite(window.end)):
        raise UsageError(f"{asked}: give finite times")
    # Half a sample of tolerance, so that the rounded times of a summary are accepted.
    slack = 0.5 * interval
    if window.start < whole.start - slack or window.end > whole.end + slack:
        raise UsageError(f"{asked} leaves the recording: stay within {whole.start:g} and {whole.end:g} s")
    count = round((window.end - window.start) / interval)
    if count < MIN_SAMPLES:
        raise UsageError(f"{asked} holds {max(count, 0)} samples: take at least {MIN_SAMPLES}")
    if count > MAX_SAMPLES:
        raise UsageError(f"{asked} is longer than {MAX_SAMPLES * interval:g} s: take a shorter window")
