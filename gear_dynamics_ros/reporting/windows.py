"""The windows of a recording that are analysed in detail."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Final, NamedTuple

from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES
from gear_dynamics_ros.analysis.summary import TimeSpan, distinct_times, steady_window, steady_windows
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.events import CHANGE, END, PAUSE, RESUME, START
from gear_dynamics_ros.recording import OperatorEvent, Recording

MAX_SAMPLES: Final = 1_000_000  # of a window, which is held in memory
MOST_WINDOWS: Final = 6
# Events, and groups of parameters, on which no sample depends.
_IDLE_EVENTS: Final = (START, PAUSE, RESUME, END)
_IDLE_GROUPS: Final = ("checkpoint", "pacing", "recording", "rerun", "stepping")
# Why a window was chosen.
STEADY: Final = "steady"
ASKED: Final = "asked"  # by --from and --to
LAST: Final = "last"  # the end of a recording that has no steady window


class AnalysisWindow(NamedTuple):
    """One window, and what was in force in it."""

    number: int  # 1 for the first in time
    kind: str  # STEADY, ASKED or LAST
    span: TimeSpan
    commands: Commands | None  # in force at its end; None if none were recorded

    @property
    def name(self) -> str:
        """Name in files: ``window_1``."""
        return window_name(self.number)


def window_name(number: int) -> str:
    """Name in files of the window with a number."""
    return f"window_{number}"


def whole_span(recording: Recording) -> TimeSpan:
    """Simulated time that the recording covers."""
    interval = recording.parameters.solver.sample_interval
    return TimeSpan(recording.first_sample * interval, recording.end_sample * interval)


def acting_events(recording: Recording) -> list[OperatorEvent]:
    """The events that change the state of the gearbox or its model."""
    return [event for event in recording.events if _acts(event)]


def _acts(event: OperatorEvent) -> bool:
    if event.kind != CHANGE:
        return event.kind not in _IDLE_EVENTS
    return any(name.split(".")[0] not in _IDLE_GROUPS for name in event.parameters)


def change_times(recording: Recording) -> list[float]:
    """Times in s of commands and of acting events after the first sample."""
    samples = [sample for sample, _ in recording.commands]
    samples += [event.sample for event in acting_events(recording)]
    inside = [sample for sample in samples if recording.first_sample < sample < recording.end_sample]
    return distinct_times(inside, recording.parameters.solver.sample_interval)


def choose_windows(
    recording: Recording, changes: Sequence[float], start: float | None, end: float | None
) -> list[AnalysisWindow]:
    """The window from ``start`` to before ``end`` (s); without both, the steady ones, in the order of time.

    Of steady windows with the same commands in force the latest is taken, unless the state or the model was
    changed in between, and of all these the latest MOST_WINDOWS. Without a steady window it is the end of the
    recording. ``changes`` are the times in s of commands and events.

    Raises UsageError if the requested window is not finite, leaves the recording, or has fewer than
    MIN_SAMPLES or more than MAX_SAMPLES samples.
    """
    whole = whole_span(recording)
    if start is not None or end is not None:
        asked = TimeSpan(whole.start if start is None else start, whole.end if end is None else end)
        _require_usable(asked, whole, recording.parameters.solver.sample_interval)
        return _numbered(recording, ASKED, [asked])
    steady = _distinct(recording, _without_gaps(recording, whole, changes))
    if steady:
        return _numbered(recording, STEADY, steady[-MOST_WINDOWS:])
    held = _last_held(recording)
    return _numbered(recording, LAST, [steady_window(held, changes)])


def _numbered(recording: Recording, kind: str, spans: Sequence[TimeSpan]) -> list[AnalysisWindow]:
    return [
        AnalysisWindow(number, kind, span, _commands_in(recording, span))
        for number, span in enumerate(spans, start=1)
    ]


def _without_gaps(recording: Recording, whole: TimeSpan, changes: Sequence[float]) -> list[TimeSpan]:
    """The steady windows of which all samples are held: the edges of a gap count as changes."""
    interval = recording.parameters.solver.sample_interval
    gaps = [TimeSpan(gap.first * interval, gap.end * interval) for gap in recording.coverage.gaps]
    found = steady_windows(whole, [*changes, *(edge for gap in gaps for edge in gap)])
    return [
        window
        for window in found
        if not any(gap.start < window.end and window.start < gap.end for gap in gaps)
    ]


def _last_held(recording: Recording) -> TimeSpan:
    """The time behind the last gap."""
    interval = recording.parameters.solver.sample_interval
    whole = whole_span(recording)
    return TimeSpan(max([whole.start, *(gap.end * interval for gap in recording.coverage.gaps)]), whole.end)


def _distinct(recording: Recording, windows: Sequence[TimeSpan]) -> list[TimeSpan]:
    """The latest of the windows with the same commands and without a changing event in between."""
    interval = recording.parameters.solver.sample_interval
    changed = [event.sample * interval for event in acting_events(recording)]
    latest = {
        (_commands_in(recording, window), bisect_right(changed, window.start)): window for window in windows
    }
    return sorted(latest.values())


def _commands_in(recording: Recording, window: TimeSpan) -> Commands | None:
    """Commands in force in the last sample of ``window``."""
    interval = recording.parameters.solver.sample_interval
    last = round(window.end / interval) - 1
    place = bisect_right(recording.commands, last, key=lambda entry: entry[0])
    return recording.commands[place - 1][1] if place else None


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
