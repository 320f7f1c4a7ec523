"""Dimensions of the gears that follow from the parameters; needs no compiler."""

from __future__ import annotations

import math

from gear_dynamics_ros.parameters import Parameters


def base_radii(parameters: Parameters) -> tuple[float, float]:
    """Base radii of driving and driven gear, m."""
    gears = parameters.gears
    half = 0.5 * gears.module * math.cos(gears.pressure_angle)
    return half * gears.driving.teeth, half * gears.driven.teeth
