"""Record types: what is passed around by reference, and what a right-hand side takes and gives.

Symbols are those of docs/model.md, SI units. Three of the types are kept apart by who may rely on them:

``CONSTANTS``  derived from the parameters, never written to;
``STATE``      everything that decides the future: motion, flags, latched values, commands in force, totals. A
               checkpoint holds it, and nothing else of what stands here;
``CALL``, ``POINT``  scratch of one call: what it counts, and points of the trajectory with all that was
               evaluated there (HERE, END of the trial step, LOW end of a search).

What belongs to both gears is computed side by side: a ``Pair`` has gear 1 in its first lane and gear 2 in its
second.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.lanes import load2, store

Floats: TypeAlias = NDArray[np.float64]
KernelRecord: TypeAlias = Any  # one numpy record of CONSTANTS, STATE, CALL or POINT
Pair: TypeAlias = Any  # two lanes, one a gear
Octet: TypeAlias = Any  # eight lanes
Pointer: TypeAlias = Any  # to float64 that an array of the caller's keeps

TINY = 1e-150  # m, m/s, ...: keeps 1/x finite where x is zero, and its square too
TWO_PI = 2.0 * math.pi
TURNS_PER_RADIAN = 1.0 / TWO_PI

SERIES_TERMS = 10  # of the functions of alpha, see ``series``
EXCITATIONS = 8  # values of the excitation table, see ``waves``
EVENT_COUNT = 9  # switching surfaces, see ``events``
HERE, END, LOW = range(3)  # of points; a plain step swaps HERE and END

F8, I8 = np.float64, np.int64
CACHE_LINE = 64  # bytes: lanes that straddle two lines are loaded twice


def padded_record(fields: list[Any]) -> np.dtype[Any]:
    """A record type padded to whole cache lines."""
    packed = np.dtype(fields, align=True)
    names = packed.names or ()
    layout: Any = {
        "names": names,
        "formats": [packed[name] for name in names],
        "offsets": [packed.fields[name][1] for name in names] if packed.fields else [],
        "itemsize": -(-packed.itemsize // CACHE_LINE) * CACHE_LINE,
        "aligned": True,
    }
    padded: np.dtype[Any] = np.dtype(layout)
    return padded


CONSTANTS = padded_record(
    [
        # inv alpha - inv alpha0, cos, sin and cot of alpha in powers of tan2_change, side by side
        ("involute_series", F8, 4 * SERIES_TERMS),
        ("kelvin", I8),
        ("film", I8),
        ("exact_geometry", I8),
        ("contact_damping", I8),
        ("nominal_phase", I8),
        ("brake", I8),
        ("governed", I8),
        ("padded_waves", I8),  # whole blocks of lanes
        ("waves", I8),  # even
        ("hunting", I8),  # turns of gear 1 after which the same teeth meet again
        ("steps_per_sample", I8),
        ("centre_distance", F8),  # a_s, m
        ("base_radius", F8, 2),  # m
        ("per_radii", F8),  # 1 / (r_b1 + r_b2), 1/m
        ("tan2_alpha0", F8),
        ("involute_alpha0", F8),
        ("half_backlash", F8),  # b0, m
        ("stiffness", F8),  # k_m, N/m
        ("damping", F8),  # c1, N s/m
        ("error_mean", F8),  # e_m, m
        ("per_mass", F8, 2),  # 1/kg
        ("per_inertia", F8, 2),  # 1/(kg m^2)
        ("per_mesh_mass", F8),  # 1/kg, acceleration of g by a newton of mesh force
        ("teeth1", F8),
        ("clearance", F8, 2),  # b_b, m
        ("kelvin_stiffness", F8, 2),  # N/m
        ("kelvin_damping", F8, 2),  # N s/m
        ("hertz", F8, 2),  # k_h sqrt(b_b + delta) of (2), N/m
        ("damping_factor", F8, 2),  # a
        ("per_oil_clearance", F8, 2),  # 1 / C, 1/m
        ("film_factor", F8, 2),  # mu (D/2) L^3 / (4 C^2), N s
        ("minimum_impact_speed", F8),  # m/s
        ("eccentricity_limit2", F8),  # squared
        ("load_viscous", F8),  # N m s
        ("governor_proportional", F8),  # N m s
        ("governor_integral", F8),  # N m
        ("governor_limit", F8),  # N m
        ("speed_limit", F8),  # rad/s
        ("step", F8),  # s
    ]
)
# Integrated. Works are N m since the start: what shafts and moving excitations put in, what mesh and bearing
# contacts took, what the films put in (negative where they damp).
MOTION = [
    ("x", F8, 2),  # m, displacements of the centres
    ("y", F8, 2),
    ("u", F8),  # m, r_b1 theta1 - r_b2 theta2
    ("theta1", F8),  # rad, within one revolution
    ("vx", F8, 2),  # m/s
    ("vy", F8, 2),
    ("omega", F8, 2),  # rad/s
    ("mesh_impulse", F8),  # N s, integral of F_p
    ("shaft_work", F8),
    ("excitation_work", F8),
    ("mesh_loss", F8),
    ("contact_loss", F8, 2),
    ("film_work", F8, 2),
]

STATE = padded_record(
    [
        *MOTION,
        ("impact_speed", F8, 2),  # m/s, latched: v_impact of (6)
        ("impact_time", F8, 2),  # s, when the contact began
        ("contact_age", F8, 2),  # s since then
        ("closing_speed", F8, 2),  # m/s, penetration rate then
        ("peak_force2", F8, 2),  # N^2, greatest contact force since then, squared
        ("drive_time", F8),  # s on the drive flank since the start
        ("back_time", F8),  # s on the back flank
        ("nominal_turn", F8),  # nominal angle of gear 1 in turns, 0 to 1
        ("nominal_rest", F8),  # what rounding took from it
        ("governor", F8),  # N m, integral part of the governor's torque
        ("drive_torque", F8),  # N m, applied, held over a sample interval
        ("speed", F8),  # rad/s, commanded: set-point of the governor or nominal speed
        ("load_torque", F8),  # N m, commanded
        ("flank", F8),  # 1 drive flank, 0 apart, -1 back flank
        ("mesh_clamped", F8),  # 1: the mesh would pull, force held at zero
        ("contact", F8, 2),  # 1: bearing in contact
        ("clamped", F8, 2),  # 1: bearing would pull
        ("film_limited", F8, 2),  # 1: eccentricity beyond the film's limit
        ("whole_turns", I8),  # of gear 1 in the phase, n modulo the hunting cycle
        ("revolutions", I8),  # whole revolutions of gear 1 since the start
        ("steps", I8),
        ("events", I8),
        ("capped", I8),
        ("impacts", I8),
        ("flank_changes", I8),
        ("pressed", I8),  # the backlash was used up at the end of a step
    ]
)

CALL = padded_record([("listed", I8)])  # rows of this call's list of impacts

POINT = padded_record(
    [
        ("excitation", F8, EXCITATIONS),
        ("middle", F8, EXCITATIONS),  # excitations half a step before
        *MOTION,
        ("time", F8),  # s
        ("part_turn", F8),  # of gear 1, which sets the phase beside the whole turns
        ("lead", F8),  # rad of mesh phase by which the state is ahead of the excitations
        ("value", F8, EVENT_COUNT),  # of the switching surfaces
        ("rate", F8, EVENT_COUNT),
        ("ax", F8, 2),  # m/s^2
        ("ay", F8, 2),
        ("omega_rate", F8, 2),  # rad/s^2, angular accelerations
        ("mesh_force", F8),
        ("shaft_power", F8),  # W, as all of the works' rates
        ("excitation_power", F8),
        ("mesh_loss_rate", F8),
        ("contact_loss_rate", F8, 2),
        ("film_power", F8, 2),
        ("q", F8),
        ("q_rate", F8),
        ("cos_alpha", F8),
        ("sin_alpha", F8),
        ("half_backlash", F8),
        ("surface", F8),  # m, z1 + z2
        ("surface_rate", F8),
        ("deflection", F8),  # m, g
        ("deflection_rate", F8),
        ("stiffness", F8),  # N/m, k_1
        ("stiffness_rate", F8),
        ("mesh_energy", F8),  # N m, of the teeth's spring
        ("load", F8),  # N m, T_L
        ("penetration", F8, 2),  # m, delta
        ("penetration_rate", F8, 2),  # m/s
        ("contact_x", F8, 2),  # N, forces on the gears
        ("contact_y", F8, 2),
        ("film_x", F8, 2),
        ("film_y", F8, 2),
        ("damping", F8, 2),  # N s/m, of the bearing contacts
    ]
)


class Motion(NamedTuple):
    """What the right-hand side depends on."""

    x: Pair  # m, displacements of the centres
    y: Pair
    u: float  # m, r_b1 theta1 - r_b2 theta2
    vx: Pair  # m/s
    vy: Pair
    omega: Pair  # rad/s


class ImpactList(NamedTuple):
    """Where the bearing contacts that end in a call are listed."""

    rows: Pointer  # to rows of IMPACTS
    call: KernelRecord  # counts them


class Rates(NamedTuple):
    """What a step integrates: accelerations, and the mesh force and powers of the energy ledger."""

    ax: Pair  # m/s^2
    ay: Pair
    omega_rate: Pair  # rad/s^2
    force: float  # N, F_p
    shaft_power: float  # W, P_s
    excitation_power: float  # P_k + P_e + P_z
    mesh_loss_rate: float  # D_m
    contact_loss_rate: Pair  # D_i
    film_power: Pair  # P_oi


@inlined
def motion_at(point: KernelRecord) -> Motion:
    """What the right-hand side needs of ``point``."""
    return Motion(
        load2(point.x, 0),
        load2(point.y, 0),
        point.u,
        load2(point.vx, 0),
        load2(point.vy, 0),
        load2(point.omega, 0),
    )


@inlined
def rates_at(point: KernelRecord) -> Rates:
    """Rates as ``evaluate_point`` left them."""
    return Rates(
        load2(point.ax, 0),
        load2(point.ay, 0),
        load2(point.omega_rate, 0),
        point.mesh_force,
        point.shaft_power,
        point.excitation_power,
        point.mesh_loss_rate,
        load2(point.contact_loss_rate, 0),
        load2(point.film_power, 0),
    )


@inlined
def store_rates(point: KernelRecord, rates: Rates) -> None:
    """Store what a step integrates."""
    store(point.ax, 0, rates.ax)
    store(point.ay, 0, rates.ay)
    store(point.omega_rate, 0, rates.omega_rate)
    point.mesh_force, point.shaft_power = rates.force, rates.shaft_power
    point.excitation_power, point.mesh_loss_rate = rates.excitation_power, rates.mesh_loss_rate
    store(point.contact_loss_rate, 0, rates.contact_loss_rate)
    store(point.film_power, 0, rates.film_power)


@compiled
def copy_motion(source: KernelRecord, target: KernelRecord) -> None:
    """Integrated values from a state to a point or back."""
    for gear in range(2):
        target.x[gear], target.y[gear] = source.x[gear], source.y[gear]
        target.vx[gear], target.vy[gear] = source.vx[gear], source.vy[gear]
        target.omega[gear] = source.omega[gear]
        target.contact_loss[gear], target.film_work[gear] = source.contact_loss[gear], source.film_work[gear]
    target.u, target.theta1 = source.u, source.theta1
    target.mesh_impulse, target.shaft_work = source.mesh_impulse, source.shaft_work
    target.excitation_work, target.mesh_loss = source.excitation_work, source.mesh_loss
