"""Command profiles and expectations: what `drive` plays to a gearbox and what it checks on the outputs.

Nothing here knows ROS: a Player takes the waveform, chunk after chunk, and gives back the commands that are
due. Times of a profile are simulated seconds since the harness joined; units are those of the commands and
channels.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.ros_yaml import parse_yaml
from gear_dynamics_ros.signals import COLUMN, Commands

FLANK_STATES = {"drive": 1.0, "apart": 0.0, "back": -1.0}
CHANNEL_MEASURES = ("every", "smallest", "largest", "mean", "rms")
MEASURES = (*CHANNEL_MEASURES, "share")

_PROFILE_KEYS = ("description", "duration", "commands", "expectations")
_STEP_KEYS = ("at", "value")
_SPAN_KEYS = ("from", "to", "value", "amplitude", "frequency", "end_frequency")
_LIMIT_KEYS = ("minimum", "maximum", "target", "tolerance")
_EXPECTATION_KEYS = ("name", "from", "to", *MEASURES, *_LIMIT_KEYS)


@dataclass(frozen=True, slots=True)
class Segment:
    """A ramp from ``initial`` to ``final`` with a sine or a linear chirp on top; then it stays at ``final``.

    ``start`` and ``end`` in s (equal for a step), frequencies in Hz, the rest in the command's unit.
    """

    start: float
    end: float
    initial: float
    final: float
    amplitude: float = 0.0
    frequency: float = 0.0
    end_frequency: float = 0.0

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""
        if time >= self.end:
            return self.final
        length = self.end - self.start
        since = time - self.start
        level = self.initial + (self.final - self.initial) * since / length
        cycles = since * (self.frequency + 0.5 * (self.end_frequency - self.frequency) * since / length)
        return level + self.amplitude * math.sin(2.0 * math.pi * cycles)


@dataclass(frozen=True, slots=True)
class Track:
    """The segments of one command, in order of time."""

    segments: tuple[Segment, ...]

    def value(self, time: float) -> float | None:
        """Value at ``time`` in s, None before the first segment."""
        position = bisect_right(self.segments, time, key=lambda segment: segment.start)
        return self.segments[position - 1].value(time) if position else None

    @property
    def end(self) -> float:
        """Time from which the value stays, s."""
        return self.segments[-1].end

    @property
    def highest_frequency(self) -> float:
        """Highest frequency asked for, Hz; 0 without sines."""
        return max(max(segment.frequency, segment.end_frequency) for segment in self.segments)


@dataclass(frozen=True, slots=True)
class Expectation:
    """A measure of one channel over the samples with start <= time < end lies within [minimum, maximum].

    ``measure`` is one of MEASURES; for ``share`` the channel is meshing_state and ``state`` what is counted.
    """

    name: str
    measure: str
    channel: str
    state: float
    start: float
    end: float
    minimum: float
    maximum: float

    def describe(self) -> str:
        """Measure and channel in words."""
        if self.measure == "share":
            flank = next(name for name, state in FLANK_STATES.items() if state == self.state)
            return f"share of {flank}"
        return (
            f"{self.measure} {self.channel}"
            if self.measure == "every"
            else f"{self.measure} of {self.channel}"
        )

    def limits(self) -> str:
        """Limits in words."""
        if math.isinf(self.maximum):
            return f">= {self.minimum:.6g}"
        if math.isinf(self.minimum):
            return f"<= {self.maximum:.6g}"
        return f"{self.minimum:.6g} to {self.maximum:.6g}"


@dataclass(frozen=True, slots=True)
class Profile:
    """Commands over time and what the outputs are expected to show."""

    description: str
    duration: float
    commands: Mapping[str, Track]
    expectations: tuple[Expectation, ...]

    def unreached(self) -> tuple[Result, ...]:
        """The results before anything was played."""
        return tuple(Result(expectation, (), 0, 0, False) for expectation in self.expectations)


class Result(NamedTuple):
    """What became of one expectation."""

    expectation: Expectation
    values: tuple[
        float, ...
    ]  # what was measured: least and greatest for `every`, else one number; empty without samples
    samples: int
    missing: int  # samples of the window that never arrived
    complete: bool  # simulated time has passed the window's end

    @property
    def passed(self) -> bool:
        """True where every sample of the window was seen and the measure lies within the limits."""
        if not self.complete or self.missing or not self.values:
            return False
        return all(self.expectation.minimum <= value <= self.expectation.maximum for value in self.values)

    @property
    def status(self) -> str:
        """``pass``, ``FAIL``, or ``open`` while the window is not over."""
        if not self.complete:
            return "open"
        return "pass" if self.passed else "FAIL"

    def measured(self) -> str:
        """The measured values as text."""
        return " to ".join(f"{value:.6g}" for value in self.values) if self.values else "-"

    def reason(self) -> str:
        """Why it did not pass: name, window, value, limit."""
        expectation = self.expectation
        head = (
            f"{expectation.name}: {expectation.describe()} in {expectation.start:g} to {expectation.end:g} s"
        )
        if not self.complete:
            return f"{head} was not reached"
        if self.missing:
            return f"{head} lacks {self.missing} of {self.missing + self.samples} samples"
        return f"{head} is {self.measured()}, expected {expectation.limits()}"


def load_profile(path: Path) -> Profile:
    """Read a profile file. Raises UsageError in one line naming file, entry, value and limit."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"profile {path}: {reason}; name a readable YAML file") from error
    try:
        return parse_profile(parse_yaml(text))
    except UsageError as error:
        raise UsageError(f"profile {path}: {error}") from error


def parse_profile(data: object) -> Profile:
    """Profile from the tree of its YAML file. Raises UsageError on anything not understood."""
    tree = _mapping(data, "the profile", _PROFILE_KEYS)
    commands = _mapping(tree.get("commands", {}), "commands", Commands._fields)
    tracks = {name: _track(name, entries) for name, entries in commands.items()}
    expectations = tuple(
        _expectation(f"expectations[{position}]", entry)
        for position, entry in enumerate(_sequence(tree.get("expectations", []), "expectations"))
    )
    ends = [track.end for track in tracks.values()] + [expectation.end for expectation in expectations]
    last = max(ends, default=0.0)
    duration = _number(tree, "duration", "the profile") if "duration" in tree else last
    if duration < last:
        raise UsageError(
            f"duration is {duration:g} s, but an entry ends at {last:g} s: make it at least that long"
        )
    if duration <= 0.0:
        raise UsageError(f"duration is {duration:g} s, must be > 0: nothing to play")
    return Profile(_text(tree, "description", "the profile", ""), duration, tracks, expectations)


def _track(name: str, entries: object) -> Track:
    segments: list[Segment] = []
    for position, entry in enumerate(_sequence(entries, f"commands.{name}")):
        where = f"commands.{name}[{position}]"
        segment = _segment(where, entry, segments[-1].final if segments else None)
        if segments:
            _require_order(where, segment, segments[-1])
        segments.append(segment)
    if not segments:
        raise UsageError(f"commands.{name} is empty: give it at least one entry {{at: 0.0, value: X}}")
    return Track(tuple(segments))


def _require_order(where: str, segment: Segment, previous: Segment) -> None:
    if segment.start < previous.end or segment.start == previous.start:
        raise UsageError(
            f"{where} starts at {segment.start:g} s, before the entry above is over "
            f"({previous.start:g} to {previous.end:g} s): put the times in order"
        )


def _segment(where: str, entry: object, level: float | None) -> Segment:
    """One entry; ``level`` is the value in force before it."""
    if isinstance(entry, Mapping) and "at" in entry:
        step = _mapping(entry, where, _STEP_KEYS)
        start, value = _time(step, "at", where), _number(step, "value", where)
        return Segment(start, start, value, value)
    span = _mapping(entry, where, _SPAN_KEYS)
    start, end = _window(span, where)
    if level is None:
        raise UsageError(f"{where} starts from no known value: put {{at: {start:g}, value: X}} before it")
    if "value" not in span and "amplitude" not in span:
        raise UsageError(
            f"{where} has neither value nor amplitude: give a ramp its value, a sine its amplitude"
        )
    final = _number(span, "value", where) if "value" in span else level
    if "amplitude" not in span:
        spare = [key for key in ("frequency", "end_frequency") if key in span]
        if spare:
            raise UsageError(f"{where}.{spare[0]} has no amplitude beside it: add one or drop it")
        return Segment(start, end, level, final)
    frequency = _number(span, "frequency", where)
    end_frequency = _number(span, "end_frequency", where) if "end_frequency" in span else frequency
    for key, hertz in (("frequency", frequency), ("end_frequency", end_frequency)):
        if hertz <= 0.0:
            raise UsageError(f"{where}.{key} is {hertz:g} Hz, must be > 0")
    return Segment(start, end, level, final, _number(span, "amplitude", where), frequency, end_frequency)


def _expectation(where: str, entry: object) -> Expectation:
    tree = _mapping(entry, where, _EXPECTATION_KEYS)
    measures = [measure for measure in MEASURES if measure in tree]
    if len(measures) != 1:
        named = " and ".join(measures) or "none"
        raise UsageError(f"{where} must have exactly one of {', '.join(MEASURES)}; it has {named}")
    measure = measures[0]
    start, end = _window(tree, where)
    minimum, maximum = _limits(tree, where)
    channel, state = "meshing_state", 0.0
    if measure == "share":
        state = FLANK_STATES[_choice(tree, measure, where, tuple(FLANK_STATES))]
    else:
        channel = _choice(tree, measure, where, tuple(COLUMN))
    name = _text(tree, "name", where, f"{measure} {tree[measure]}")
    return Expectation(name, measure, channel, state, start, end, minimum, maximum)


def _limits(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    given = {key: _number(tree, key, where) for key in _LIMIT_KEYS if key in tree}
    if given.keys() == {"target", "tolerance"}:
        if given["tolerance"] < 0.0:
            raise UsageError(f"{where}.tolerance is {given['tolerance']:g}, must be >= 0")
        return given["target"] - given["tolerance"], given["target"] + given["tolerance"]
    if not given or given.keys() & {"target", "tolerance"}:
        raise UsageError(f"{where} must have minimum, maximum or both, or else target and tolerance")
    minimum, maximum = given.get("minimum", -math.inf), given.get("maximum", math.inf)
    if minimum > maximum:
        raise UsageError(f"{where}.minimum is {minimum:g}, above its maximum {maximum:g}")
    return minimum, maximum


def _window(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    start, end = _time(tree, "from", where), _time(tree, "to", where)
    if end <= start:
        raise UsageError(f"{where}.to is {end:g} s, must be later than its from, {start:g} s")
    return start, end


def _mapping(value: object, where: str, keys: Sequence[str]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise UsageError(f"{where} is {value!r}, must be a mapping with keys from {', '.join(keys)}")
    for key in value:
        if key not in keys:
            raise UsageError(f"{where} has the unknown key {key!r}; known: {', '.join(keys)}")
    return value


def _sequence(value: object, where: str) -> Sequence[object]:
    if not isinstance(value, list):
        raise UsageError(f"{where} is {value!r}, must be a list")
    return value


def _number(tree: Mapping[str, Any], key: str, where: str) -> float:
    if key not in tree:
        raise UsageError(f"{where} has no {key}: add it")
    value = tree[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{where}.{key} is {value!r}, must be a finite number")
    return float(value)


def _time(tree: Mapping[str, Any], key: str, where: str) -> float:
    value = _number(tree, key, where)
    if value < 0.0:
        raise UsageError(f"{where}.{key} is {value:g} s, must be >= 0")
    return value


def _text(tree: Mapping[str, Any], key: str, where: str, default: str) -> str:
    value = tree.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"{where}.{key} is {value!r}, must be text")
    return value


def _choice(tree: Mapping[str, Any], key: str, where: str, choices: Sequence[str]) -> str:
    value = tree[key]
    if value not in choices:
        raise UsageError(f"{where}.{key} is {value!r}, must be one of {', '.join(choices)}")
    return str(value)


class _Accumulator:
    """Running measure of one expectation over the samples ``first`` to before ``beyond``, from the origin."""

    def __init__(self, expectation: Expectation, column: int, interval_ns: int) -> None:
        self.expectation = expectation
        self.first = _samples_before(expectation.start, interval_ns)
        self.beyond = _samples_before(expectation.end, interval_ns)
        self._column = column
        self._count = 0
        self._least = math.inf
        self._greatest = -math.inf
        self._total = 0.0

    def add(self, first_sample: int, samples: NDArray[np.float64]) -> None:
        """Take in what lies in the window of ``samples`` (n, channels), the first being ``first_sample``."""
        begin, end = max(self.first - first_sample, 0), min(self.beyond - first_sample, len(samples))
        if begin >= end:
            return
        values = samples[begin:end, self._column]
        self._count += len(values)
        measure = self.expectation.measure
        if measure == "share":
            self._total += float(np.count_nonzero(values == self.expectation.state))
        elif measure == "mean":
            self._total += float(values.sum())
        elif measure == "rms":
            self._total += float(values @ values)
        else:
            # numpy's functions, not Python's: they hand a NaN on
            self._least = float(np.minimum(self._least, values.min()))
            self._greatest = float(np.maximum(self._greatest, values.max()))

    def result(self, reached: int) -> Result:
        """The result when the samples before ``reached`` have gone by."""
        gone_by = min(max(reached, self.first), self.beyond) - self.first
        values = self._values() if self._count else ()
        return Result(self.expectation, values, self._count, gone_by - self._count, reached >= self.beyond)

    def _values(self) -> tuple[float, ...]:
        match self.expectation.measure:
            case "every":
                return (self._least, self._greatest)
            case "smallest":
                return (self._least,)
            case "largest":
                return (self._greatest,)
            case "rms":
                return (math.sqrt(self._total / self._count),)
            case _:
                return (self._total / self._count,)


def _samples_before(time: float, interval_ns: int) -> int:
    return -(-round(time * 1e9) // interval_ns)


class Player:
    """Follows the simulated time of a gearbox through its waveform: tells commands, measures as it goes.

    The first chunk only sets the origin: profile time 0 is its end. Nothing of the waveform is stored.
    """

    def __init__(self, profile: Profile, channels: Sequence[str]) -> None:
        """``channels`` names the waveform's columns. Raises GearboxError where a needed one is missing."""
        needed = {"time": "to follow simulated time"}
        needed.update({e.channel: f"by expectation {e.name!r}" for e in profile.expectations})
        for channel, purpose in needed.items():
            if channel not in channels:
                raise GearboxError(
                    f"channel {channel} is needed {purpose}, but the waveform has {', '.join(channels)}: "
                    "add it to the gearbox's parameter waveform_channels"
                )
        self.profile = profile
        self._columns = {name: column for column, name in enumerate(channels)}
        self._accumulators: list[_Accumulator] = []
        self._interval_ns = 0
        self._origin = 0  # sample index of profile time 0
        self._reached = 0  # samples gone by since the origin

    @property
    def time_ns(self) -> int:
        """Profile time reached."""
        return self._reached * self._interval_ns

    @property
    def time(self) -> float:
        """Profile time reached, s."""
        return self.time_ns / 1e9

    @property
    def started_at(self) -> float:
        """Simulated time of the gearbox at profile time 0, s."""
        return self._origin * self._interval_ns / 1e9

    @property
    def finished(self) -> bool:
        """True once the whole profile has gone by."""
        return self._interval_ns > 0 and self.time_ns >= round(self.profile.duration * 1e9)

    def feed(self, samples: NDArray[np.float64]) -> dict[str, float]:
        """Take the next chunk, shape (n, channels); return the value of every command that is set by now.

        Raises GearboxError where simulated time runs backwards or the chunk can't carry the profile.
        """
        times = samples[:, self._columns["time"]]
        if not self._interval_ns:
            self._begin(times)
        else:
            self._take(times, samples)
        return self.commands()

    def commands(self) -> dict[str, float]:
        """The value of every command that is set by now."""
        values = {name: track.value(self.time) for name, track in self.profile.commands.items()}
        return {name: value for name, value in values.items() if value is not None}

    def results(self) -> tuple[Result, ...]:
        """The state of every expectation, in the profile's order."""
        if not self._interval_ns:
            return self.profile.unreached()
        return tuple(accumulator.result(self._reached) for accumulator in self._accumulators)

    def _begin(self, times: NDArray[np.float64]) -> None:
        if len(times) < 2:
            raise GearboxError(
                "a chunk has 1 sample, drive needs at least 2: raise the gearbox's solver.chunk"
            )
        self._interval_ns = max(1, round((times[-1] - times[0]) / (len(times) - 1) * 1e9))
        self._require_sampling(len(times) * self._interval_ns / 1e9)
        self._origin = self._index(times[-1]) + 1
        self._accumulators = [
            _Accumulator(expectation, self._columns[expectation.channel], self._interval_ns)
            for expectation in self.profile.expectations
        ]

    def _require_sampling(self, chunk: float) -> None:
        limit = 0.5 / chunk
        for name, track in self.profile.commands.items():
            if track.highest_frequency > limit:
                raise GearboxError(
                    f"commands.{name} asks for {track.highest_frequency:g} Hz, but one command in each chunk "
                    f"of {chunk:g} s carries at most {limit:g} Hz: lower it or shorten solver.chunk"
                )

    def _take(self, times: NDArray[np.float64], samples: NDArray[np.float64]) -> None:
        first = self._index(times[0]) - self._origin
        if first < self._reached:
            raise GearboxError(
                f"simulated time went back from {self.started_at + self.time:g} s to {times[0]:g} s: "
                "the gearbox was restarted, or two of them publish under this name"
            )
        for accumulator in self._accumulators:
            accumulator.add(first, samples)
        self._reached = first + len(samples)

    def _index(self, time: float) -> int:
        return round(time * 1e9 / self._interval_ns)


def format_results(results: Sequence[Result]) -> str:
    """A table of the results, one line each, aligned."""
    rows = [
        (
            result.status,
            result.expectation.name,
            f"{result.expectation.start:g} to {result.expectation.end:g} s",
            result.expectation.describe(),
            result.measured(),
            result.expectation.limits(),
        )
        for result in results
    ]
    table = [("", "expectation", "window", "measure", "measured", "expected"), *rows]
    widths = [max(len(row[column]) for row in table) for column in range(6)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
