"""What is measured of a channel over a window, sample by sample: nothing of the waveform is stored."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Samples: TypeAlias = NDArray[np.float64]

FLANK_STATES: Mapping[str, float] = {"drive": 1.0, "apart": 0.0, "back": -1.0}
DIRECTIONS: Mapping[str, float] = {"rising": 1.0, "falling": -1.0}


class Accumulator(Protocol):
    """A running measure."""

    def add(self, samples: Samples) -> None:
        """Take in the next samples, shape (n,), n > 0."""

    def values(self) -> tuple[float, ...]:
        """What was measured, after at least one sample."""


class Measure(Protocol):
    """What to measure of a channel."""

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""

    def unit(self, channel_unit: str) -> str:
        """Unit of the measured values."""

    def begin(self, interval_ns: int) -> Accumulator:
        """A new running measure of samples that lie ``interval_ns`` apart."""


@dataclass(frozen=True, slots=True)
class Statistic:
    """One of STATISTICS: bounds, mean or root mean square."""

    name: str

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""
        return f"{self.name} {'' if self.name == 'every' else 'of '}{channel}"

    def unit(self, channel_unit: str) -> str:
        """The channel's unit."""
        return channel_unit

    def begin(self, interval_ns: int) -> Accumulator:
        """A new running measure."""
        return STATISTICS[self.name]()


@dataclass(frozen=True, slots=True)
class Share:
    """Share of the samples in which the teeth stand at ``flank``, a key of FLANK_STATES; 0 to 1."""

    flank: str

    def describe(self, channel: str) -> str:
        """Measure in words."""
        return f"share of {self.flank}"

    def unit(self, channel_unit: str) -> str:
        """None."""
        return ""

    def begin(self, interval_ns: int) -> Accumulator:
        """A new running measure."""
        return _Share(FLANK_STATES[self.flank])


@dataclass(frozen=True, slots=True)
class Settling:
    """Time from the window's start until the channel is in the band for good; inf if it ends outside.

    ``lowest`` and ``highest`` bound the band, in the channel's unit given as ``band_unit``.
    """

    lowest: float
    highest: float
    band_unit: str

    def describe(self, channel: str) -> str:
        """Measure, channel and band in words."""
        return f"settling of {channel} into {self.lowest:.6g} to {self.highest:.6g} {self.band_unit}".rstrip()

    def unit(self, channel_unit: str) -> str:
        """Seconds."""
        return "s"

    def begin(self, interval_ns: int) -> Accumulator:
        """A new running measure."""
        return _Settling(self.lowest, self.highest, interval_ns)


@dataclass(frozen=True, slots=True)
class Monotone:
    """How far the channel goes back behind its furthest value, in ``direction``, a key of DIRECTIONS."""

    direction: str

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""
        return f"way back of {self.direction} {channel}"

    def unit(self, channel_unit: str) -> str:
        """The channel's unit."""
        return channel_unit

    def begin(self, interval_ns: int) -> Accumulator:
        """A new running measure."""
        return _WayBack(DIRECTIONS[self.direction])


# The extremes take numpy's functions, not Python's: they hand a NaN on.


class _Least:
    def __init__(self) -> None:
        self._least = math.inf

    def add(self, samples: Samples) -> None:
        self._least = float(np.minimum(self._least, samples.min()))

    def values(self) -> tuple[float, ...]:
        return (self._least,)


class _Greatest:
    def __init__(self) -> None:
        self._greatest = -math.inf

    def add(self, samples: Samples) -> None:
        self._greatest = float(np.maximum(self._greatest, samples.max()))

    def values(self) -> tuple[float, ...]:
        return (self._greatest,)


class _Every:
    def __init__(self) -> None:
        self._bounds = _Least(), _Greatest()

    def add(self, samples: Samples) -> None:
        for bound in self._bounds:
            bound.add(samples)

    def values(self) -> tuple[float, ...]:
        least, greatest = self._bounds
        return (*least.values(), *greatest.values())


class _Mean:
    def __init__(self) -> None:
        self._total = 0.0
        self._count = 0

    def add(self, samples: Samples) -> None:
        self._total += float(samples.sum())
        self._count += len(samples)

    def values(self) -> tuple[float, ...]:
        return (self._total / self._count,)


class _RootMeanSquare(_Mean):
    def add(self, samples: Samples) -> None:
        super().add(np.square(samples))

    def values(self) -> tuple[float, ...]:
        (mean,) = super().values()
        return (math.sqrt(mean),)


class _Share(_Mean):
    def __init__(self, state: float) -> None:
        super().__init__()
        self._state = state

    def add(self, samples: Samples) -> None:
        super().add((samples == self._state).astype(np.float64))


class _Settling:
    def __init__(self, lowest: float, highest: float, interval_ns: int) -> None:
        self._lowest = lowest
        self._highest = highest
        self._interval_ns = interval_ns
        self._count = 0
        self._settled = 0  # samples up to the last one outside

    def add(self, samples: Samples) -> None:
        # What is not inside is outside: a NaN too.
        outside = np.flatnonzero(~((samples >= self._lowest) & (samples <= self._highest)))
        if len(outside):
            self._settled = self._count + int(outside[-1]) + 1
        self._count += len(samples)

    def values(self) -> tuple[float, ...]:
        return (math.inf if self._settled == self._count else self._settled * self._interval_ns / 1e9,)


class _WayBack:
    def __init__(self, sign: float) -> None:
        self._sign = sign
        self._furthest = -math.inf
        self._back = 0.0

    def add(self, samples: Samples) -> None:
        ahead = self._sign * samples
        furthest = np.maximum(np.maximum.accumulate(ahead), self._furthest)
        self._back = float(np.maximum(self._back, (furthest - ahead).max()))
        self._furthest = float(furthest[-1])

    def values(self) -> tuple[float, ...]:
        return (self._back,)


STATISTICS: Mapping[str, Callable[[], Accumulator]] = {
    "every": _Every,
    "smallest": _Least,
    "largest": _Greatest,
    "mean": _Mean,
    "rms": _RootMeanSquare,
}
