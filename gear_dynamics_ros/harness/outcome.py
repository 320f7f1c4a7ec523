"""What came of playing a profile: results, commands, and what the gearbox was and did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.harness.results import Result


class ActedCommand(NamedTuple):
    """A command that has acted."""

    name: str  # field of Commands
    value: float
    time: float  # of the profile for which it was meant, s
    late: float  # simulated time from the sample at which it was due to the one at which it acted, s


class ChannelBounds(NamedTuple):
    """Minimum and maximum of a channel in intervals of the profile's time, all of shape (n,)."""

    time: NDArray[np.float64]  # s
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class PlayedSamples(NamedTuple):
    """What the waveform showed."""

    windows: Sequence[ChannelBounds]  # of each expectation, its channel in its window
    channels: Mapping[str, ChannelBounds]  # of channels over the whole profile
    started_at: float  # simulated time of the gearbox at profile time 0, s
    reached: float  # profile time, s
    acted: Sequence[ActedCommand]


class ProfileOutcome(NamedTuple):
    """Result of playing a profile."""

    results: tuple[Result, ...]  # of its expectations
    published: int  # commands
    lateness: Sequence[float]  # s of simulated time from where each command was due to where it acted
    real_time_factor: float  # simulated time over wall time, as received; 0 if nothing was
    state: str  # of the gearbox after lockstep: "runs again" or "stays paused"; empty if it was not changed
    failure: str  # why it was not played to its end; empty if it was
    signal: int  # number of the signal that interrupted it, 0 if none did
    samples: PlayedSamples | None = None  # None if nothing was received
    gearbox: Mapping[str, Any] = MappingProxyType({})  # content of its first ~/model_info; empty without one
