"""The report of a run of the test harness: one HTML page with everything in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from gear_dynamics_ros import __version__, palette
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.expectations import CHANNEL_UNITS, Expectation
from gear_dynamics_ros.harness.measures import FLANK_STATES, FlankShare, SettlingTime, Statistic
from gear_dynamics_ros.harness.outcome import ActedCommand, ChannelBounds, PlayedSamples, ProfileOutcome
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import Result
from gear_dynamics_ros.harness.tracks import CommandTrack
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.reporting.charts import Band, Chart, Curve, Lane, Mark, draw_chart
from gear_dynamics_ros.reporting.parameter_rows import changed_rows, switch_rows
from gear_dynamics_ros.reporting.rendering import axis_unit, render_page

TEMPLATE: Final = "drive.html.j2"
TRACK_POINTS: Final = 400  # of a command over the profile, besides its corners
BEFORE: Final = 1e-9  # s before a step, to draw its corner
STATUS_COLOURS: Final = {"pass": palette.GREEN, "FAIL": palette.ORANGE}
# The channel that shows each command.
COMMAND_CHANNELS: Final = {
    "driving_speed": "speed",
    "drive_torque": "drive_torque",
    "load_torque": "load_torque",
}
COMMAND_COLOURS: Final = {"speed": palette.BLUE, "drive_torque": palette.ORANGE, "load_torque": palette.GREEN}
FLANK_NAMES: Final = {state: name for name, state in FLANK_STATES.items()}


class DriveRun(NamedTuple):
    """What was played, to whom and where."""

    profile: Profile
    source: str  # of the profile
    node: str
    pace: str  # how commands are timed, in words
    environment: Mapping[str, str]  # names and values to show
    began: str  # wall time
    ended: str  # empty if it has not ended


class ExpectationEntry(NamedTuple):
    """One expectation in the report."""

    number: int
    result: Result
    chart: Chart | None  # None if its window has no samples


def drive_page(run: DriveRun, outcome: ProfileOutcome) -> bytes:
    """The page of ``run``, also if it failed, broke off or has not ended."""
    parameters = _parameters(outcome.gearbox)
    return render_page(
        TEMPLATE,
        {
            "title": f"Test run {run.source.rpartition('/')[2]}",
            "run": run,
            "outcome": outcome,
            "verdict": verdict(outcome),
            "passed": sum(result.passed for result in outcome.results),
            "good": not outcome.failure and all(result.passed for result in outcome.results),
            "version": __version__,
            "gearbox": outcome.gearbox,
            "switches": switch_rows(parameters) if parameters else [],
            "changed": changed_rows(parameters) if parameters else [],
            "set_parameters": run.profile.parameters,
            "chart": _run_chart(run.profile, outcome),
            "entries": _entries(outcome),
            "lateness_chart": _lateness_chart(run.profile, outcome.samples),
            "latest": max(outcome.lateness, default=None),
            "median": float(np.median(outcome.lateness)) if outcome.lateness else None,
        },
    )


def verdict(outcome: ProfileOutcome) -> str:
    """How the run went, in one sentence."""
    results = outcome.results
    if outcome.signal:
        return f"INTERRUPTED: {outcome.failure}"
    if outcome.failure:
        return f"BROKE OFF: {outcome.failure}"
    if not results:
        return "Played to its end. The profile has no expectations."
    unjudged = sum(result.unjudged for result in results)
    failed = sum(result.failed for result in results)
    if not failed and not unjudged:
        return f"PASSED: all {len(results)} expectations hold."
    late = f"{unjudged} could not be judged, because commands came too late"
    if not failed:
        return f"NOT JUDGED: of {len(results)} expectations {late}."
    return f"FAILED: {failed} of {len(results)} expectations do not hold{f'; {late}' if unjudged else ''}."


def _parameters(gearbox: Mapping[str, Any]) -> Parameters | None:
    """Parameters of the gearbox; None if it has not told them, or has others than this version knows."""
    try:
        return Parameters.from_flat(gearbox["parameters"]) if gearbox else None
    except UsageError:
        return None


def _entries(outcome: ProfileOutcome) -> list[ExpectationEntry]:
    samples = outcome.samples
    entries = []
    for place, result in enumerate(outcome.results):
        bounds = samples.windows[place] if samples and place < len(samples.windows) else None
        drawn = bounds is not None and len(bounds.time) > 0
        chart = _window_chart(place + 1, result, bounds) if bounds is not None and drawn else None
        entries.append(ExpectationEntry(place + 1, result, chart))
    return entries


def _window_chart(number: int, result: Result, bounds: ChannelBounds) -> Chart:
    """The channel of an expectation in its window, with its limits and what was measured."""
    expectation = result.expectation
    scale = _LaneScale(expectation.channel, bounds, _limits_on_axis(expectation))
    curves = [scale.curve(bounds, expectation.channel.replace("_", " "), palette.BLUE)]
    if isinstance(expectation.measure, Statistic) and expectation.measure.name in ("mean", "rms"):
        span = np.array([expectation.start, expectation.end])
        curves += [
            scale.curve(ChannelBounds(span, level, level), expectation.measure.name, palette.ORANGE)
            for level in (np.full(2, value) for value in result.values)
        ]
    lane = Lane(
        expectation.channel.replace("_", " "),
        scale.unit,
        curves,
        levels=[scale.band(band) for band in _allowed(expectation)],
        marks=_settling_marks(result),
        names=FLANK_NAMES if expectation.channel == "meshing_state" else {},
        height=150.0,
    )
    return draw_chart(
        f"{expectation.name}: {expectation.channel}",
        [lane],
        expectation.start,
        expectation.end,
        f"window-{number}",
        "time of the profile (s)",
    )


class _LaneScale:
    """The unit in which a channel is shown, and its data in that unit."""

    def __init__(self, channel: str, bounds: ChannelBounds, limits: Sequence[float]) -> None:
        sizes = [*np.abs(bounds.low), *np.abs(bounds.high), *map(abs, limits)]
        self.factor, self.unit = axis_unit(float(max(sizes, default=0.0)), CHANNEL_UNITS[channel])

    def curve(self, bounds: ChannelBounds, label: str, colour: str, *, dashed: bool = False) -> Curve:
        return Curve(label, colour, bounds.time, self.factor * bounds.low, self.factor * bounds.high, dashed)

    def band(self, band: Band) -> Band:
        return band._replace(low=self.factor * band.low, high=self.factor * band.high)


def _limits_on_axis(expectation: Expectation) -> list[float]:
    return [
        bound for band in _allowed(expectation) for bound in (band.low, band.high) if math.isfinite(bound)
    ]


def _allowed(expectation: Expectation) -> list[Band]:
    """Where the channel, its mean or its RMS should be; nothing where the axis does not show it."""
    start, end = expectation.start, expectation.end
    measure = expectation.measure
    if isinstance(measure, SettlingTime):
        return [Band(start, end, measure.lowest, measure.highest, palette.GREEN, "allowed after settling")]
    if isinstance(measure, Statistic):
        label = "allowed" if measure.name == "every" else f"allowed {measure.name}"
        return [Band(start, end, expectation.minimum, expectation.maximum, palette.GREEN, label)]
    return []


def _settling_marks(result: Result) -> list[Mark]:
    expectation = result.expectation
    if not isinstance(expectation.measure, SettlingTime):
        return []
    settled = [value for value in result.values if math.isfinite(value)]
    return [
        Mark(expectation.start + expectation.maximum, "must be settled", palette.DIM),
        *(Mark(expectation.start + value, "settled", palette.ORANGE) for value in settled),
    ]


def _run_chart(profile: Profile, outcome: ProfileOutcome) -> Chart | None:
    """All channels over the whole profile, with the commands and the windows of the expectations."""
    samples = outcome.samples
    channels = samples.channels if samples else {}
    shown = [name for name, bounds in channels.items() if len(bounds.time)]
    commanded = [name for name, command in COMMAND_CHANNELS.items() if command in profile.commands]
    names = list(dict.fromkeys([*COMMAND_CHANNELS, *shown]))
    lanes = [
        _run_lane(name, channels.get(name), profile, outcome.results)
        for name in names
        if name in shown or name in commanded
    ]
    if not lanes:
        return None
    return draw_chart("The run", lanes, 0.0, profile.duration, "run", "time of the profile (s)")


def _run_lane(name: str, bounds: ChannelBounds | None, profile: Profile, results: Sequence[Result]) -> Lane:
    track = profile.commands.get(COMMAND_CHANNELS.get(name, ""))
    commanded = _track_bounds(track, profile.duration) if track else None
    known = [each for each in (bounds, commanded) if each is not None]
    together = ChannelBounds(
        *(np.concatenate([getattr(each, part) for each in known]) for part in ChannelBounds._fields)
    )
    scale = _LaneScale(name, together, [])
    curves = [scale.curve(bounds, "measured", palette.BLUE)] if bounds is not None else []
    if commanded is not None:
        curves.append(scale.curve(commanded, "commanded", palette.DIM, dashed=True))
    mine = [result for result in results if result.expectation.channel == name]
    return Lane(
        name.replace("_", " "),
        scale.unit,
        curves,
        boxes=[scale.band(_window_box(result)) for result in mine],
        names=FLANK_NAMES if name == "meshing_state" else {},
        height=110.0,
    )


def _window_box(result: Result) -> Band:
    """Window and limits of an expectation; the limits only where the channel itself has them."""
    expectation = result.expectation
    (low, high) = (-math.inf, math.inf)
    if isinstance(expectation.measure, Statistic) and expectation.measure.name != "rms":
        low, high = expectation.minimum, expectation.maximum
    if isinstance(expectation.measure, FlankShare):
        low = high = FLANK_STATES[expectation.measure.flank]
        low, high = low - 0.15, high + 0.15
    colour = STATUS_COLOURS.get(result.status, palette.GREY)
    return Band(expectation.start, expectation.end, low, high, colour, f"{expectation.name}: {result.status}")


def _track_bounds(track: CommandTrack, duration: float) -> ChannelBounds:
    """A command over the profile as a line with its corners."""
    corners = [time for piece in track.pieces for time in (piece.start - BEFORE, piece.start, piece.end)]
    times = np.union1d(np.linspace(0.0, duration, TRACK_POINTS), corners)
    times = times[(times >= track.pieces[0].start) & (times <= duration)]
    values = np.array([track.value(float(time)) for time in times], dtype=np.float64)
    return ChannelBounds(times, values, values)


def _lateness_chart(profile: Profile, samples: PlayedSamples | None) -> Chart | None:
    """By how much each command acted after it was due."""
    acted: Sequence[ActedCommand] = samples.acted if samples else []
    if not acted:
        return None
    curves = []
    for name in profile.commands:
        mine = sorted((each.time, 1e3 * each.late) for each in acted if each.name == name)
        if mine:
            stems = np.array([(time, height) for time, late in mine for height in (0.0, late, 0.0)])
            curves.append(Curve(name.replace("_", " "), COMMAND_COLOURS[name], *stems[:, [0, 1, 1]].T))
    lane = Lane("late", "ms", curves, levels=[Band(0.0, 0.0, 0.0, 0.0, palette.GREY)])
    return draw_chart(
        "How late commands acted", [lane], 0.0, profile.duration, "late", "time of the profile (s)"
    )
