"""Largest exponent of two neighbouring orbits against the linearised model, written anew here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gear_dynamics_ros.analysis.chaos import largest_exponent
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.simulation.orbit import Orbit
from gear_dynamics_ros.simulation.separated_pair import SeparatedPair
from support.linearised import GAP, KelvinGearbox, coordinates, settled, slowest_mode
from support.measurements import PUBLISHED, QUIET

REFINED = {"mesh_geometry": "exact", "mesh_damping": "contact", "mesh_phase": "actual"}
KELVIN = {
    **QUIET,
    "model": "traditional",
    "bearings.driving.clearance": GAP,
    "bearings.driven.clearance": GAP,
    "operation.speed": 184.0,  # mesh frequency near the slowest damped mode's
}


@pytest.fixture(scope="module", params=[PUBLISHED, REFINED], ids=["published", "refined"])
def kelvin(request: pytest.FixtureRequest) -> tuple[Orbit, KelvinGearbox]:
    """A loaded pair at rest in its bearings, and the same model written here."""
    orbit = settled({**KELVIN, **request.param}, 400, 1000)
    return orbit, KelvinGearbox(exact=request.param is REFINED)


def test_the_model_written_here_has_the_known_modes(kelvin: tuple[Orbit, KelvinGearbox]) -> None:
    orbit, model = kelvin
    assert np.abs(model.accelerations(np.concatenate([coordinates(orbit), np.zeros(5)]))).max() < 1e-3
    undamped = KelvinGearbox(exact=True, mesh_ratio=0.0, bearing_damping=0.0)
    hertz = np.abs(undamped.eigenvalues(coordinates(orbit)).imag) / (2.0 * math.pi)
    for known in (1202.5, 6160.4):
        assert np.abs(hertz - known).min() < 1e-4 * known


@pytest.mark.parametrize("separation", [1e-3, 1e-4, 1e-5])
def test_exponent_along_the_line_of_action_is_the_slowest_damped_mode(
    kelvin: tuple[Orbit, KelvinGearbox], separation: float
) -> None:
    """Rounding brings the undamped modes across in, and they take over: the window is short."""
    orbit, model = kelvin
    sine, cosine = math.sin(math.radians(20.0)), math.cos(math.radians(20.0))
    direction = np.array([-sine, -cosine, sine, cosine, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    damped = [value.real for value in model.eigenvalues(coordinates(orbit)) if value.real < -1.0]
    pair = SeparatedPair(orbit.copy(), separation, direction, periods=1)
    found = largest_exponent(pair, 35, pair.interval, separation, skip=10)
    assert found == pytest.approx(max(damped), rel=0.01)


def test_exponent_of_all_modes_is_that_of_the_undamped_ones(kelvin: tuple[Orbit, KelvinGearbox]) -> None:
    """Kelvin bearings don't damp what goes across the line of action."""
    orbit, model = kelvin
    values = model.eigenvalues(coordinates(orbit)).real
    assert abs(values[0]) < 1e-3
    damped = max(value for value in values if value < -1.0)
    pair = SeparatedPair(orbit.copy())
    found = largest_exponent(pair, 400, pair.interval, 1e-6, skip=10)
    assert found == pytest.approx(values[0], abs=1e-3 * abs(damped))


@pytest.mark.parametrize("switches", [PUBLISHED, REFINED], ids=["published", "refined"])
@pytest.mark.parametrize("oil_clearance", [60e-6, 150e-6])
def test_exponent_in_an_oil_film_is_the_slowest_mode_whatever_the_separation(
    switches: dict[str, Any], oil_clearance: float
) -> None:
    clearances = {f"bearings.{gear}.oil_clearance": oil_clearance for gear in ("driving", "driven")}
    changes = {**QUIET, **switches, **clearances, "model": "improved", "operation.speed": 184.0}
    orbit = settled(changes, 200, 3000)
    expected = slowest_mode(orbit)
    for separation in (1e-5, 1e-6, 1e-7, 1e-8):
        pair = SeparatedPair(orbit.copy(), separation)
        found = largest_exponent(pair, 200, pair.interval, separation, skip=10)
        assert found == pytest.approx(expected, rel=0.01)


# Rattling teeth

RATTLE = {**PUBLISHED, "model": "compared", "operation.speed": 523.6}


@pytest.fixture(scope="module")
def rattling() -> Orbit:
    return settled(RATTLE, 100, 500)


def momentum(orbit: Orbit) -> float:
    return float(orbit.state["omega"][0].sum())  # equal gears


def test_the_copy_stands_where_it_was_told_to(rattling: Orbit) -> None:
    pair = SeparatedPair(rattling.copy(), 1e-4)
    assert pair.distance() == pytest.approx(1e-4, rel=1e-9)
    assert momentum(pair.copy) == pytest.approx(momentum(pair.reference), abs=1e-11)
    assert pair.rescale(3e-6) and pair.distance() == pytest.approx(3e-6, rel=1e-6)


def test_the_reference_goes_its_way(rattling: Orbit) -> None:
    pair, alone = SeparatedPair(rattling.copy()), rattling.copy()
    largest_exponent(pair, 50, pair.interval, 1e-6, skip=0)
    alone.advance(250)
    assert (pair.reference.state == alone.state).all()


def test_the_copy_is_rescaled_only_where_all_flags_agree(rattling: Orbit) -> None:
    """The larger the separation, the more often the two are on different sides of something."""
    refused = 0
    pair = SeparatedPair(rattling.copy(), 1e-2, periods=1)
    for _ in range(400):
        pair.advance()
        flags = ("flank", "contact", "clamped")
        agree = all((pair.copy.state[name] == pair.reference.state[name]).all() for name in flags)
        before = pair.copy.state.copy()
        if pair.rescale(1e-2):
            assert agree and pair.distance() == pytest.approx(1e-2, rel=1e-6)
            assert pair.copy.state["mesh_impulse"] == pair.reference.state["mesh_impulse"]
        else:
            refused += 1
            assert (pair.copy.state == before).all()
    assert 0 < refused < 200


def test_orbits_that_coincide_are_not_rescaled(rattling: Orbit) -> None:
    pair = SeparatedPair(rattling.copy(), 0.0)
    assert pair.distance() == 0.0 and not pair.rescale(1e-6)


def test_a_run_that_ends_is_an_error() -> None:
    orbit = settled({**RATTLE, "operation.speed_limit": 530.0, "operation.drive_torque": 60.0}, 100, 1)
    pair = SeparatedPair(orbit)
    with pytest.raises(GearboxError, match="speed_limit"):
        largest_exponent(pair, 2000, pair.interval, 1e-6, skip=0)
