"""Totals over a stream of samples of any length, in bounded memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import FLANKS, MeshingShares, flank_counts
from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.chunk import Samples


class Totals(NamedTuple):
    """Extremes and means of one quantity, in its own unit."""

    minimum: float
    maximum: float
    mean: float
    rms: float


class Quantities(NamedTuple):
    """What statistics and overview share: recorded channels and the magnitude of each bearing force."""

    names: tuple[str, ...]
    values: NDArray[np.float64]  # shape (n, quantities)


def bearing_force_name(gear: str) -> str:
    """Name of the magnitude of contact and film force on ``gear``."""
    return f"{gear}_bearing_force"


def quantities(samples: Samples) -> Quantities:
    """Recorded channels and what is made of them."""
    gears = [gear for gear in GEARS if samples.has_bearing_force(gear)]
    columns = [samples.values, *(samples.bearing_force(gear)[:, None] for gear in gears)]
    return Quantities((*samples.names, *map(bearing_force_name, gears)), np.hstack(columns))


class Statistics:
    """Collects totals of every quantity and the meshing shares; feed it all stretches."""

    def __init__(self) -> None:
        self.samples = 0
        self._names: tuple[str, ...] = ()
        self._flanks = np.zeros(len(FLANKS), dtype=np.int64)
        self._load = 0.0
        self._minimum, self._maximum, self._sum, self._squares = (np.zeros(0) for _ in range(4))

    def add(self, samples: Samples, columns: Quantities) -> None:
        """One more stretch, with its quantities."""
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

    @property
    def totals(self) -> dict[str, Totals]:
        """Totals by quantity; empty before the first stretch."""
        return {
            name: Totals(
                float(self._minimum[i]),
                float(self._maximum[i]),
                float(self._sum[i] / self.samples),
                float(np.sqrt(self._squares[i] / self.samples)),
            )
            for i, name in enumerate(self._names)
        }

    @property
    def shares(self) -> MeshingShares | None:
        """Meshing shares, None if the state wasn't recorded."""
        if "meshing_state" not in self._names:
            return None
        return MeshingShares.of(self._flanks)

    @property
    def mean_load_torque(self) -> float | None:
        """Mean magnitude of the load torque in N m, None if it wasn't recorded."""
        return self._load / self.samples if "load_torque" in self._names else None


class Envelope:
    """Lowest and highest of every quantity in at most ``capacity`` equal stretches of a run of any length."""

    def __init__(self, capacity: int = 2048) -> None:
        self._capacity = capacity
        self._width = 1
        self._first: int | None = None

    def add(self, samples: Samples, columns: Quantities) -> None:
        """One more stretch, later than those before."""
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
        """Join neighbours, so that half the capacity is free again."""
        for bounds, join, empty in ((self._low, np.minimum, np.inf), (self._high, np.maximum, -np.inf)):
            half = join(bounds[0::2], bounds[1::2])
            bounds[: len(half)] = half
            bounds[len(half) :] = empty
        self._width *= 2

    @property
    def time(self) -> NDArray[np.float64]:
        """Simulated time at the middle of each stretch that holds samples, s, shape (n,)."""
        middle = np.flatnonzero(self._filled) + 0.5 - 0.5 / self._width
        first = self._first or 0
        return np.asarray((first + middle * self._width) * self._interval, dtype=np.float64)

    def bounds(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest of one quantity, both of shape (n,)."""
        column = self.names.index(name)
        return self._low[self._filled, column], self._high[self._filled, column]

    @property
    def _filled(self) -> NDArray[np.bool_]:
        filled: NDArray[np.bool_] = self._low[:, 0] <= self._high[:, 0]
        return filled
