"""Measures of one channel over a window, computed block by block without storing the waveform."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

ChannelSamples: TypeAlias = NDArray[np.float64]

FLANK_STATES: Mapping[str, float] = {"drive": 1.0, "apart": 0.0, "back": -1.0}
DIRECTIONS: Mapping[str, float] = {"rising": 1.0, "falling": -1.0}


class Accumulator(Protocol):
    """Computes a measure block by block."""

    def add(self, samples: ChannelSamples) -> None:
        """Take in the next samples of the channel, shape (n,), n > 0."""

    def values(self) -> tuple[float, ...]:
        """The measured values; needs at least one sample."""


class Measure(Protocol):
    """What to measure of a channel."""

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""

    def unit(self, channel_unit: str) -> str:
        """Unit of the measured values."""

    def begin(self, interval_ns: int) -> Accumulator:
        """A new accumulator for samples every ``interval_ns``."""


@dataclass(frozen=True, slots=True)
class Statistic:
    """One of STATISTICS: extremes, mean or root mean square."""

    name: str

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""
        return f"{self.name} {'' if self.name == 'every' else 'of '}{channel}"

    def unit(self, channel_unit: str) -> str:
        """The channel's unit."""
        return channel_unit

    def begin(self, interval_ns: int) -> Accumulator:
        """A new accumulator."""
        return STATISTICS[self.name]()


@dataclass(frozen=True, slots=True)
class FlankShare:
    """Share, 0 to 1, of the samples in the meshing state ``flank``, a key of FLANK_STATES."""

    flank: str

    def describe(self, channel: str) -> str:
        """Measure in words."""
        return f"share of {self.flank}"

    def unit(self, channel_unit: str) -> str:
        """Empty: a share has no unit."""
        return ""

    def begin(self, interval_ns: int) -> Accumulator:
        """A new accumulator."""
        return _FlankShareAccumulator(FLANK_STATES[self.flank])


@dataclass(frozen=True, slots=True)
class SettlingTime:
    """Time from the window's start until the channel stays in a band; inf if it ends outside.

    ``lowest`` and ``highest`` are the limits of the band in the channel's unit, ``band_unit``.
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
        """A new accumulator."""
        return _SettlingTimeAccumulator(self.lowest, self.highest, interval_ns)


@dataclass(frozen=True, slots=True)
class Reversal:
    """Largest distance of a channel behind the extreme that it has reached in ``direction``.

    0 for a channel that moves in this direction only. ``direction`` is a key of DIRECTIONS.
    """

    direction: str

    def describe(self, channel: str) -> str:
        """Measure and channel in words."""
        return f"reversal of {self.direction} {channel}"

    def unit(self, channel_unit: str) -> str:
        """The channel's unit."""
        return channel_unit

    def begin(self, interval_ns: int) -> Accumulator:
        """A new accumulator."""
        return _ReversalAccumulator(DIRECTIONS[self.direction])


# The extremes use numpy's functions, which propagate NaN; Python's don't.


class _MinimumAccumulator:
    def __init__(self) -> None:
        self._minimum = math.inf

    def add(self, samples: ChannelSamples) -> None:
        self._minimum = float(np.minimum(self._minimum, samples.min()))

    def values(self) -> tuple[float, ...]:
        return (self._minimum,)


class _MaximumAccumulator:
    def __init__(self) -> None:
        self._maximum = -math.inf

    def add(self, samples: ChannelSamples) -> None:
        self._maximum = float(np.maximum(self._maximum, samples.max()))

    def values(self) -> tuple[float, ...]:
        return (self._maximum,)


class _RangeAccumulator:
    def __init__(self) -> None:
        self._bounds = _MinimumAccumulator(), _MaximumAccumulator()

    def add(self, samples: ChannelSamples) -> None:
        for bound in self._bounds:
            bound.add(samples)

    def values(self) -> tuple[float, ...]:
        least, greatest = self._bounds
        return (*least.values(), *greatest.values())


class _MeanAccumulator:
    def __init__(self) -> None:
        self._total = 0.0
        self._count = 0

    def add(self, samples: ChannelSamples) -> None:
        self._total += float(samples.sum())
        self._count += len(samples)

    def values(self) -> tuple[float, ...]:
        return (self._total / self._count,)


class _RmsAccumulator(_MeanAccumulator):
    def add(self, samples: ChannelSamples) -> None:
        super().add(np.square(samples))

    def values(self) -> tuple[float, ...]:
        (mean,) = super().values()
        return (math.sqrt(mean),)


class _FlankShareAccumulator(_MeanAccumulator):
    def __init__(self, state: float) -> None:
        super().__init__()
        self._state = state

    def add(self, samples: ChannelSamples) -> None:
        super().add((samples == self._state).astype(np.float64))


class _SettlingTimeAccumulator:
    def __init__(self, lowest: float, highest: float, interval_ns: int) -> None:
        self._lowest = lowest
        self._highest = highest
        self._interval_ns = interval_ns
        self._count = 0
        self._settled = 0  # number of samples up to and including the last one outside

    def add(self, samples: ChannelSamples) -> None:
        # The negation also counts NaN as outside.
        outside = np.flatnonzero(~((samples >= self._lowest) & (samples <= self._highest)))
        if len(outside):
            self._settled = self._count + int(outside[-1]) + 1
        self._count += len(samples)

    def values(self) -> tuple[float, ...]:
        return (math.inf if self._settled == self._count else self._settled * self._interval_ns / 1e9,)


class _ReversalAccumulator:
    def __init__(self, sign: float) -> None:
        self._sign = sign
        self._furthest = -math.inf
        self._reversal = 0.0

    def add(self, samples: ChannelSamples) -> None:
        ahead = self._sign * samples
        furthest = np.maximum(np.maximum.accumulate(ahead), self._furthest)
        self._reversal = float(np.maximum(self._reversal, (furthest - ahead).max()))
        self._furthest = float(furthest[-1])

    def values(self) -> tuple[float, ...]:
        return (self._reversal,)


STATISTICS: Mapping[str, Callable[[], Accumulator]] = {
    "every": _RangeAccumulator,
    "smallest": _MinimumAccumulator,
    "largest": _MaximumAccumulator,
    "mean": _MeanAccumulator,
    "rms": _RmsAccumulator,
}
