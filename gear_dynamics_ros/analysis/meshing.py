"""How long the teeth are in contact, from the instants between samples at which their gaps close and open."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import MeshingShares, lagrange_weights
from gear_dynamics_ros.chunk import Samples

HALVINGS: Final = 24  # of a sample interval, to find where a gap closes or opens
NEIGHBOURS: Final = 3  # samples kept from block to block: the cubic needs one before and two after


def contact_fractions(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fraction of each sample interval during which ``depth`` is positive, shape (n - 3,).

    ``depth`` (n,) is how deep a flank is pressed in, negative where there is a gap. The first interval and
    the last are left out. Where the sign changes, the cubic through the two samples before and the two after
    gives the instant; a contact or gap between two samples is not seen.
    """
    before, after = depth[1:-2] > 0.0, depth[2:-1] > 0.0
    fraction = before.astype(np.float64)
    (changed,) = np.nonzero(before != after)
    around = [depth[changed + offset] for offset in range(4)]
    low, high = np.zeros(len(changed)), np.ones(len(changed))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        value = sum(w * y for w, y in zip(lagrange_weights(middle), around, strict=True))
        ahead = (value > 0.0) == before[changed]  # of the instant
        low, high = np.where(ahead, middle, low), np.where(ahead, high, middle)
    instant = 0.5 * (low + high)
    fraction[changed] = np.where(before[changed], instant, 1.0 - instant)
    return fraction


class MeshingTimeline:
    """Shares of the meshing states in each of at most ``capacity`` intervals of a run, and of all of it.

    From the event times where ``dte`` and ``half_backlash`` are recorded, otherwise from the number of
    samples in each ``meshing_state``. The intervals double in length whenever a run gets too long for them.
    """

    def __init__(self, capacity: int = 1024) -> None:
        self._capacity = capacity
        self._width = 1
        self._first: int | None = None
        self._sums = np.zeros(
            (capacity, 3)
        )  # sample intervals on the drive flank, on the back flank, and all
        self._kept = np.zeros((0, 2))
        self._next: int | None = None  # sample after those added
        self._interval = 0.0
        self.from_events = False

    def add(self, samples: Samples) -> None:
        """Take in a block of samples, later than those before; the same channels in every call."""
        if samples.has("dte", "half_backlash"):
            self.from_events = True
            self._add_motion(samples)
        elif samples.has("meshing_state"):
            state = samples["meshing_state"]
            self._add_fractions(samples.first, samples.interval, state > 0.0, state < 0.0)

    def _add_motion(self, samples: Samples) -> None:
        if samples.first != self._next:  # samples are missing before these
            self._kept = self._kept[:0]
        self._next = samples.first + len(samples)
        motion = np.vstack([self._kept, np.column_stack([samples["dte"], samples["half_backlash"]])])
        self._kept = motion[-NEIGHBOURS:]
        if len(motion) > NEIGHBOURS:
            dte, half = motion.T
            first = samples.first + len(samples) - len(motion) + 1
            self._add_fractions(
                first, samples.interval, contact_fractions(dte - half), contact_fractions(-dte - half)
            )

    def _add_fractions(
        self, first: int, interval: float, drive: NDArray[np.generic], back: NDArray[np.generic]
    ) -> None:
        if self._first is None:
            self._first, self._interval = first, interval
        offset = first - self._first
        while (offset + len(drive) - 1) // self._width >= self._capacity:
            joined = self._sums[0::2] + self._sums[1::2]
            self._sums = np.vstack([joined, np.zeros_like(joined)])
            self._width *= 2
        bins = (offset + np.arange(len(drive))) // self._width
        for column, values in enumerate((drive, back, np.ones(len(drive)))):
            self._sums[:, column] += np.bincount(bins, weights=values, minlength=self._capacity)

    def shares(self) -> MeshingShares | None:
        """Shares of the whole run; None if neither motion nor meshing state was recorded."""
        drive, back, all_of_it = self._sums.sum(axis=0).tolist()
        if not all_of_it:
            return None
        return MeshingShares(drive / all_of_it, 1.0 - (drive + back) / all_of_it, back / all_of_it)

    def edges(self, count: int) -> NDArray[np.float64]:
        """Simulated times in s between which ``course`` gives shares, shape (n + 1,), n at most ``count``."""
        joined = self._joined(count)
        samples = np.concatenate([[0.0], np.cumsum(joined[:, 2])])
        return np.asarray(((self._first or 0) + samples) * self._interval, dtype=np.float64)

    def course(self, count: int) -> NDArray[np.float64]:
        """Shares over time, shape (n, 3) in the order of MeshingShares, n at most ``count``."""
        drive, back, all_of_it = self._joined(count).T
        states = np.column_stack([drive, all_of_it - drive - back, back])
        return np.asarray(states / all_of_it[:, None], dtype=np.float64)

    def _joined(self, count: int) -> NDArray[np.float64]:
        """Sums of neighbouring intervals, so many that at most ``count`` are left."""
        filled = self._sums[self._sums[:, 2] > 0.0]
        if not len(filled):
            return filled
        together = -(-len(filled) // count)
        return np.add.reduceat(filled, np.arange(0, len(filled), together), axis=0)
