"""Input and output of an engine: commands, chunks of samples, and samples with named columns.

SI units throughout; simulated time is an integer number of nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN, contact_channels, film_channels


class Status(IntEnum):
    """How an engine call ended; all but RUNNING end the run."""

    RUNNING = 0
    OVER_SPEED = 1
    NON_FINITE = 2
    CENTRES_PRESSED = 3


class Commands(NamedTuple):
    """Commands in force."""

    drive_torque: float  # N m, T_M under control: torque
    load_torque: float  # N m, T_L > 0 resists
    speed: float  # rad/s, set-point of the governor or nominal speed

    def __str__(self) -> str:
        return f"drive {self.drive_torque:g} N m, load {self.load_torque:g} N m, speed {self.speed:g} rad/s"


class Counters(NamedTuple):
    """Totals since the start of the run."""

    steps: int
    events: int  # contact and clamp events located
    capped: int  # root searches or steps that reached their limit of iterations or events
    impacts: int  # bearing contacts begun
    flank_changes: int  # mesh contacts begun or ended


@dataclass(frozen=True, slots=True)
class Chunk:
    """The samples of one engine call, [t0, t0 + T).

    ``samples`` has shape (n, 28), one column for each entry of CHANNELS, or (n, 37) with ENERGIES after them
    if ``waveform_channels`` names one of these. It is C-contiguous and never changes. ``energies`` (9,) are
    ENERGIES after the steps of the last sample. ``impacts`` (k, 6) has a row of IMPACTS for each bearing
    contact that ended. ``angles`` (n, 2) are the angles of the driving and the driven shaft in rad,
    accumulated over all revolutions since the start or the last reset. A ``status`` other than RUNNING means
    that the run ended at the last sample; ``message`` then says why.
    """

    first_sample: int
    interval_ns: int
    samples: NDArray[np.float64]
    angles: NDArray[np.float64]
    energies: NDArray[np.float64]
    impacts: NDArray[np.float64]
    commands: Commands
    counters: Counters
    status: Status
    message: str

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, channel: str) -> NDArray[np.float64]:
        """Column of one channel, shape (n,). Raises KeyError on an unknown name."""
        return self.samples[:, COLUMN[channel]]

    @property
    def start_ns(self) -> int:
        """Simulated time of the first sample, ns."""
        return self.first_sample * self.interval_ns

    @property
    def last_ns(self) -> int:
        """Simulated time of the last sample, ns."""
        return (self.first_sample + len(self) - 1) * self.interval_ns


@dataclass(frozen=True, slots=True)
class Samples:
    """Consecutive samples: ``values`` has shape (n, channels), SI units, one column for each of ``names``."""

    first: int  # index of the first sample
    interval: float  # s
    names: tuple[str, ...]
    values: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Column of one channel, shape (n,). Raises ValueError if it is not among ``names``."""
        return self.values[:, self.names.index(name)]

    def has(self, *names: str) -> bool:
        """Whether all of these channels are among ``names``."""
        return all(name in self.names for name in names)

    @property
    def time(self) -> NDArray[np.float64]:
        """Simulated time in s, shape (n,)."""
        return np.asarray((self.first + np.arange(len(self))) * self.interval, dtype=np.float64)

    def last(self, count: int) -> Samples:
        """The last ``count`` samples, or all if there are fewer."""
        skipped = max(0, len(self) - count)
        return Samples(self.first + skipped, self.interval, self.names, self.values[skipped:])

    def contact_force(self, gear: str) -> NDArray[np.float64]:
        """Magnitude of the bearing contact force in N, shape (n,)."""
        x, y = contact_channels(gear)
        return np.hypot(self[x], self[y])

    def film_force(self, gear: str) -> NDArray[np.float64]:
        """Magnitude of the oil film force in N, shape (n,)."""
        x, y = film_channels(gear)
        return np.hypot(self[x], self[y])

    def bearing_force(self, gear: str) -> NDArray[np.float64]:
        """Magnitude of the sum of contact and film force in N, shape (n,)."""
        (contact_x, contact_y), (film_x, film_y) = contact_channels(gear), film_channels(gear)
        return np.hypot(self[contact_x] + self[film_x], self[contact_y] + self[film_y])

    def has_bearing_force(self, gear: str) -> bool:
        """Whether the channels of contact and film force of ``gear`` are among ``names``."""
        return self.has(*contact_channels(gear), *film_channels(gear))
