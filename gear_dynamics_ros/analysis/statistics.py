"""Totals and envelopes of a run of any length in bounded memory, block of samples by block of samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import FLANKS, MeshingShares, flank_counts
from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.chunk import Samples


class QuantityTotals(NamedTuple):
    """Extremes and means of one quantity, in its own unit."""

    minimum: float
    maximum: float
    mean: float
    rms: float


class Quantities(NamedTuple):
    """Named columns: the recorded channels and the magnitude of each bearing force, in SI units."""

    names: tuple[str, ...]
    values: NDArray[np.float64]  # shape (n, len(names))


def bearing_force_name(gear: str) -> str:
    """Name of the quantity |contact force + film force| on ``gear``, in N."""
    return f"{gear}_bearing_force"


def derived_quantities(samples: Samples) -> Quantities:
    """The channels of ``samples``, and the bearing force of each gear whose components they have."""
    gears = [gear for gear in GEARS if samples.has_bearing_force(gear)]
    columns = [samples.values, *(samples.bearing_force(gear)[:, None] for gear in gears)]
    return Quantities((*samples.names, *map(bearing_force_name, gears)), np.hstack(columns))


class Statistics:
    """Collects the totals of every quantity and the meshing shares over consecutive blocks of samples."""

    def __init__(self) -> None:
        self.samples = 0
        self._names: tuple[str, ...] = ()
        self._flanks = np.zeros(len(FLANKS), dtype=np.int64)
        self._load = 0.0
        self._minimum, self._maximum, self._sum, self._squares = (np.zeros(0) for _ in range(4))

    def add(self, samples: Samples, columns: Quantities) -> None:
        """Take in the next block, not empty, and its ``derived_quantities``; the same names in every call."""
        if not self._names:
            self._begin(columns)
        self.samples += len(samples)
        values = columns.values
        self._minimum = np.minimum(self._minimum, values.min(axis=0))
        self._maximum = np.maximum(self._maximum, values.max(axis=0))
        self._sum += values.sum(axis=0)
        self._squares += np.einsum("ij,ij->j", values, values)
        if samples.has("meshing_state"):
            self._flanks += flank_counts(samples["meshing_state"])
        if samples.has("load_torque"):
            self._load += float(np.abs(samples["load_torque"]).sum())

    def _begin(self, columns: Quantities) -> None:
        self._names = columns.names
        count = len(columns.names)
        self._minimum, self._maximum = np.full(count, np.inf), np.full(count, -np.inf)
        self._sum, self._squares = np.zeros(count), np.zeros(count)

    def totals(self) -> dict[str, QuantityTotals]:
        """Totals by quantity; empty before the first block."""
        return {
            name: QuantityTotals(
                float(self._minimum[i]),
                float(self._maximum[i]),
                float(self._sum[i] / self.samples),
                float(np.sqrt(self._squares[i] / self.samples)),
            )
            for i, name in enumerate(self._names)
        }

    def meshing_shares(self) -> MeshingShares | None:
        """Meshing shares, None if the meshing state wasn't recorded."""
        if "meshing_state" not in self._names:
            return None
        return MeshingShares.of(self._flanks)

    def mean_load_torque(self) -> float | None:
        """Mean of |load torque| in N m, None if it wasn't recorded."""
        return self._load / self.samples if "load_torque" in self._names else None


class Envelope:
    """Minimum and maximum of every quantity in each of at most ``capacity`` intervals of equal length.

    The intervals double in length whenever a run gets too long for them.
    """

    def __init__(self, capacity: int = 2048) -> None:
        self._capacity = capacity
        self._width = 1
        self._first: int | None = None

    def add(self, samples: Samples, columns: Quantities) -> None:
        """Take in a block of samples, later than those before, and its ``columns``."""
        if self._first is None:
            self._first = samples.first
            self._interval = samples.interval
            self.names = columns.names
            shape = (self._capacity, len(columns.names))
            self._low, self._high = np.full(shape, np.inf), np.full(shape, -np.inf)
        offset = samples.first - self._first
        while (offset + len(samples) - 1) // self._width >= self._capacity:
            self._halve()
        bins = (offset + np.arange(len(samples))) // self._width
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        touched = bins[starts]
        self._low[touched] = np.minimum(self._low[touched], np.minimum.reduceat(columns.values, starts))
        self._high[touched] = np.maximum(self._high[touched], np.maximum.reduceat(columns.values, starts))

    def _halve(self) -> None:
        """Join neighbouring intervals, so that half the capacity is free again."""
        for bounds, join, empty in ((self._low, np.minimum, np.inf), (self._high, np.maximum, -np.inf)):
            half = join(bounds[0::2], bounds[1::2])
            bounds[: len(half)] = half
            bounds[len(half) :] = empty
        self._width *= 2

    def times(self) -> NDArray[np.float64]:
        """Simulated time at the middle of each interval that has samples, s, shape (n,)."""
        middle = np.flatnonzero(self._filled()) + 0.5 - 0.5 / self._width
        first = self._first or 0
        return np.asarray((first + middle * self._width) * self._interval, dtype=np.float64)

    def bounds(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Minimum and maximum of one quantity in those intervals, both of shape (n,)."""
        column, filled = self.names.index(name), self._filled()
        return self._low[filled, column], self._high[filled, column]

    def _filled(self) -> NDArray[np.bool_]:
        filled: NDArray[np.bool_] = self._low[:, 0] <= self._high[:, 0]
        return filled
