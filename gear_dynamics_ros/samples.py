"""A stretch of consecutive samples with names to its columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

GEARS: Final = ("driving", "driven")


def contact_channels(gear: str) -> tuple[str, str]:
    """Channels of the bearing contact force on one gear."""
    return f"{gear}_contact_force_x", f"{gear}_contact_force_y"


def film_channels(gear: str) -> tuple[str, str]:
    """Channels of the oil film force on one gear."""
    return f"{gear}_film_force_x", f"{gear}_film_force_y"


@dataclass(frozen=True, slots=True)
class Samples:
    """Consecutive samples: ``values`` has shape (n, channels), SI units, one column a name."""

    first: int
    interval: float
    names: tuple[str, ...]
    values: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Column of one channel, shape (n,)."""
        return self.values[:, self.names.index(name)]

    def has(self, *names: str) -> bool:
        """Whether all of these channels are there."""
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
        """Magnitude of contact and film force together in N, shape (n,)."""
        (contact_x, contact_y), (film_x, film_y) = contact_channels(gear), film_channels(gear)
        return np.hypot(self[contact_x] + self[film_x], self[contact_y] + self[film_y])

    def has_bearing_force(self, gear: str) -> bool:
        """Whether contact and film force of ``gear`` are there."""
        return self.has(*contact_channels(gear), *film_channels(gear))
