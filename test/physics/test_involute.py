"""Outlines of involute gears against the involute's closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gear_dynamics_ros.physics.involute import InvoluteGear, involute_function

GEARS = [InvoluteGear(40, 3.0e-3, math.radians(20.0)), InvoluteGear(17, 2.0e-3, math.radians(25.0))]


@pytest.mark.parametrize("gear", GEARS)
def test_outline_has_the_teeth_and_closes(gear: InvoluteGear) -> None:
    outline = gear.outline(25.0e-6)
    assert outline[0] == outline[-1]
    tips = np.abs(outline) > 0.5 * (gear.reference_radius + gear.tip_radius)
    assert np.count_nonzero(np.diff(tips.astype(int)) == 1) == gear.teeth
    assert np.abs(outline).max() == pytest.approx(gear.reference_radius + gear.module)
    assert np.abs(outline).min() == pytest.approx(
        min(gear.base_radius, gear.reference_radius - 1.25 * gear.module)
    )


@pytest.mark.parametrize("gear", GEARS)
def test_flanks_unwind_from_the_base_circle(gear: InvoluteGear) -> None:
    """A taut string: the tangent of the base circle through a point of the flank is as long as the arc."""
    radii, half = gear.flank()
    on_involute = radii >= gear.base_radius
    flank = (radii * np.exp(1j * half))[on_involute]
    length = np.sqrt(np.abs(flank) ** 2 - gear.base_radius**2)
    begin = float(gear.half_angle(np.array(gear.base_radius)))  # where the flank leaves the base circle
    # The point of tangency lies behind the begin of the flank by the arc that is unwound.
    tangent = begin - length / gear.base_radius
    unwound = gear.base_radius * np.exp(1j * tangent) * (1.0 + 1j * length / gear.base_radius)
    np.testing.assert_allclose(unwound, flank, atol=1e-12)


@pytest.mark.parametrize("gear", GEARS)
@pytest.mark.parametrize("clearance", [0.0, 25.0e-6])
def test_teeth_are_as_thick_as_the_backlash_leaves_them(gear: InvoluteGear, clearance: float) -> None:
    narrowing = gear.narrowing_angle(clearance)
    angle = float(gear.half_angle(np.array(gear.reference_radius)) - narrowing)
    thickness = 2.0 * gear.reference_radius * angle
    # Backlash 2 b0 along the line of action, half of it from each gear's tooth: b0 / cos(pressure angle).
    expected = 0.5 * math.pi * gear.module - clearance / math.cos(gear.pressure_angle)
    assert thickness == pytest.approx(expected, rel=1e-12)
    tooth = gear.tooth(np.array([float(narrowing)]))[0]
    radii, half = gear.flank()
    np.testing.assert_allclose(np.abs(np.angle(tooth[: len(radii)])), np.abs(half - narrowing), atol=1e-12)


def test_pointed_teeth_end_where_their_flanks_meet() -> None:
    gear = InvoluteGear(6, 1.0, math.radians(35.0))
    assert gear.tip_radius < gear.reference_radius + gear.module
    assert float(gear.half_angle(np.array(gear.tip_radius))) == pytest.approx(0.0, abs=1e-9)


def test_involute_function_of_twenty_degrees() -> None:
    assert float(involute_function(math.radians(20.0))) == pytest.approx(0.014904384, abs=1e-9)  # tables
