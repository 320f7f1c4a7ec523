"""What a channel did over the time axis of a profile, in bounded memory: minimum and maximum of intervals."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.harness.time_axis import Stretch

MOST_INTERVALS: Final = 600


class Trace:
    """Minimum and maximum of one channel over the positions [first, end) of the time axis."""

    def __init__(self, first: int, end: int) -> None:
        """The positions are divided into at most MOST_INTERVALS intervals of equal length."""
        self._first = first
        self._end = end
        self._width = max(1, -(-(end - first) // MOST_INTERVALS))
        count = max(1, -(-(end - first) // self._width))
        self._low, self._high = np.full(count, np.inf), np.full(count, -np.inf)

    def add(self, stretch: Stretch, samples: NDArray[np.float64]) -> None:
        """Take in the samples of ``stretch``, shape (n,), of which those at its positions count.

        While the axis stands still, all are at its position.
        """
        offset = stretch.position - self._first
        if not stretch.moves:
            if 0 <= offset < self._end - self._first:
                self._join(np.array([offset // self._width]), samples, np.array([0]))
            return
        start, end = max(0, -offset), min(len(samples), self._end - stretch.position)
        if start < end:
            bins = (offset + np.arange(start, end)) // self._width
            starts = np.flatnonzero(np.diff(bins, prepend=-1))
            self._join(bins[starts], samples[start:end], starts)

    def _join(
        self, touched: NDArray[np.int64], samples: NDArray[np.float64], starts: NDArray[np.int64]
    ) -> None:
        self._low[touched] = np.fmin(self._low[touched], np.fmin.reduceat(samples, starts))
        self._high[touched] = np.fmax(self._high[touched], np.fmax.reduceat(samples, starts))

    def bounds(
        self, interval_ns: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Time in s, minimum and maximum of each interval that has samples, shape (n,) each.

        Samples are ``interval_ns`` apart. Intervals of which all samples are NaN are left out.
        """
        filled = np.flatnonzero(self._low <= self._high)
        middle = self._first + filled * self._width + 0.5 * (self._width - 1)
        time = np.asarray(middle * (interval_ns / 1e9), dtype=np.float64)
        return time, self._low[filled], self._high[filled]
