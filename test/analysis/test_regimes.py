"""Regimes of the gearbox with the published equations."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest

from gear_dynamics_ros.analysis import chaos
from gear_dynamics_ros.analysis.surface_scatter import hunting_periods, section_width
from gear_dynamics_ros.simulation.orbit import Orbit
from gear_dynamics_ros.simulation.separated_pair import SeparatedPair
from support.published import published_gearbox

TRANSIENT, KEPT = 1500, 1000
SKIPPED = 20


class Motion(NamedTuple):
    """What is measured of one motion."""

    found: chaos.Periodicity
    width: float
    exponent: float  # 1/s
    regime: chaos.Regime


def motion(model: str, rpm: float, roughness: float) -> Motion:
    speed = rpm * math.pi / 30.0
    settings = [f"surface.{gear}.roughness={roughness}" for gear in ("driving", "driven")]
    p = published_gearbox([f"model={model}", f"operation.speed={speed}", *settings])
    orbit = Orbit(p)
    orbit.advance(TRANSIENT)
    pair = SeparatedPair(orbit.copy())
    exponent = chaos.largest_exponent(pair, 200, pair.interval, 1e-6, SKIPPED)
    section = orbit.advance(KEPT).section
    width = section_width(p)
    found = chaos.periodicity(section, hunting_periods(p), width)
    teeth = (p.gears.driving.teeth, p.gears.driven.teeth)
    regime = chaos.regime(found, exponent, chaos.zero_one_test(section[:, 0], teeth), orbit.period)
    return Motion(found, width, exponent, regime)


@pytest.mark.parametrize(
    ("model", "rpm", "roughness", "period"),
    [
        ("traditional", 7000.0, 0.8e-6, 2),
        ("traditional", 15500.0, 0.8e-6, 1),
        ("compared", 2000.0, 0.8e-6, 2),
        ("improved", 3000.0, 0.8e-6, 1),
        ("compared", 9000.0, 0.2e-6, 1),
        ("improved", 15500.0, 0.8e-6, 1),
        ("improved", 18000.0, 1.6e-6, 1),
    ],
)
def test_a_motion_that_repeats_stays_in_clouds_that_its_surface_makes(
    model: str, rpm: float, roughness: float, period: int
) -> None:
    found, width, exponent, regime = motion(model, rpm, roughness)
    assert (found.period, found.repeats, regime) == (period, True, "periodic")
    assert found.cloud < width
    assert exponent < 10.0


@pytest.mark.parametrize(
    ("model", "rpm"), [("compared", 5000.0), ("improved", 7000.0), ("traditional", 12000.0)]
)
def test_neighbours_of_a_chaotic_motion_part(model: str, rpm: float) -> None:
    found, width, exponent, regime = motion(model, rpm, 0.8e-6)
    assert (found.period, found.repeats, regime) == (0, False, "chaotic")
    assert found.spread > 2.0 * width
    assert exponent > 100.0
