"""The fractal surface: scale, ladder of waves, and that both profiles close where the phase wraps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.physics.surface import fractal_surface
from gear_dynamics_ros.simulation.engine import Engine
from support.measurements import mean_magnitude
from support.parameters import parameters


@settings(max_examples=25, deadline=None)
@given(
    teeth=st.integers(12, 120),
    dimension=st.floats(1.01, 1.99),
    offset=st.floats(-math.pi, math.pi),
    scale=st.floats(1.2, 2.5),
    waves=st.integers(1, 8),
)
def test_mean_magnitude_is_the_roughness(
    teeth: int, dimension: float, offset: float, scale: float, waves: int
) -> None:
    profile = fractal_surface(
        teeth=teeth, roughness=1e-6, fractal_dimension=dimension, offset=offset, scale=scale, waves=waves
    )
    order = int(profile.orders.max())
    assume(order <= 5000)  # beyond, the reference would take long
    assert mean_magnitude(profile.height, order) == pytest.approx(1e-6, rel=1e-8)


def test_orders_are_whole_waves_rounded_half_to_even() -> None:
    profile = fractal_surface(teeth=40, roughness=1e-6, fractal_dimension=1.1, offset=0.0, scale=1.5, waves=8)
    assert profile.orders.tolist() == [40, 60, 90, 135, 202, 304, 456, 683]
    amplitudes = np.hypot(profile.cosine, profile.sine)
    assert amplitudes[1:] / amplitudes[:-1] == pytest.approx(1.5**-0.9, rel=1e-14)


def test_profile_repeats_each_revolution_and_differs_from_tooth_to_tooth() -> None:
    profile = fractal_surface(teeth=23, roughness=1e-6, fractal_dimension=1.1, offset=0.3, scale=1.5, waves=8)
    angle = np.linspace(0.0, 2.0 * math.pi, 1000)
    assert np.abs(profile.height(angle + 2.0 * math.pi) - profile.height(angle)).max() < 1e-17
    assert np.abs(profile.height(angle + 2.0 * math.pi / 23.0) - profile.height(angle)).max() > 1e-7


def test_smooth_gear_has_no_height() -> None:
    profile = fractal_surface(teeth=23, roughness=0.0, fractal_dimension=1.1, offset=0.0, scale=1.5, waves=8)
    assert not profile.height(np.linspace(0.0, 7.0, 50)).any()


@pytest.mark.parametrize("speed", [1623.0, -1623.0])
@pytest.mark.parametrize("phase", ["actual", "nominal"])
def test_both_profiles_go_on_through_every_wrap(speed: float, phase: str) -> None:
    """Beyond a hunting cycle of 23 and 41 teeth the backlash is still that of the accumulated angle."""
    p = parameters(
        gears__driving__teeth=23,
        gears__driven__teeth=41,
        mesh_phase=phase,
        operation__control="torque",
        operation__speed=speed,
        operation__drive_torque=10.0,
        operation__load_torque=10.0 * 41 / 23,
        surface__driven__offset=0.7,
    )
    revolutions = 45
    chunk = Engine(p).advance(round(revolutions * 2.0 * math.pi / 1623.0 / p.solver.sample_interval))
    assert chunk.status == 0
    heights = np.zeros(len(chunk))
    angle = chunk.angles[:, 0] if phase == "actual" else speed * chunk["time"]
    assert np.ptp(angle) > 41 * 2.0 * math.pi
    for side, own in (("driving", angle), ("driven", angle * 23 / 41)):
        gear, rough = getattr(p.gears, side), getattr(p.surface, side)
        profile = fractal_surface(
            teeth=gear.teeth,
            roughness=rough.roughness,
            fractal_dimension=rough.fractal_dimension,
            offset=rough.offset,
            scale=p.surface.scale,
            waves=p.surface.waves,
        )
        heights += profile.height(own)
    alpha, alpha0 = chunk["pressure_angle"], p.gears.pressure_angle
    reach = p.gears.module * (23 + 41) * math.cos(alpha0) / 2.0
    involute = np.tan(alpha) - alpha - (math.tan(alpha0) - alpha0)
    expected = reach * involute + p.gears.backlash / 2.0 - heights / 2.0
    assert np.abs(chunk["half_backlash"] - expected).max() < 1e-14
