"""Chooses short windows of a run to play slowly: where teeth lose contact, where back flanks strike."""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.viewer.scales import round_down

PERIODS_BEFORE: Final = 1.5  # mesh periods of a window before what it shows
PERIODS_AFTER: Final = 6.5
CLEARLY_APART: Final = 0.75  # of half the backlash: DTE below it is contact lost that one sees
LONGEST: Final = 0.02  # s of a window
MOST_SAMPLES: Final = 4000  # of a window
SETTLING: Final = 0.05  # s after the start that are not chosen
PERIOD_SHOWN: Final = 1.0  # s on the slow timeline that a mesh period takes at most
GREATEST_FACTOR: Final = 1.0e5
DEFAULT_FACTOR: Final = 1000.0

Values = NDArray[np.float64]


class Subject(IntEnum):
    """What a window shows; a later window is shown too if it shows more."""

    STEADY = 0
    CONTACT_LOST = 1
    BACK_STRUCK = 2


class SlowWindow(NamedTuple):
    """Consecutive samples to play slowly."""

    subject: Subject
    first_sample: int
    rows: Values  # (n, 28)
    factor: float  # s on the slow timeline per s of simulated time


class _Pending(NamedTuple):
    subject: Subject
    begin: int  # first sample of the window
    end: int  # sample behind its last


def back_struck(rows: Values) -> NDArray[np.bool_]:
    """Where the back flanks are in contact, of samples (n, 28)."""
    return np.asarray(rows[:, COLUMN["meshing_state"]] < 0.0)


def contact_lost(rows: Values) -> NDArray[np.bool_]:
    """Where contact is lost so far that one sees it, of samples (n, 28)."""
    far = rows[:, COLUMN["dte"]] < CLEARLY_APART * rows[:, COLUMN["half_backlash"]]
    return np.asarray((rows[:, COLUMN["meshing_state"]] == 0.0) & far)


class SlowMotionChooser:
    """Finds windows in a run, as its samples come; keeps the last blocks of samples as they are."""

    def __init__(self, teeth: int, interval: float) -> None:
        """``teeth`` of the driving gear; ``interval`` between samples, s."""
        self._teeth = teeth
        self._interval = interval
        self._most = max(2, min(MOST_SAMPLES, round(LONGEST / interval)))
        self._blocks: deque[tuple[int, Values]] = deque()  # contiguous: first sample, samples
        self._settled: int | None = None  # the first sample that may be chosen
        self._best = Subject.STEADY
        self._pending: _Pending | None = None

    def add(self, first_sample: int, rows: Values) -> list[SlowWindow]:
        """Take in contiguous samples (n, 28), n > 0; returns the windows that are complete with them.

        ``rows`` must not change afterwards.
        """
        if self._settled is None:
            self._settled = first_sample + round(SETTLING / self._interval)
        if self._end != first_sample:  # samples are missing
            self._pending = None
            self._blocks.clear()
        self._blocks.append((first_sample, rows))
        done: list[SlowWindow] = []
        since = max(first_sample, self._settled)
        while True:
            if self._pending is None:
                self._pending = self._find(since)
            if self._pending is None or self._pending.end > self._end:
                break
            done.append(self._cut(self._pending))
            self._best = done[-1].subject
            since, self._pending = self._pending.end, None
        self._forget()
        return done

    def last(self) -> SlowWindow | None:
        """The last samples, if no window has been shown and there are any."""
        if self._best is not Subject.STEADY or self._end - self._begin < 2:
            return None
        before, after = self._reach(self._blocks[-1][1][-1])
        begin = max(self._begin, self._end - before - after)
        return self._cut(_Pending(Subject.STEADY, begin, self._end))

    @property
    def _begin(self) -> int:
        return self._blocks[0][0] if self._blocks else 0

    @property
    def _end(self) -> int:
        return self._blocks[-1][0] + len(self._blocks[-1][1]) if self._blocks else 0

    def _find(self, since: int) -> _Pending | None:
        """The first event in the newest block, from sample ``since`` on, that shows more than any so far."""
        first_sample, rows = self._blocks[-1]
        previous = self._blocks[-2][1][-1:] if len(self._blocks) > 1 else rows[:1]
        shows = {Subject.BACK_STRUCK: back_struck, Subject.CONTACT_LOST: contact_lost}
        found: list[tuple[int, Subject]] = []
        for subject, test in shows.items():
            if subject > self._best:
                shown = test(rows)
                began = np.flatnonzero(shown & ~np.concatenate([test(previous), shown[:-1]]))
                began = began[began + first_sample >= since]
                found += [(int(index), subject) for index in began[:1]]
        if not found:
            return None
        at, subject = min(found, key=lambda event: event[0])
        before, after = self._reach(rows[at])
        sample = first_sample + at
        return _Pending(subject, max(self._begin, sample - before), sample + after)

    def _reach(self, row: Values) -> tuple[int, int]:
        """Samples of a window before and from an event at the sample ``row`` (28,)."""
        period = 1.0 / max(self._mesh_frequency(row), 1e-9)
        samples = min(self._most, (PERIODS_BEFORE + PERIODS_AFTER) * period / self._interval)
        before = samples * PERIODS_BEFORE / (PERIODS_BEFORE + PERIODS_AFTER)
        return round(before), max(2, round(samples - before))

    def _cut(self, pending: _Pending) -> SlowWindow:
        parts = [
            rows[max(0, pending.begin - first) : max(0, pending.end - first)] for first, rows in self._blocks
        ]
        window = np.concatenate(parts)
        frequency = self._mesh_frequency(window[len(window) // 2])
        factor = round_down(frequency * PERIOD_SHOWN) if frequency > 1.0 else DEFAULT_FACTOR
        subject = Subject.BACK_STRUCK if back_struck(window).any() else pending.subject
        return SlowWindow(subject, pending.begin, window, min(factor, GREATEST_FACTOR))

    def _forget(self) -> None:
        needed = self._end - self._most
        if self._pending is not None:
            needed = min(needed, self._pending.begin)
        while len(self._blocks) > 1 and self._blocks[1][0] <= needed:
            self._blocks.popleft()

    def _mesh_frequency(self, row: Values) -> float:
        speed = abs(float(row[COLUMN["driving_speed"]]))
        return self._teeth * speed / (2.0 * math.pi) if math.isfinite(speed) else 0.0
