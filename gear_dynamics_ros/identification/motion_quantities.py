"""Quantities of a settled motion, as a sweep measures them."""

from __future__ import annotations

from typing import Final

import numpy as np

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.identification.target_table import Measure, Watch
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.orbit import Orbit
from gear_dynamics_ros.sweeps.point import DONE, SCALARS, Measurement, measure_orbit

QUANTITIES: Final = tuple(SCALARS)


def measure_of(watch: Watch) -> Measure:
    """Gives the scalars of a sweep's point, the median of each over the windows of ``watch``."""

    def quantities(parameters: Parameters) -> dict[str, float]:
        orbit = Orbit(parameters)
        windows = []
        for number in range(watch.windows):
            result = measure_orbit(orbit, Measurement(0 if number else watch.transient, watch.keep))
            if result.status != DONE:
                raise GearboxError(result.status)
            windows.append(result.scalars)
        return {name: float(np.median([window[name] for window in windows])) for name in windows[0]}

    return quantities
