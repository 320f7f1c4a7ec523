"""Natural frequencies of the gear pair about its mean load, with teeth and bearings in contact."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import BearingParameters, Parameters
from gear_dynamics_ros.physics.constants import hertz_factor
from gear_dynamics_ros.physics.geometry import base_radii

SIDES: Final = ("driving", "driven")


def natural_frequencies(parameters: Parameters, load: float, mesh_stiffness: float) -> list[float]:
    """Those of the undamped pair in rad/s, ascending: three along the line of action, two across it.

    ``load`` is the force of the mesh and of each bearing in N, ``mesh_stiffness`` in N/m. The
    journals roll across the line of action in their clearance: the bearing's force turns with them. The oil
    film is left out.
    """
    across = [_across_line_of_action(parameters, side, load) for side in SIDES]
    along = np.linalg.eigvals(_along_line_of_action(parameters, load, mesh_stiffness)).real
    return sorted(math.sqrt(max(0.0, square)) for square in (*along.tolist(), *across))


def _across_line_of_action(parameters: Parameters, side: str, load: float) -> float:
    """-acceleration by displacement of the ``side`` journal, which its load holds as gravity a pendulum."""
    mass: float = getattr(parameters.gears, side).mass
    return load / (mass * (bearing_of(parameters, side).clearance + contact_depth(parameters, side, load)))


def _along_line_of_action(parameters: Parameters, load: float, mesh_stiffness: float) -> NDArray[np.float64]:
    """Matrix (3, 3) of -acceleration by displacement of u, and of both centres along the line of action."""
    gears = parameters.gears
    r1, r2 = base_radii(parameters)
    per_mass = np.array(
        [r1**2 / gears.driving.inertia + r2**2 / gears.driven.inertia]
        + [1.0 / gear.mass for gear in (gears.driving, gears.driven)]
    )
    shift = radial_factor(parameters)
    force = per_mass * [1.0, 1.0, -1.0]
    approach = np.array([1.0, shift, -shift])
    bearings = np.diag([0.0, *(contact_stiffness(parameters, side, load) for side in SIDES)])
    matrix: NDArray[np.float64] = mesh_stiffness * np.outer(force, approach) + per_mass[:, None] * bearings
    return matrix


def radial_factor(parameters: Parameters) -> float:
    """How much the teeth approach by a metre of a centre along the line of action.

    (28) with (23) counts the radial part of a shift twice.
    """
    return (
        1.0 if parameters.mesh_geometry == "exact" else 1.0 + math.sin(parameters.gears.pressure_angle) ** 2
    )


def contact_stiffness(parameters: Parameters, side: str, load: float) -> float:
    """Stiffness of the ``side`` bearing's contact under ``load`` (N), N/m."""
    bearing = bearing_of(parameters, side)
    if parameters.model == "traditional":
        return bearing.kelvin_stiffness
    depth = contact_depth(parameters, side, load)
    return load * (1.5 / depth - 0.5 / (bearing.clearance + depth)) if depth > 0.0 else 0.0


def contact_depth(parameters: Parameters, side: str, load: float) -> float:
    """Penetration at which the ``side`` bearing carries ``load`` (N), m; (2)."""
    bearing = bearing_of(parameters, side)
    if parameters.model == "traditional":
        return load / bearing.kelvin_stiffness
    ratio = load / hertz_factor(parameters, bearing.length)
    depth = 0.0
    for _ in range(100):  # contracts, the faster the smaller the depth beside the clearance
        depth = (ratio * math.sqrt(bearing.clearance + depth)) ** (2.0 / 3.0)
    return depth


def bearing_of(parameters: Parameters, side: str) -> BearingParameters:
    """Bearing of the ``side`` gear."""
    bearing: BearingParameters = getattr(parameters.bearings, side)
    return bearing
