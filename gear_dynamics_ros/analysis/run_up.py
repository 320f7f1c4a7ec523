"""Run-ups: where the speed rises or falls far, and spectra of the DTE over the speed there."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import TURN
from gear_dynamics_ros.analysis.statistics import Envelope
from gear_dynamics_ros.analysis.summary import TimeSpan
from gear_dynamics_ros.chunk import Samples

RUN_UP_CHANNELS: Final = ("dte", "driving_speed")
LEAST_CHANGE: Final = 0.2  # of the highest speed, from which on a change of speed is a run-up
RELAPSE: Final = 0.02  # of the whole range of speeds: falling back by more ends a run-up
FLAT_ENDS: Final = 0.02  # of the change, cut off where it begins and ends
SMOOTHED: Final = 256  # intervals in which the mean speed is looked at
SPEEDS: Final = 160  # columns of the map
MIN_FRAME, MAX_FRAME = 256, 16384  # samples of one spectrum
FRAMES: Final = 32  # transformed at once
FOLLOWED_ORDER: Final = 2.0  # mesh order that moves by one bin during a frame


class RunUp(NamedTuple):
    """A stretch of a run in which the speed of the driving gear rises or falls."""

    span: TimeSpan
    begin_speed: float  # rad/s
    end_speed: float  # rad/s

    @property
    def rises(self) -> bool:
        """Whether it is a run-up, not a coast-down."""
        return abs(self.end_speed) > abs(self.begin_speed)


def find_run_up(envelope: Envelope) -> RunUp | None:
    """The greatest rise or fall of the speed in a run; None if there is none, or no speed was recorded."""
    if "driving_speed" not in envelope.names:
        return None
    low, high = envelope.bounds("driving_speed")
    together = -(-len(low) // SMOOTHED)
    starts = np.arange(0, len(low), together)
    counts = np.diff(np.append(starts, len(low)))
    speeds = np.abs(np.add.reduceat(0.5 * (low + high), starts) / counts)
    times = np.add.reduceat(envelope.times(), starts) / counts
    begin, end = max(
        (_greatest_rise(speeds), _greatest_rise(-speeds)), key=lambda ends: _change(speeds, ends)
    )
    if _change(speeds, (begin, end)) < LEAST_CHANGE * speeds.max():
        return None
    begin, end = _without_flat_ends(speeds, begin, end)
    return RunUp(TimeSpan(float(times[begin]), float(times[end])), float(speeds[begin]), float(speeds[end]))


def _change(speeds: NDArray[np.float64], ends: tuple[int, int]) -> float:
    return abs(float(speeds[ends[1]] - speeds[ends[0]]))


def _greatest_rise(speeds: NDArray[np.float64]) -> tuple[int, int]:
    """First and last index of the greatest rise in which no relapse exceeds RELAPSE."""
    allowed = RELAPSE * float(np.ptp(speeds))
    best = start = top = 0
    best_end = 0
    for index, speed in enumerate(speeds):
        if speed < speeds[start] or speeds[top] - speed > allowed:
            start = top = index
        elif speed > speeds[top]:
            top = index
        if speeds[top] - speeds[start] > speeds[best_end] - speeds[best]:
            best, best_end = start, top
    return best, best_end


def _without_flat_ends(speeds: NDArray[np.float64], begin: int, end: int) -> tuple[int, int]:
    course = np.abs(speeds[begin : end + 1] - speeds[begin])
    slack = FLAT_ENDS * course[-1]
    first = int(np.flatnonzero(course <= slack)[-1])
    last = int(np.flatnonzero(course >= course[-1] - slack)[0])
    return begin + first, begin + max(last, first + 1)


class SpeedSpectra:
    """Amplitude spectra of the DTE over speed, frame by frame of a run-up in bounded memory.

    Hann windows, half overlapping: a steady line shows with 0.85 of its amplitude or more. Of several frames
    at one speed, the greatest amplitude at each frequency is kept.
    """

    def __init__(self, run_up: RunUp, teeth: int, interval: float) -> None:
        """``teeth`` of the driving gear; samples come every ``interval`` s."""
        self.run_up = run_up
        self.interval = interval
        self.load = 0.0  # N m, mean of the magnitude, where recorded
        self._load_samples = 0
        self.mesh_per_speed = teeth / TURN  # Hz by rad/s
        self.frame = frame_length(run_up, self.mesh_per_speed, interval)
        self._weights = np.hanning(self.frame + 1)[:-1]
        slowest, fastest = sorted((run_up.begin_speed, run_up.end_speed))
        self.speed_edges = np.linspace(slowest, fastest, SPEEDS + 1)
        self._amplitudes = np.full((SPEEDS, self.frame // 2 + 1), -1.0)
        self._kept = np.zeros((0, 2))
        self.frames = 0  # taken in

    def add(self, samples: Samples) -> None:
        """Take in a block of samples with RUN_UP_CHANNELS, later than those before."""
        rows = np.vstack([self._kept, np.column_stack([samples[name] for name in RUN_UP_CHANNELS])])
        hop = self.frame // 2
        count = max(0, (len(rows) - self.frame) // hop + 1)
        for first in range(0, count, FRAMES):
            frames = [rows[hop * k : hop * k + self.frame] for k in range(first, min(first + FRAMES, count))]
            self._add_frames(np.stack(frames))
        self._kept = rows[hop * count :]
        if samples.has("load_torque"):
            self.load += float(np.abs(samples["load_torque"]).sum())
            self._load_samples += len(samples)

    def _add_frames(self, frames: NDArray[np.float64]) -> None:
        """Take in ``frames``, shape (n, frame, 2)."""
        dte, speed = frames[..., 0], np.abs(frames[..., 1]).mean(axis=1)
        weighted = (dte - dte.mean(axis=1, keepdims=True)) * self._weights
        amplitudes = 2.0 / self._weights.sum() * np.abs(np.fft.rfft(weighted, axis=1))
        places = np.searchsorted(self.speed_edges, speed, side="right") - 1
        inside = (places >= 0) & (places < SPEEDS)
        np.maximum.at(self._amplitudes, places[inside], amplitudes[inside])
        self.frames += int(np.count_nonzero(inside))

    def mean_load(self) -> float | None:
        """Mean of |load torque| in N m, None if it wasn't recorded."""
        return self.load / self._load_samples if self._load_samples else None

    def amplitudes(self) -> NDArray[np.float64]:
        """Amplitude in m, shape (SPEEDS, frequencies); a speed without a frame has its neighbour's.

        Raises ValueError if no frame fitted into the samples.
        """
        filled = np.flatnonzero(self._amplitudes[:, 0] >= 0.0)
        if not len(filled):
            raise ValueError("no frame of the run-up has been added")
        nearest = np.abs(np.arange(SPEEDS)[:, None] - filled).argmin(axis=1)
        amplitudes: NDArray[np.float64] = self._amplitudes[filled[nearest]]
        return amplitudes

    def frequencies(self) -> NDArray[np.float64]:
        """Frequencies of ``amplitudes`` in Hz."""
        return np.asarray(np.fft.rfftfreq(self.frame, self.interval), dtype=np.float64)


def frame_length(run_up: RunUp, mesh_per_speed: float, interval: float) -> int:
    """Samples of a frame, a power of 2, during which FOLLOWED_ORDER moves by about one bin."""
    duration = run_up.span.end - run_up.span.start
    rate = FOLLOWED_ORDER * mesh_per_speed * abs(run_up.end_speed - run_up.begin_speed) / duration
    wanted = 1.0 / (math.sqrt(rate) * interval)
    return int(min(max(2 ** round(math.log2(wanted)), MIN_FRAME), MAX_FRAME))
