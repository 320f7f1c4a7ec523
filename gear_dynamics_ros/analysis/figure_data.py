"""What the figures of a recording are drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.run_up import SpeedSpectra
from gear_dynamics_ros.analysis.statistics import Envelope
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import Parameters


class FigureData(NamedTuple):
    """Samples and totals of one recording."""

    parameters: Parameters
    envelope: Envelope  # of the whole run
    changes: Sequence[float]  # times of commands and events, s
    window: Samples  # what the figures show that are not of the run
    windows: Sequence[Samples]  # all that are analysed, which the figures of the run mark
    meshing: MeshingTimeline  # of the whole run
    run_up: SpeedSpectra | None  # of the greatest rise or fall of the speed
