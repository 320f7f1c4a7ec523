"""What a call tells: samples, energies, and whether the state is still finite."""

from __future__ import annotations

import math

from gear_dynamics_ros.physics.kernel.bearing import elastic_energy
from gear_dynamics_ros.physics.kernel.columns import (
    CENTRE_X,
    CENTRE_Y,
    CONTACT_FORCE_X,
    CONTACT_FORCE_Y,
    CONTACT_LOSS,
    DRIVE_TORQUE,
    DRIVING_ANGLE,
    DTE,
    DTE_RATE,
    ELASTIC_ENERGY,
    EXCITATION_WORK,
    FILM_FORCE_X,
    FILM_FORCE_Y,
    FILM_WORK,
    HALF_BACKLASH,
    KINETIC_ENERGY,
    LOAD_TORQUE,
    MESH_FORCE,
    MESH_LOSS,
    MESH_PHASE,
    MESHING_STATE,
    PENETRATION,
    POSITION_ANGLE,
    PRESSURE_ANGLE,
    SHAFT_WORK,
    SPEED,
    TIME,
)
from gear_dynamics_ros.physics.kernel.compiling import compiled
from gear_dynamics_ros.physics.kernel.records import TWO_PI, Floats, KernelRecord


@compiled
def write_sample(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    row: int,
    samples: Floats,
    angles: Floats,
) -> None:
    """One row of CHANNELS and the accumulated angles of both shafts, rad."""
    samples[row, TIME] = here.time
    samples[row, DTE] = here.q
    samples[row, DTE_RATE] = here.q_rate
    samples[row, MESH_FORCE] = here.mesh_force
    samples[row, PRESSURE_ANGLE] = math.atan2(here.sin_alpha, here.cos_alpha)
    samples[row, POSITION_ANGLE] = math.atan2(
        here.y[1] - here.y[0], constants.centre_distance + here.x[1] - here.x[0]
    )
    samples[row, HALF_BACKLASH] = here.half_backlash
    samples[row, MESHING_STATE] = state.flank
    for gear in range(2):
        samples[row, CENTRE_X[gear]] = here.x[gear]
        samples[row, CENTRE_Y[gear]] = here.y[gear]
        samples[row, CONTACT_FORCE_X[gear]] = here.contact_x[gear]
        samples[row, CONTACT_FORCE_Y[gear]] = here.contact_y[gear]
        samples[row, FILM_FORCE_X[gear]] = here.film_x[gear]
        samples[row, FILM_FORCE_Y[gear]] = here.film_y[gear]
        samples[row, PENETRATION[gear]] = here.penetration[gear]
        samples[row, SPEED[gear]] = here.omega[gear]
    samples[row, DRIVE_TORQUE] = state.drive_torque
    samples[row, LOAD_TORQUE] = here.load
    samples[row, DRIVING_ANGLE] = here.theta1
    mesh_turn = constants.teeth1 * here.part_turn
    samples[row, MESH_PHASE] = TWO_PI * (mesh_turn - math.floor(mesh_turn))
    angles[row, 0] = TWO_PI * state.revolutions + here.theta1
    angles[row, 1] = (constants.base_radius[0] * angles[row, 0] - here.u) / constants.base_radius[1]


@compiled
def stored_energy(constants: KernelRecord, state: KernelRecord, here: KernelRecord) -> float:
    """Energy in the springs of teeth and bearing contacts, N m."""
    total: float = here.mesh_energy
    for gear in range(2):
        total += elastic_energy(constants, state, here, gear)
    return total


@compiled
def write_energies(
    constants: KernelRecord, state: KernelRecord, here: KernelRecord, rows: Floats, row: int, first: int
) -> None:
    """ENERGIES into ``row``, from column ``first`` on, N m; see "Energy ledger" in docs/model.md."""
    kinetic = 0.0
    for gear in range(2):
        kinetic += 0.5 * (here.vx[gear] ** 2 + here.vy[gear] ** 2) / constants.per_mass[gear]
        kinetic += 0.5 * here.omega[gear] ** 2 / constants.per_inertia[gear]
        rows[row, first + CONTACT_LOSS[gear]] = here.contact_loss[gear]
        rows[row, first + FILM_WORK[gear]] = here.film_work[gear]
    rows[row, first + SHAFT_WORK] = here.shaft_work
    rows[row, first + EXCITATION_WORK] = here.excitation_work
    rows[row, first + MESH_LOSS] = here.mesh_loss
    rows[row, first + KINETIC_ENERGY] = kinetic
    rows[row, first + ELASTIC_ENERGY] = stored_energy(constants, state, here)


@compiled
def is_finite(here: KernelRecord) -> bool:
    """Whether motion and accelerations are finite."""
    total = here.u + here.theta1
    for gear in range(2):
        total += here.x[gear] + here.y[gear] + here.vx[gear] + here.vy[gear] + here.omega[gear]
        total += here.ax[gear] + here.ay[gear] + here.omega_rate[gear]
    return math.isfinite(total)
