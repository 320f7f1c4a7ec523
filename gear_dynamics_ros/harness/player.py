"""Plays a profile in step with the simulated time of a gearbox, and measures its waveform."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness.expectations import Expectation
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import Result, unreached
from gear_dynamics_ros.parameters.decimals import exact_text


class _WindowMeasurement:
    """Measures one expectation over the samples [first, end), counted from the origin."""

    def __init__(self, expectation: Expectation, column: int, interval_ns: int) -> None:
        self._expectation = expectation
        self._first = _samples_before(expectation.start, interval_ns)
        self._end = _samples_before(expectation.end, interval_ns)
        self._column = column
        self._count = 0
        self._measured = expectation.measure.begin(interval_ns)

    def add(self, first_sample: int, samples: NDArray[np.float64]) -> None:
        """Take in what lies in the window of ``samples`` (n, channels), from index ``first_sample`` on."""
        start, end = max(self._first - first_sample, 0), min(self._end - first_sample, len(samples))
        if start < end:
            self._measured.add(samples[start:end, self._column])
            self._count += end - start

    def result(self, reached: int) -> Result:
        """The result once simulated time has reached the sample ``reached``."""
        passed = min(max(reached, self._first), self._end) - self._first
        values = self._measured.values() if self._count else ()
        missing = passed - self._count
        return Result(self._expectation, values, self._count, missing, reached >= self._end)


def _samples_before(time: float, interval_ns: int) -> int:
    return -(-round(time * 1e9) // interval_ns)


class Player:
    """Follows the simulated time of a gearbox by its waveform: gives the commands due, and measures.

    The first chunk only sets the origin: profile time 0 is its end. The waveform is not stored.
    """

    def __init__(self, profile: Profile, channels: Sequence[str]) -> None:
        """``channels`` names the waveform's columns. Raises GearboxError if a needed one is missing."""
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
        self._windows: list[_WindowMeasurement] = []
        self._interval_ns = 0
        self._origin = 0  # sample index of profile time 0
        self._reached = 0  # samples since the origin

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
        """Whether the whole profile has been played."""
        return self._interval_ns > 0 and self.time_ns >= round(self.profile.duration * 1e9)

    def feed(self, samples: NDArray[np.float64]) -> None:
        """Take the next chunk, shape (n, channels).

        Raises GearboxError if simulated time runs backwards, the chunk has a single sample, or chunks are too
        long for a frequency in the profile.
        """
        times = samples[:, self._columns["time"]]
        if not self._interval_ns:
            self._set_origin(times)
        else:
            self._measure(times, samples)

    def commands(self) -> dict[str, float]:
        """The value of every command that the profile has set by now, by name."""
        values = {name: track.value(self.time) for name, track in self.profile.commands.items()}
        return {name: value for name, value in values.items() if value is not None}

    def results(self) -> tuple[Result, ...]:
        """The results so far, one for each expectation in the profile's order."""
        if not self._interval_ns:
            return unreached(self.profile.expectations)
        return tuple(window.result(self._reached) for window in self._windows)

    def _set_origin(self, times: NDArray[np.float64]) -> None:
        if len(times) < 2:
            raise GearboxError(
                "a chunk has 1 sample, drive needs at least 2: raise the gearbox's solver.chunk"
            )
        self._interval_ns = max(1, round((times[-1] - times[0]) / (len(times) - 1) * 1e9))
        self._require_sampling(len(times) * self._interval_ns / 1e9)
        self._origin = self._index(times[-1]) + 1
        self._windows = [
            _WindowMeasurement(expectation, self._columns[expectation.channel], self._interval_ns)
            for expectation in self.profile.expectations
        ]

    def _require_sampling(self, chunk: float) -> None:
        limit = 0.5 / chunk
        for name, track in self.profile.commands.items():
            if track.highest_frequency > limit:
                raise GearboxError(
                    f"commands.{name} asks for {exact_text(track.highest_frequency)} Hz, but one command in "
                    f"each chunk of {exact_text(chunk)} s carries at most {exact_text(limit)} Hz: lower it "
                    "or shorten solver.chunk"
                )

    def _measure(self, times: NDArray[np.float64], samples: NDArray[np.float64]) -> None:
        first = self._index(times[0]) - self._origin
        if first < self._reached:
            raise GearboxError(
                f"simulated time went back from {self.started_at + self.time:g} s to {times[0]:g} s: "
                "the gearbox was restarted, or two of them publish under this name"
            )
        for window in self._windows:
            window.add(first, samples)
        self._reached = first + len(samples)

    def _index(self, time: float) -> int:
        return round(time * 1e9 / self._interval_ns)
