"""Tooth profiles of the paper's figure 2: what roughness and fractal dimension do to peaks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.paper.cases import DIMENSIONS, ROUGHNESSES
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.surface import FractalProfile, fractal_surface

ANGLES: Final = 65_536  # on a revolution: 96 for each of the shortest waves


class ToothProfile(NamedTuple):
    """The profile of one gear at one roughness and one fractal dimension."""

    roughness: float  # m, mean of |z|
    fractal_dimension: float
    profile: FractalProfile
    peak_height: float  # m, mean height of the maxima of |z|
    peaks_per_tooth: float  # maxima of |z|


def tooth_profile(parameters: Parameters, roughness: float, fractal_dimension: float) -> ToothProfile:
    """Profile of the driving gear of ``parameters`` at ``roughness`` (m) and ``fractal_dimension``."""
    surface, teeth = parameters.surface, parameters.gears.driving.teeth
    profile = fractal_surface(
        teeth=teeth,
        roughness=roughness,
        fractal_dimension=fractal_dimension,
        offset=surface.driving.offset,
        scale=surface.scale,
        waves=surface.waves,
    )
    heights = np.abs(profile.height(np.linspace(0.0, 2.0 * math.pi, ANGLES, endpoint=False)))
    peaks = heights[_maxima(heights)]
    return ToothProfile(roughness, fractal_dimension, profile, float(peaks.mean()), len(peaks) / teeth)


def _maxima(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where a closed series is greater than both neighbours."""
    maxima: NDArray[np.bool_] = (values > np.roll(values, 1)) & (values >= np.roll(values, -1))
    return maxima


def profiles_over_roughness(parameters: Parameters) -> Sequence[ToothProfile]:
    """Profiles at the least of DIMENSIONS, one for each of ROUGHNESSES."""
    return [tooth_profile(parameters, roughness, DIMENSIONS[0]) for roughness in ROUGHNESSES]


def profiles_over_dimension(parameters: Parameters) -> Sequence[ToothProfile]:
    """Profiles at the least of ROUGHNESSES, one for each of DIMENSIONS."""
    return [tooth_profile(parameters, ROUGHNESSES[0], dimension) for dimension in DIMENSIONS]
