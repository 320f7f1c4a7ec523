"""Modes of a gearbox at rest under load, from the model linearised without the package's physics."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.orbit import Orbit
from support.referee import Referee, nested

Vector = NDArray[np.float64]
GAP = 1e-7  # m, clearance that leaves the line of action where it is


class KelvinGearbox(NamedTuple):
    """Two equal gears with teeth and Kelvin bearings in contact, without excitation: docs/model.md."""

    exact: bool  # geometry and damping
    mesh_ratio: float = 0.1
    bearing_damping: float = 2000.0

    def accelerations(self, z: Vector) -> Vector:
        """Of x1, y1, x2, y2 and u at ``z``, these and their rates."""
        alpha0, mass, inertia, torque, k, kb = math.radians(20.0), 1.0, 2.23e-3, 30.0, 3e8, 1e8
        pitch = 0.12
        rb = 0.5 * pitch * math.cos(alpha0)
        c = 2.0 * self.mesh_ratio * math.sqrt(k * inertia / (2.0 * rb * rb))

        def mesh(at: Vector) -> tuple[float, float, float]:
            """q, b1 and gamma."""
            x1, y1, x2, y2, u = at
            dx, dy = pitch + x2 - x1, y2 - y1
            alpha, beta = math.acos(2.0 * rb / math.hypot(dx, dy)), math.atan2(dy, dx)
            gamma = alpha - beta
            involute = math.tan(alpha) - alpha - math.tan(alpha0) + alpha0
            published = u + (x1 - x2) * math.sin(gamma) + (y1 - y2) * math.cos(gamma)
            return u - 2.0 * rb * beta if self.exact else published, 2.0 * rb * involute + 25e-6, gamma

        place, rate = z[:5], z[5:]
        q, b1, gamma = mesh(place)
        after, before = mesh(place + 1e-7 * rate), mesh(place - 1e-7 * rate)
        q_rate, b1_rate = (after[0] - before[0]) / 2e-7, (after[1] - before[1]) / 2e-7
        force = k * (q - b1) + c * (q_rate - b1_rate if self.exact else q_rate)
        line = np.array([math.sin(gamma), math.cos(gamma)])
        result = np.empty(5)
        for gear, sense in ((0, -1.0), (1, 1.0)):
            centre, velocity = place[2 * gear : 2 * gear + 2], rate[2 * gear : 2 * gear + 2]
            d = math.hypot(*centre)
            normal = centre / d
            bearing = kb * (d - GAP) + self.bearing_damping * float(velocity @ normal)
            result[2 * gear : 2 * gear + 2] = (sense * force * line - bearing * normal) / mass
        result[4] = 2.0 * rb * (torque - force * rb) / inertia
        return result

    def eigenvalues(self, place: Vector) -> NDArray[np.complex128]:
        """Of the motion about the equilibrium ``place`` (5,), by falling real part."""
        matrix, steps = np.zeros((10, 10)), np.repeat([1e-9, 1e-4], 5)
        matrix[:5, 5:] = np.eye(5)
        for column, step in enumerate(steps):
            change = step * np.eye(10)[column]
            at = np.concatenate([place, np.zeros(5)])
            difference = self.accelerations(at + change) - self.accelerations(at - change)
            matrix[5:, column] = difference / (2.0 * step)
        values = np.linalg.eigvals(matrix)
        return values[np.argsort(-values.real)]


def settled(changes: dict[str, Any], steps: int, periods: int) -> Orbit:
    orbit = Orbit(Parameters.from_flat(changes), steps)
    orbit.advance(periods)
    return orbit


def coordinates(orbit: Orbit) -> Vector:
    state = orbit.state[0]
    return np.array([state["x"][0], state["y"][0], state["x"][1], state["y"][1], state["u"]])


def slowest_mode(orbit: Orbit) -> float:
    """Largest real part, 1/s, of the referee linearised at ``orbit``, without the free turning."""
    referee = Referee(nested(orbit.parameters.to_flat()))
    state = orbit.state[0]
    referee.mode.flank = int(state["flank"])
    referee.mode.contact = [bool(contact) for contact in state["contact"]]
    referee.mode.impact_speed = [float(speed) for speed in state["impact_speed"]]
    speeds = [state["vx"][0], state["vy"][0], state["vx"][1], state["vy"][1], *state["omega"]]
    at = np.array([*coordinates(orbit), state["theta1"], *speeds])
    assert np.abs(referee.derivative(0.0, at)[6:10]).max() < 1e-6, "not at rest"
    steps = np.array([1e-10] * 5 + [1e-8] + [1e-5] * 4 + [1e-3] * 2)
    matrix = np.empty((12, 12))
    for column, step in enumerate(steps):
        change = step * np.eye(12)[column]
        ahead, behind = referee.derivative(0.0, at + change), referee.derivative(0.0, at - change)
        matrix[:, column] = (np.array(ahead) - np.array(behind)) / (2.0 * step)
    return max(value for value in np.linalg.eigvals(matrix).real if value < -1.0)
