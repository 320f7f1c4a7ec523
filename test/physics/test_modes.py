"""Natural frequencies: closed forms, and a model linearised without the package's physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics import modes
from gear_dynamics_ros.physics.constants import hertz_factor
from support.linearised import GAP, KelvinGearbox

LOAD = 532.088886  # N: 30 N m on the base radius
KELVIN = {"model": "traditional", "mesh_geometry": "exact"}


def test_modes_of_two_equal_gears_in_closed_form() -> None:
    """Both centres moving together don't press the mesh; against each other, they couple with the torsion."""
    mass, inertia, base, k, kb = 1.0, 2.23e-3, 0.06 * math.cos(math.radians(20.0)), 3e8, 1e8
    torsion = 2.0 * k * base**2 / inertia
    trace, determinant = torsion + (2.0 * k + kb) / mass, torsion * kb / mass
    root = math.sqrt(0.25 * trace**2 - determinant)
    across = LOAD / (mass * (27e-6 + LOAD / kb))
    expected = sorted([across, across, kb / mass, 0.5 * trace - root, 0.5 * trace + root])
    found = modes.natural_frequencies(Parameters.from_flat(KELVIN), LOAD, k)
    assert found == pytest.approx(np.sqrt(expected), rel=1e-9)


def test_modes_are_those_of_the_model_linearised_numerically() -> None:
    gearbox = KelvinGearbox(exact=True, mesh_ratio=0.0, bearing_damping=0.0)
    alpha = math.radians(20.0)
    shift = (GAP + LOAD / 1e8) * np.array([math.sin(alpha), math.cos(alpha)])
    # The load turns the line of action a little: the equilibrium is found by Newton's method.
    place = np.array([*-shift, *shift, 25e-6 + LOAD / 3e8 + 2.0 * math.cos(alpha) * (GAP + LOAD / 1e8)])
    rest = np.zeros(5)
    for _ in range(20):
        now = gearbox.accelerations(np.concatenate([place, rest]))
        columns = [
            (gearbox.accelerations(np.concatenate([place + step, rest])) - now) / 1e-10
            for step in 1e-10 * np.eye(5)
        ]
        place = place - np.linalg.solve(np.column_stack(columns), now)
    assert np.abs(gearbox.accelerations(np.concatenate([place, rest]))).max() < 1e-3
    values = gearbox.eigenvalues(place)
    expected = np.sort(values.imag[values.imag > 0.0])
    changes = {f"bearings.{side}.clearance": GAP for side in modes.SIDES}
    found = modes.natural_frequencies(Parameters.from_flat(KELVIN | changes), LOAD, 3e8)
    assert found == pytest.approx(expected, rel=2e-3)


def test_the_hertz_contact_carries_its_load() -> None:
    p = Parameters.from_flat({"model": "compared"})
    depth = modes.contact_depth(p, "driving", LOAD)

    def force(depth: float) -> float:
        bearing = p.bearings.driving
        return hertz_factor(p, bearing.length) * depth**1.5 / math.sqrt(bearing.clearance + depth)

    assert force(depth) == pytest.approx(LOAD, rel=1e-8)
    slope = (force(depth * 1.0001) - force(depth * 0.9999)) / (0.0002 * depth)
    assert modes.contact_stiffness(p, "driving", LOAD) == pytest.approx(slope, rel=1e-6)


def test_unloaded_contacts_have_no_stiffness() -> None:
    p = Parameters.from_flat({"model": "compared"})
    assert modes.contact_stiffness(p, "driven", 0.0) == 0.0
    assert modes.natural_frequencies(p, 0.0, p.mesh.stiffness)[:2] == [0.0, 0.0]
