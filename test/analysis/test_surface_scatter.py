"""Spread of a section that the tooth surfaces make."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gear_dynamics_ros.analysis import surface_scatter
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import surfaces
from support.parameters import parameters


@pytest.mark.parametrize(("driving", "driven", "cycle"), [(40, 40, 40), (20, 30, 60), (23, 41, 943)])
def test_heights_at_mesh_phase_0_repeat_with_the_hunting_cycle(driving: int, driven: int, cycle: int) -> None:
    case = parameters(gears__driving__teeth=driving, gears__driven__teeth=driven)
    assert surface_scatter.hunting_periods(case) == cycle
    heights = surface_scatter.section_heights(case)
    assert heights.shape == (cycle,)
    first, second = surfaces(case)
    later = cycle + 7
    expected = first.height(2.0 * math.pi * later / driving) + second.height(2.0 * math.pi * later / driven)
    assert heights[7] == pytest.approx(float(expected), abs=1e-16)


def test_width_is_half_the_spread_of_the_heights_times_the_resonance_of_the_mesh() -> None:
    case = Parameters()
    half = 0.5 * np.ptp(surface_scatter.section_heights(case))
    response = [
        1.0 / abs(1.0 - ratio**2 + 2j * case.mesh.damping_ratio * ratio)
        for ratio in np.linspace(0.5, 1.5, 10_001)
    ]
    assert surface_scatter.section_width(case) == pytest.approx(half * max(response), rel=1e-6)


def test_width_is_proportional_to_the_roughness() -> None:
    rough = parameters(surface__driving__roughness=1.6e-6, surface__driven__roughness=1.6e-6)
    assert surface_scatter.section_width(rough) == pytest.approx(
        2.0 * surface_scatter.section_width(Parameters())
    )


@pytest.mark.parametrize(("ratio", "gain"), [(0.0, 10.0), (0.01, 10.0), (0.1, 5.0252), (0.75, 1.0)])
def test_amplification_lies_between_rest_and_ten(ratio: float, gain: float) -> None:
    case = parameters(mesh__damping_ratio=ratio)
    shift = 0.5 * np.ptp(surface_scatter.section_heights(case))
    assert surface_scatter.section_width(case) == pytest.approx(gain * shift, rel=1e-4)


def test_smooth_surfaces_leave_a_nanometre_to_transients() -> None:
    smooth = parameters(surface__driving__roughness=0.0, surface__driven__roughness=0.0)
    assert surface_scatter.section_width(smooth) == 1e-9
