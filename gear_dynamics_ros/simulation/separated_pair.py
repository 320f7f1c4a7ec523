"""Two neighbouring orbits of one gearbox, whose separation gives the largest Lyapunov exponent."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.simulation.orbit import Orbit

# Relative. Events are located to 1e-8 of a step, in which a flank moves by some 1e-14 m: a 2500th of this
# separation of gears with 50 um of backlash.
SEPARATION: Final = 1e-6
# Of the mesh in an interval: chaos lets the separation grow some tenfold in them, and a call for each period
# would take longer than the period.
PERIODS: Final = 5
# x1, y1, x2, y2, u and their rates, each of which every mode has a part in.
COORDINATES: Final = 10
FLAGS: Final = ("flank", "mesh_clamped", "contact", "clamped", "film_limited", "whole_turns")


class SeparatedPair:
    """A reference orbit and a copy displaced from it, as ``analysis.chaos.largest_exponent`` takes them.

    The distance is that of the vibration, without unit: displacements x1, y1, x2, y2 and u over half the
    backlash, their rates over that times the mesh frequency in rad/s, in the Euclidean norm.

    The copy is displaced at the momentum J1 omega1 / r1 + J2 omega2 / r2 and the J1 theta1 / r1 + J2 theta2 /
    r2 of the reference. Constant torques keep both equal, so that the exponent is the one of the vibration:
    otherwise that of the turning shafts, which is 0, would hide all that are smaller.
    """

    def __init__(
        self,
        reference: Orbit,
        separation: float = SEPARATION,
        direction: NDArray[np.float64] | None = None,
        periods: int = PERIODS,
    ) -> None:
        """Displace a copy of ``reference`` by ``separation``; an interval is ``periods`` of the mesh.

        ``direction``, shape (10,), are the displacements of x1, y1, x2, y2, u and of their rates, scaled as
        above, in any size; without it all modes are excited. ``reference`` is advanced with the pair.
        """
        self.reference, self.copy = reference, reference.copy()
        self.interval = periods * reference.period  # s
        self._periods = periods
        parameters = reference.parameters
        self._radii = base_radii(parameters)
        gears = parameters.gears
        (r1, r2), (j1, j2) = self._radii, (gears.driving.inertia, gears.driven.inertia)
        # What a change of u, or of its rate, turns each shaft by at the same momentum.
        total = j2 * r1 * r1 + j1 * r2 * r2
        self._turn = np.array([j2 * r1 / total, -j1 * r2 / total])
        length = 0.5 * gears.backlash
        rate = length * 2.0 * math.pi / reference.period
        self._scales = np.repeat([length, rate], COORDINATES // 2)
        if direction is None:
            direction = np.cos(np.arange(1.0, COORDINATES + 1.0))
        self._place_copy(separation / np.linalg.norm(direction) * direction * self._scales)

    def _difference(self) -> NDArray[np.float64]:
        """Coordinates and rates of the copy less those of the reference, SI units, shape (10,)."""
        ours, theirs = self.copy.state[0], self.reference.state[0]
        x, y, u, vx, vy, omega = (ours[name] - theirs[name] for name in ("x", "y", "u", "vx", "vy", "omega"))
        r1, r2 = self._radii
        return np.array(
            [x[0], y[0], x[1], y[1], u, vx[0], vy[0], vx[1], vy[1], r1 * omega[0] - r2 * omega[1]]
        )

    def _place_copy(self, change: NDArray[np.float64]) -> None:
        """Put the copy where the reference is, displaced by ``change``, SI units, shape (10,)."""
        self.copy.state[:] = self.reference.state
        state = self.copy.state[0]
        place, rate = change[: COORDINATES // 2], change[COORDINATES // 2 :]
        state["x"] += place[0:4:2]
        state["y"] += place[1:4:2]
        state["u"] += place[4]
        state["theta1"] += self._turn[0] * place[4]
        state["vx"] += rate[0:4:2]
        state["vy"] += rate[1:4:2]
        state["omega"] += self._turn * rate[4]

    def advance(self) -> None:
        """Both by one interval. Raises GearboxError if the run of one of them ends."""
        for orbit in (self.reference, self.copy):
            orbit.advance(self._periods)
            if orbit.status is not Status.RUNNING:
                raise GearboxError(orbit.reason)

    def distance(self) -> float:
        """Distance of the copy from the reference, relative to half the backlash."""
        return float(np.linalg.norm(self._difference() / self._scales))

    def rescale(self, distance: float) -> bool:
        """Bring the copy to ``distance`` of the reference.

        Latched impact speeds are scaled with the motion; all else of the copy becomes the reference's. False
        while a flag differs, as where one of the two has touched a flank that the other has still to reach: a
        point between them would be on the wrong side of one of their flags. False also if they coincide, or
        if gear 1 would pass the end of a turn.
        """
        now = self.distance()
        if now == 0.0 or any((self.copy.state[name] != self.reference.state[name]).any() for name in FLAGS):
            return False
        change = distance / now * self._difference()
        theta1 = self.reference.state["theta1"][0] + self._turn[0] * change[4]
        if not 0.0 <= theta1 < 2.0 * math.pi:
            return False
        latched = self.reference.state["impact_speed"]
        impact_speed = latched + distance / now * (self.copy.state["impact_speed"] - latched)
        self._place_copy(change)
        self.copy.state["impact_speed"] = impact_speed
        return True
