"""Integrals of the surfaces over a step, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from gear_dynamics_ros.physics.kernel.compiling import compiled
from gear_dynamics_ros.physics.kernel.impulse import Phase, surface_rise
from gear_dynamics_ros.physics.kernel.records import END, HERE, POINT, STATE
from gear_dynamics_ros.physics.kernel.waves import SURFACE, SURFACE_CURVATURE, SURFACE_SLOPE

STEP = 2e-6  # s


@compiled
def integrals(all_state: Any, points: Any, h: float, rate: float) -> tuple[float, float, float, float, float]:
    """Of a surface that passes at a constant rate of the phase, rad/s."""
    phase = Phase(rate, rate, rate, 0.0, 0.0, 0.0, 0.0, 0.0)
    rise = surface_rise(all_state[0], points[HERE], points[END], h, phase)
    return rise.integral, rise.moment, rise.second_moment, rise.skew, rise.spread


@pytest.mark.parametrize(
    ("turn", "tolerance"), [(0.0, 1e-15), (0.5, 1e-13), (2.2, 5e-8), (2.6, 2e-7), (4.4, 2e-5)]
)
@pytest.mark.parametrize("psi", [0.0, 0.9, 1.6])
@pytest.mark.parametrize("flank", [1.0, -1.0])
def test_a_wave_is_integrated_over_a_step(turn: float, tolerance: float, psi: float, flank: float) -> None:
    """A wave of height 1 that turns by ``turn`` rad in the step."""
    state, points = np.zeros(1, STATE), np.zeros(3, POINT)
    state["flank"] = flank

    def fill(target: Any, tau: float) -> None:
        """Derivatives by a phase that advances by 1 rad in the step."""
        angle = turn * tau + psi
        target[SURFACE], target[SURFACE_SLOPE] = math.cos(angle), -turn * math.sin(angle)
        target[SURFACE_CURVATURE] = -turn * turn * math.cos(angle)

    fill(points[HERE]["excitation"], -0.5)
    fill(points[END]["middle"], 0.0)
    fill(points[END]["excitation"], 0.5)
    found = integrals(state, points, STEP, 1.0 / STEP)

    weights = (
        lambda tau: STEP,
        lambda tau: STEP**2 * (0.5 - tau),
        lambda tau: STEP**3 * (0.5 - tau) ** 2 / 2.0,
        lambda tau: -tau,
        lambda tau: tau**2,
    )
    scales = (STEP, STEP**2, STEP**3, 1.0, 1.0)
    for value, weight, scale in zip(found, weights, scales, strict=True):
        exact = quad(lambda tau, w=weight: w(tau) * 0.5 * flank * math.cos(turn * tau + psi), -0.5, 0.5)[0]
        assert abs(value - exact) < tolerance * scale
