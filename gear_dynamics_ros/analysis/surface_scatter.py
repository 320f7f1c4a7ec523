"""How far the tooth surfaces alone spread the points of a Poincaré section."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import hunting_turns, surfaces

MOST_AMPLIFICATION: Final = 10.0  # a motion with less damping loses contact long before
SMALLEST_WIDTH: Final = 1e-9  # m, of a section without roughness: the rest of a transient


def hunting_periods(parameters: Parameters) -> int:
    """Mesh periods after which the same teeth meet again."""
    return hunting_turns(parameters) * parameters.gears.driving.teeth


def section_heights(parameters: Parameters) -> NDArray[np.float64]:
    """z1 + z2 in m at mesh phase 0 of each pair of teeth, shape (hunting_periods,)."""
    driving, driven = surfaces(parameters)
    meshings = np.arange(hunting_periods(parameters), dtype=np.float64)
    gears = parameters.gears
    return driving.height(2.0 * math.pi / gears.driving.teeth * meshings) + driven.height(
        2.0 * math.pi / gears.driven.teeth * meshings
    )


def section_width(parameters: Parameters) -> float:
    """Bound in m of the spread (maximum less minimum) of DTE at mesh phase 0 of a motion of the mesh period.

    The flanks stand at half the backlash, which the surfaces shift by (z1 + z2) / 2, (23). Teeth that follow
    slowly spread DTE by as much. A wave of the surfaces that meets the resonance of the mesh is amplified by
    1 / (2 xi sqrt(1 - xi^2)) at most, xi the damping ratio of the mesh. The bound is the product of the two.
    It is one of linear motion; motions of the mesh period that lose contact on the way stayed within it too.
    A section that is wider is hardly made by the surfaces alone; a narrower one may still be chaotic.
    """
    shift = 0.5 * float(np.ptp(section_heights(parameters)))
    return max(SMALLEST_WIDTH, _amplification(parameters.mesh.damping_ratio) * shift)


def _amplification(damping_ratio: float) -> float:
    """Greatest magnification of an oscillator with this damping ratio; 1 where it has no resonance."""
    if damping_ratio >= math.sqrt(0.5):
        return 1.0
    resonance = 2.0 * damping_ratio * math.sqrt(1.0 - damping_ratio**2)
    return min(MOST_AMPLIFICATION, 1.0 / max(resonance, 1.0 / MOST_AMPLIFICATION))
