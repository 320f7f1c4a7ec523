"""Equations of motion, (31), (32), and the torques on the shafts.

See "Equations of motion" in docs/model.md.
"""

from __future__ import annotations

import math

from gear_dynamics_ros.physics.kernel.bearing import BearingForces, bearing_forces
from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.film import FilmForces, film_forces
from gear_dynamics_ros.physics.kernel.lanes import both, load2
from gear_dynamics_ros.physics.kernel.mesh import MeshForces, mesh_forces, rolling_rate
from gear_dynamics_ros.physics.kernel.records import Floats, KernelRecord, Motion, Rates


@inlined
def right_hand_side(
    constants: KernelRecord, state: KernelRecord, motion: Motion, excitation: Floats, lead: float
) -> tuple[Rates, MeshForces, BearingForces, FilmForces, float]:
    """Right-hand side (31), (32) with flags frozen, all it was made of, and the load torque in N m.

    Inlined, so that a caller pays for what it uses.
    """
    teeth = mesh_forces(constants, state, motion, excitation, lead)
    contacts = bearing_forces(constants, state, motion)
    nothing = both(0.0, 0.0)
    oil = FilmForces(nothing, nothing, both(1.0, 1.0), nothing)
    if constants.film:
        oil = film_forces(constants, state, motion)
    load = applied_load(constants, state, motion.omega[1])
    mesh_x, mesh_y = teeth.force * teeth.along_x, teeth.force * teeth.along_y
    per_mass = load2(constants.per_mass, 0)
    rates = Rates(
        ax=((contacts.force_x + oil.force_x) + both(-mesh_x, mesh_x)) * per_mass,
        ay=((contacts.force_y + oil.force_y) + both(-mesh_y, mesh_y)) * per_mass,
        omega_rate=both(
            state.drive_torque - teeth.force * constants.base_radius[0],
            teeth.force * constants.base_radius[1] - load,
        )
        * load2(constants.per_inertia, 0),
        force=teeth.force,
        shaft_power=state.drive_torque * motion.omega[0] - load * motion.omega[1],
        excitation_power=teeth.excitation_power,
        mesh_loss_rate=teeth.loss_rate,
        contact_loss_rate=contacts.loss_rate,
        film_power=oil.force_x * motion.vx + oil.force_y * motion.vy,
    )
    return rates, teeth, contacts, oil, load


@inlined
def applied_load(constants: KernelRecord, state: KernelRecord, omega2: float) -> float:
    """Load torque T_L in N m at the speed ``omega2`` of the driven gear in rad/s."""
    load = state.load_torque
    if constants.brake:
        load *= math.tanh(omega2)
    load += constants.load_viscous * omega2
    return float(load)


@compiled
def govern(constants: KernelRecord, state: KernelRecord, here: KernelRecord, interval: float) -> None:
    """PI governor, once a sample ``interval`` in s: T_M = clip(Kp err + I); I stands still while clipped."""
    error = state.speed - here.omega[0]
    wanted = constants.governor_proportional * error + state.governor
    limit = constants.governor_limit
    state.drive_torque = min(max(wanted, -limit), limit)
    if -limit <= wanted <= limit:
        state.governor += constants.governor_integral * error * interval


@inlined
def motion_after(constants: KernelRecord, start: Motion, h: float, drift: Motion, rates: Rates) -> Motion:
    """``start`` after ``h`` s at the speeds of ``drift`` and the accelerations of ``rates``."""
    return Motion(
        start.x + h * drift.vx,
        start.y + h * drift.vy,
        start.u + h * rolling_rate(constants, drift.omega),
        start.vx + h * rates.ax,
        start.vy + h * rates.ay,
        start.omega + h * rates.omega_rate,
    )
