"""Plays a profile in step with the simulated time of a gearbox, and measures its waveform."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness.expectations import Expectation
from gear_dynamics_ros.harness.outcome import ActedCommand, ChannelBounds, PlayedSamples
from gear_dynamics_ros.harness.profile import Profile, require_sampling
from gear_dynamics_ros.harness.results import Result, unreached
from gear_dynamics_ros.harness.time_axis import Stretch, TimeAxis
from gear_dynamics_ros.harness.traces import Trace

# Channels that the report shows beside those of the expectations, where the waveform has them.
CONTEXT: Final = ("driving_speed", "drive_torque", "load_torque")


class _WindowMeasurement:
    """Measures one expectation over the positions [first, end) of the time axis."""

    def __init__(self, expectation: Expectation, column: int, scope: int, interval_ns: int) -> None:
        """``scope`` is the position from which commands matter: its start, or that of an entry before."""
        self._expectation = expectation
        self._scope = scope
        self._first = samples_before(expectation.start, interval_ns)
        self._end = samples_before(expectation.end, interval_ns)
        self._column = column
        self._count = 0
        self._missing = 0
        self._measured = expectation.measure.begin(interval_ns)
        self.trace = Trace(self._first, self._end)

    def add(self, stretch: Stretch, samples: NDArray[np.float64] | None) -> None:
        """Take in what lies in the window of ``samples`` (n, channels), None if they were lost.

        While the axis stands still at a boundary of the window, its samples are in neither of both sides.
        """
        start, end = 0, stretch.end - stretch.first
        if stretch.moves:
            start, end = max(self._first - stretch.position, 0), min(self._end - stretch.position, end)
        elif not self._first < stretch.position < self._end:
            return
        if start >= end:
            return
        if samples is None:
            self._missing += end - start
        else:
            column = samples[start:end, self._column]
            self._measured.add(column)
            self.trace.add(stretch.part(start, end), column)
            self._count += end - start

    def result(self, position: int, left_out: Sequence[int]) -> Result:
        """The result when ``position`` is reached; ``left_out`` are positions of values never in force."""
        values = self._measured.values() if self._count else ()
        lacking = sum(self._scope < other < self._end for other in left_out)
        return Result(self._expectation, values, self._count, self._missing, position >= self._end, lacking)


def samples_before(time: float, interval_ns: int) -> int:
    """Number of samples before ``time`` (s), that of sample 0 being 0."""
    return -(-round(time * 1e9) // interval_ns)


class Player:
    """Follows the simulated time of a gearbox by its waveform: gives the commands due, and measures.

    The first chunk only sets the origin: profile time 0 is its end. From there the time axis of the profile
    follows the commands that acted. If the profile has expectations, the player waits where an entry of a
    command starts or ends until the command is in force, so that no entry overtakes the one before it.
    Only the samples whose position on the axis is not known yet are stored.
    """

    def __init__(
        self,
        profile: Profile,
        channels: Sequence[str],
        accepts: Callable[[str, float], bool] = lambda name, value: True,
    ) -> None:
        """``channels`` names the waveform's columns; ``accepts`` says if the gearbox takes a command.

        Raises GearboxError if a channel that is needed is missing.
        """
        needed = {"time": "to follow simulated time"}
        needed.update({e.channel: f"by expectation {e.name!r}" for e in profile.expectations})
        for channel, purpose in needed.items():
            if channel not in channels:
                raise GearboxError(
                    f"channel {channel} is needed {purpose}, but the waveform has {', '.join(channels)}: "
                    "add it to the gearbox's parameter waveform_channels"
                )
        self.profile = profile
        self._accepts = accepts
        self._names = [*needed, *(name for name in CONTEXT if name in channels and name not in needed)]
        self._columns = [channels.index(channel) for channel in self._names]
        self._windows: list[_WindowMeasurement] = []
        self._traces: dict[str, Trace] = {}  # of channels over the whole profile
        self._interval_ns = 0
        self._origin = 0  # sample index of profile time 0
        self._reached = 0  # samples since the origin
        self._position = 0  # on the time axis, for which commands are given
        self._knots: list[int] = []  # positions to wait at, in order
        self._axis = TimeAxis()
        self._in_force: Commands | None = None
        self._given: dict[str, float] = {}  # commands up to now, by name
        self._blocks: list[tuple[int, NDArray[np.float64]]] = []  # first sample, samples; not measured yet

    @property
    def time_ns(self) -> int:
        """Profile time reached."""
        return self._position * self._interval_ns

    @property
    def time(self) -> float:
        """Profile time reached, s."""
        return self.time_ns / 1e9

    @property
    def simulated(self) -> float:
        """Simulated time since profile time 0, s."""
        return self._reached * self._interval_ns / 1e9

    @property
    def next_sample(self) -> int:
        """Index of the sample after the last one that was taken."""
        return self._origin + self._reached

    @property
    def started_at(self) -> float:
        """Simulated time of the gearbox at profile time 0, s."""
        return self._origin * self._interval_ns / 1e9

    @property
    def finished(self) -> bool:
        """Whether the whole profile has been played, and measured."""
        if not self._interval_ns:
            return False
        position = self._axis.position if self.profile.expectations else self._position
        return position >= samples_before(self.profile.duration, self._interval_ns)

    @property
    def awaiting(self) -> dict[str, float]:
        """The commands that were given and are not in force, by name."""
        return self._axis.awaiting

    @property
    def lateness(self) -> list[float]:
        """By how much each command acted after it was due, s of simulated time."""
        return [acted.late * self._interval_ns / 1e9 for acted in self._axis.values_acted]

    def begin(self, sample: int, interval_ns: int) -> None:
        """Let profile time 0 be at ``sample`` (index); samples are ``interval_ns`` apart."""
        self._interval_ns = interval_ns
        self._origin = sample
        if self.profile.expectations:
            self._knots = sorted({-(-time_ns // interval_ns) for time_ns in self.profile.knots_ns})
        self._windows = [self._window(expectation) for expectation in self.profile.expectations]
        end = samples_before(self.profile.duration, interval_ns)
        self._traces = {name: Trace(0, end) for name in self._names[1:]}
        self._advance(0)

    def feed(self, samples: NDArray[np.float64]) -> None:
        """Take the next chunk, shape (n, channels).

        Raises GearboxError if simulated time runs backwards, the first chunk has a single sample, or chunks
        are too long for a frequency in the profile.
        """
        if not self._interval_ns:
            self._set_origin(samples[:, self._columns[0]])
        else:
            self._take(samples)

    def acted(self, sample: int, commands: Commands) -> None:
        """Note that ``commands`` are in force from ``sample`` (index) on."""
        self._in_force = commands
        self._axis.acted(sample - self._origin, commands)
        self._measure()

    def commands(self) -> dict[str, float]:
        """The value of every command that the profile has set by now, by name."""
        return dict(self._given)

    def results(self) -> tuple[Result, ...]:
        """The results so far, one for each expectation in the profile's order."""
        if not self._interval_ns:
            return unreached(self.profile.expectations)
        axis = self._axis
        return tuple(window.result(axis.position, axis.left_out) for window in self._windows)

    def samples(self) -> PlayedSamples:
        """What the waveform showed so far."""
        interval_ns = self._interval_ns
        return PlayedSamples(
            windows=[ChannelBounds(*window.trace.bounds(interval_ns)) for window in self._windows],
            channels={
                name: ChannelBounds(*trace.bounds(interval_ns)) for name, trace in self._traces.items()
            },
            started_at=self.started_at,
            reached=self.time,
            acted=[
                ActedCommand(
                    acted.name,
                    acted.value,
                    acted.position * interval_ns / 1e9,
                    acted.late * interval_ns / 1e9,
                )
                for acted in self._axis.values_acted
            ],
        )

    def _set_origin(self, times: NDArray[np.float64]) -> None:
        if len(times) < 2:
            raise GearboxError(
                "a chunk has 1 sample, drive needs at least 2: raise the gearbox's solver.chunk"
            )
        interval_ns = max(1, round((times[-1] - times[0]) / (len(times) - 1) * 1e9))
        require_sampling(self.profile, len(times) * interval_ns / 1e9)
        self.begin(_index(times[-1], interval_ns) + 1, interval_ns)

    def _window(self, expectation: Expectation) -> _WindowMeasurement:
        first = samples_before(expectation.start, self._interval_ns)
        scope = max((knot for knot in self._knots if knot <= first), default=first)
        column = self._names.index(expectation.channel)
        return _WindowMeasurement(expectation, column, scope, self._interval_ns)

    def _take(self, samples: NDArray[np.float64]) -> None:
        time = samples[0, self._columns[0]]
        first = _index(time, self._interval_ns) - self._origin
        if first < self._reached:
            raise GearboxError(
                f"simulated time went back from {self.started_at + self.simulated:g} s to {time:g} s: "
                "the gearbox was restarted, or two of them publish under this name"
            )
        if self._windows:
            self._blocks.append((first, samples[:, self._columns]))
        elapsed = first + len(samples) - self._reached
        self._reached += elapsed
        self._advance(elapsed)
        self._measure()

    def _advance(self, elapsed: int) -> None:
        """Give the commands that are due ``elapsed`` samples later."""
        target = self._position + elapsed
        if self.profile.expectations and not self._axis.awaiting:
            target = self._axis.position_at(self._reached)
        while self._knots and self._knots[0] <= target:
            self._give(self._knots[0], target)
            if self._axis.awaiting:
                return
            del self._knots[0]
        self._give(target, target)

    def _give(self, position: int, target: int) -> None:
        """Give the commands due at ``position``; the last sample has reached the position ``target``."""
        self._position = max(self._position, position)
        time = self.time
        for name, track in self.profile.commands.items():
            value = track.value(time)
            if value is None or value == self._given.get(name):
                continue
            self._given[name] = value
            if self._accepts(name, value) and not self._is_in_force(name, value):
                due = min(samples_before(track.since(time), self._interval_ns), position)
                self._axis.expect(name, value, due, self._reached - (target - due))

    def _is_in_force(self, name: str, value: float) -> bool:
        in_force = self._in_force
        return in_force is not None and name not in self._axis.awaiting and getattr(in_force, name) == value

    def _measure(self) -> None:
        """Hand the samples whose positions are known to the windows."""
        for stretch in self._axis.resolve(self._reached):
            done = stretch.first
            for first, samples in self._blocks:
                start, end = max(first, done), min(first + len(samples), stretch.end)
                if start >= end:
                    continue
                self._add(stretch, done, start, None)
                self._add(stretch, start, end, samples[start - first : end - first])
                done = end
            self._add(stretch, done, stretch.end, None)
            self._blocks = [block for block in self._blocks if block[0] + len(block[1]) > stretch.end]

    def _add(self, stretch: Stretch, first: int, end: int, samples: NDArray[np.float64] | None) -> None:
        """Give the samples [first, end) of ``stretch`` to all windows."""
        if first < end:
            position = stretch.position + (first - stretch.first if stretch.moves else 0)
            part = Stretch(first, end, position, stretch.moves)
            for window in self._windows:
                window.add(part, samples)
            if samples is not None:
                for column, trace in enumerate(self._traces.values(), start=1):
                    trace.add(part, samples[:, column])


def _index(time: float, interval_ns: int) -> int:
    return round(time * 1e9 / interval_ns)
