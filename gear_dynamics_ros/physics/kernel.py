"""Every compiled function of the model and of its integrator.

One file on purpose: numba's cache looks at the file of the outermost function only. Symbols and equation
numbers are the paper's; all values are SI. A hot function returns a status, never raises.

What belongs to both gears is computed side by side: a ``Pair`` has gear 1 in its first lane and gear 2 in its
second. Four records are passed around, by reference:

``constants``  derived from the parameters, never written to;
``state``      everything that decides the future: motion, flags, latched values, commands in force, totals;
``points``     points of the trajectory with all that was evaluated there: HERE, END of the trial step,
               LOW end of a search;
``waves``      the periodic excitations' sines and cosines, with ``amplitudes`` their table.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gear_dynamics_ros.physics.lanes import (
    absolute,
    any_negative,
    arctangent_of,
    at_least,
    both,
    copy,
    load2,
    load4,
    load8,
    pointer,
    square_root,
    store,
)

# numba's cache knows nothing of lanes.py: after a change of it, this line changes too. A test compares.
LANES_SHA256 = "a3d59364eeedd7d45b825c9db8130b756d5dc249593bc87e6454a7fe307b1192"

Floats = NDArray[np.float64]
Record = Any  # one numpy record of CONSTANTS, STATE or POINT
Pair = Any  # two lanes, one a gear
Octet = Any  # eight lanes
Pointer = Any  # to float64 that an array of the caller's keeps

TWO_PI = 2.0 * math.pi
TURNS_PER_RADIAN = 1.0 / TWO_PI
TINY = 1e-150  # m, m/s, ...: keeps 1/x finite where x is zero, and its square too

# Events: a surface's value is positive on the side its flag stands for.
UPPER_GAP, LOWER_GAP = 0, 1
BEARING_GAP = 2  # and 3
MESH_CLAMP = 4
BEARING_CLAMP = 5  # and 6
FILM_LIMIT = 7  # and 8
EVENT_COUNT = 9

# Columns of the excitation table, one pair of amplitudes (cosine, sine) each, and of its values.
SURFACE, SURFACE_SLOPE, SURFACE_CURVATURE, STIFFNESS, STIFFNESS_SLOPE, ERROR, ERROR_SLOPE, ERROR_CURVATURE = (
    range(8)
)
EXCITATIONS = 8
# Rows of ``waves``: orders per hunting cycle; the waves on the steps' own grid; their turn over half a step;
# waves at any other phase.
ORDER, COSINE, SINE, TURN_COSINE, TURN_SINE, OTHER_COSINE, OTHER_SINE = range(7)
WAVE_ROWS = 7
ROW_BLOCK = 8  # waves are padded to whole blocks of lanes
REFRESH_STEPS = 16  # after so many steps at the latest the waves are evaluated afresh

SERIES_TERMS = 10
SERIES_REACH = 1.0 / 40.0  # of tan^2(alpha0): beyond it the involute is evaluated in full
ARCSINE_REACH = 1e-2
ARCTANGENT_REACH = 0.2

# Of the change of an event's value over its step. A gap may open onto a jump of the damping force; a clamp is
# a mere kink, where an error in time counts by its square.
GAP_TOLERANCE = 1e-8
CLAMP_TOLERANCE = 1e-6
SEARCH_LIMIT = 30
STOPS_PER_STEP = 24
# Each stop, and what is settled late after the last, may end the contacts of both bearings.
IMPACTS_PER_STEP = 2 * (STOPS_PER_STEP + 1)
# Of the step: the shortest substep that the beginning or end of a bearing contact asks for.
GAP_FRACTION = 0.1
# The largest product of substep and damping rate of a bearing contact; RK4 itself bears 2.78.
STIFFNESS_LIMIT = 0.25
SUBSTEPS_LIMIT = 4096.0
SHORTEST_SUBSTEP = 1e-9  # of the step

HERE, END, LOW = range(3)  # of points; a plain step swaps HERE and END

RUNNING, OVER_SPEED, NON_FINITE, CENTRES_PRESSED = range(4)

CHANNEL_COUNT = 28
IMPACT_SIZE = 6

F8, I8 = np.float64, np.int64

CACHE_LINE = 64  # bytes: lanes that straddle two lines are loaded twice


def whole_lines(fields: list[Any]) -> np.dtype[Any]:
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


CONSTANTS = whole_lines(
    [
        # inv alpha - inv alpha0, cos, sin and cot of alpha in powers of xi, side by side
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
        ("per_mesh_mass", F8),  # 1/kg, acceleration of the approach by a newton of mesh force
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

STATE = whole_lines(
    [
        *MOTION,
        ("impact_speed", F8, 2),  # m/s, latched: v_impact of (6)
        ("impact_time", F8, 2),  # s, when the contact began
        ("contact_age", F8, 2),  # s since then
        ("approach", F8, 2),  # m/s, closing speed then
        ("peak_force2", F8, 2),  # N^2, greatest contact force since then, squared
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
        ("starved", F8, 2),  # 1: eccentricity beyond the film's limit
        ("turn", I8),  # whole turns of the phase modulo the hunting cycle
        ("revolutions", I8),  # whole revolutions of gear 1 since the start
        ("steps", I8),
        ("events", I8),
        ("capped", I8),
        ("impacts", I8),
        ("flank_changes", I8),
        ("pressed", I8),  # the backlash was used up at the end of a step
        ("listed", I8),  # rows of this call's list of impacts
    ]
)

POINT = whole_lines(
    [
        ("excitation", F8, EXCITATIONS),
        ("middle", F8, EXCITATIONS),  # excitations half a step before
        *MOTION,
        ("time", F8),  # s
        ("turn", F8),  # of gear 1, what sets the phase beside whole turns
        ("lag", F8),  # rad of mesh phase by which the state is ahead of the excitations below
        ("value", F8, EVENT_COUNT),
        ("rate", F8, EVENT_COUNT),
        ("ax", F8, 2),  # m/s^2
        ("ay", F8, 2),
        ("alpha", F8, 2),  # rad/s^2
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
        ("mesh_energy", F8),  # N m, of the teeth's spring
        ("load", F8),
        ("penetration", F8, 2),
        ("closing", F8, 2),
        ("contact_x", F8, 2),
        ("contact_y", F8, 2),
        ("film_x", F8, 2),
        ("film_y", F8, 2),
        ("damping", F8, 2),  # N s/m
    ]
)


class Motion(NamedTuple):
    """What the right-hand side depends on."""

    x: Pair
    y: Pair
    u: float
    vx: Pair
    vy: Pair
    omega: Pair


class Mesh(NamedTuple):
    """The mesh at one motion; ``along`` is the direction of the force on gear 2."""

    force: float
    along_x: float
    along_y: float
    q: float
    q_rate: float
    cos_alpha: float
    sin_alpha: float
    half_backlash: float
    half_backlash_rate: float
    approach: float  # g
    approach_rate: float
    stiffness: float
    stiffness_rate: float
    surface: float  # z1 + z2
    surface_rate: float
    lean_x: float  # by how much g falls as gear 2 moves
    lean_y: float
    excitation_power: float
    loss_rate: float


class Bearings(NamedTuple):
    """Both bearings' contacts."""

    force_x: Pair
    force_y: Pair
    penetration: Pair
    closing: Pair
    damping: Pair
    clamp: Pair  # positive while the contact pushes
    loss_rate: Pair


class Film(NamedTuple):
    """Both bearings' films, ``margin`` to the eccentricity limit, squared."""

    force_x: Pair
    force_y: Pair
    margin: Pair
    margin_rate: Pair


class Rates(NamedTuple):
    """What a step integrates."""

    ax: Pair
    ay: Pair
    alpha: Pair
    force: float
    shaft_power: float
    excitation_power: float
    mesh_loss_rate: float
    contact_loss_rate: Pair
    film_power: Pair


hot = njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
compiled = njit(cache=True, fastmath={"contract"}, error_model="numpy")


@hot
def sine_cosine(turns: Octet) -> tuple[Octet, Octet]:
    """Sine and cosine of 2 pi ``turns``, exact to rounding.

    Taylor polynomials of the half angle, |x| <= pi/2.
    """
    x = math.pi * (turns - ((turns + 6755399441055744.0) - 6755399441055744.0))
    x2 = x * x
    s = 1.0 / 51090942171709440000.0 * x2 - 1.0 / 121645100408832000.0
    s = s * x2 + 1.0 / 355687428096000.0
    s = s * x2 - 1.0 / 1307674368000.0
    s = s * x2 + 1.0 / 6227020800.0
    s = s * x2 - 1.0 / 39916800.0
    s = s * x2 + 1.0 / 362880.0
    s = s * x2 - 1.0 / 5040.0
    s = s * x2 + 1.0 / 120.0
    s = s * x2 - 1.0 / 6.0
    s = x + x * x2 * s
    c = 1.0 / 2432902008176640000.0 * x2 - 1.0 / 6402373705728000.0
    c = c * x2 + 1.0 / 20922789888000.0
    c = c * x2 - 1.0 / 87178291200.0
    c = c * x2 + 1.0 / 479001600.0
    c = c * x2 - 1.0 / 3628800.0
    c = c * x2 + 1.0 / 40320.0
    c = c * x2 - 1.0 / 720.0
    c = c * x2 + 1.0 / 24.0
    c = c * x2 - 0.5
    c = c * x2 + 1.0
    return 2.0 * s * c, 1.0 - 2.0 * s * s


@hot
def set_waves(constants: Record, waves: Pointer, turn: float, cosine_row: int, sine_row: int) -> None:
    """Sines and cosines of all waves at ``turn``, the fraction of the hunting cycle."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        sine, cosine = sine_cosine(load8(waves, ORDER * n + j) * turn)
        store(waves, cosine_row * n + j, cosine)
        store(waves, sine_row * n + j, sine)


@hot
def turn_waves(constants: Record, waves: Pointer) -> None:
    """The waves on the grid half a step on: one rotation."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        cosine, sine = load8(waves, COSINE * n + j), load8(waves, SINE * n + j)
        turn_cosine, turn_sine = load8(waves, TURN_COSINE * n + j), load8(waves, TURN_SINE * n + j)
        store(waves, COSINE * n + j, cosine * turn_cosine - sine * turn_sine)
        store(waves, SINE * n + j, sine * turn_cosine + cosine * turn_sine)


@hot
def nudge_waves(constants: Record, waves: Pointer, turn: float) -> None:
    """The waves on the grid turned by the small ``turn`` (a fraction of the hunting cycle)."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        cosine, sine = load8(waves, COSINE * n + j), load8(waves, SINE * n + j)
        x = load8(waves, ORDER * n + j) * (TWO_PI * turn)
        x2 = x * x
        turn_sine = x * (1.0 - x2 * (1.0 / 6.0 - x2 * (1.0 / 120.0)))
        versine = x2 * (0.5 - x2 * (1.0 / 24.0 - x2 * (1.0 / 720.0)))
        store(waves, COSINE * n + j, cosine - (cosine * versine + sine * turn_sine))
        store(waves, SINE * n + j, sine - (sine * versine - cosine * turn_sine))


@hot
def sum_waves(
    constants: Record, waves: Pointer, amplitudes: Pointer, cosine_row: int, sine_row: int
) -> Octet:
    """All columns of the excitation table, eight side by side."""
    n = constants.padded_waves
    c, s = cosine_row * n, sine_row * n
    even_c, even_s = waves[c] * load8(amplitudes, 0), waves[s] * load8(amplitudes, 8)
    odd_c, odd_s = waves[c + 1] * load8(amplitudes, 16), waves[s + 1] * load8(amplitudes, 24)
    for j in range(2, constants.waves, 2):
        even_c = even_c + waves[c + j] * load8(amplitudes, 16 * j)
        even_s = even_s + waves[s + j] * load8(amplitudes, 16 * j + 8)
        odd_c = odd_c + waves[c + j + 1] * load8(amplitudes, 16 * j + 16)
        odd_s = odd_s + waves[s + j + 1] * load8(amplitudes, 16 * j + 24)
    return (even_c + even_s) + (odd_c + odd_s)


@hot
def arctangent(x: Any) -> Any:
    """atan x to rounding: Taylor's series where the film mostly is, without calls that spill registers."""
    if any_negative(ARCTANGENT_REACH - absolute(x)):
        return arctangent_of(x)
    x2 = x * x
    x4 = x2 * x2
    x8 = x4 * x4
    low = (1.0 / 3.0 - 1.0 / 5.0 * x2) + x4 * (1.0 / 7.0 - 1.0 / 9.0 * x2)
    high = (1.0 / 11.0 - 1.0 / 13.0 * x2) + x4 * (1.0 / 15.0 - 1.0 / 17.0 * x2)
    return x - x * x2 * (low + x8 * (high + x8 * (1.0 / 19.0 - 1.0 / 21.0 * x2)))


@hot
def film_force(coefficient: Any, w: Any, ex: Any, ey: Any, ux: Any, uy: Any) -> tuple[Any, Any]:
    """Capone's short-bearing film (9)-(15): force on the shaft (x, y) in N; of one bearing or of both.

    ``coefficient`` mu (D/2) L^3 / (4 C^2) in N s, ``w`` signed shaft speed in rad/s; ``ex``, ``ey``
    eccentricity (dimensionless, below 1) and ``ux``, ``uy`` velocity, both divided by the radial clearance C.
    """
    a = w * ex - 2.0 * uy
    b = w * ey + 2.0 * ux
    m = square_root(a * a + b * b)
    inverse_m = 1.0 / at_least(m, TINY)
    inverse_root = 1.0 / square_root(1.0 - (ex * ex + ey * ey))
    inverse_s = inverse_root * inverse_root
    cos_al, sin_al = -a * inverse_m, -b * inverse_m
    mh = ex * b - ey * a
    g = 2.0 * inverse_root * (0.5 * math.pi + arctangent(mh * (inverse_m * inverse_root)))
    v = (2.0 + mh * inverse_m * g) * inverse_s
    c = ex * cos_al + ey * sin_al
    big_s = c / (1.0 - c * c)
    f = -coefficient * m * inverse_s
    return (
        f * (3.0 * ex * v - sin_al * g - 2.0 * cos_al * big_s),
        f * (3.0 * ey * v + cos_al * g - 2.0 * sin_al * big_s),
    )


@compiled
def held_eccentricity(constants: Record, state: Record, gear: int, eps2: float) -> float:
    """Factor that brings a journal beyond the film's limit back to it.

    Before that event is located a trial step may overshoot the limit, yet never the wall.
    """
    limit2 = constants.eccentricity_limit2
    if state.starved[gear] == 0.0:
        limit2 = 0.5 * (1.0 + limit2)
        if eps2 <= limit2:
            return 1.0
    return math.sqrt(limit2 / eps2)


@hot
def film(constants: Record, state: Record, motion: Motion) -> Film:
    """Oil films (9)-(15) of both bearings."""
    per_c = load2(constants.per_oil_clearance, 0)
    w = both(motion.omega[0], -motion.omega[1])
    if constants.nominal_phase:
        w = state.speed * both(1.0, -constants.base_radius[0] / constants.base_radius[1])
    ex, ey = motion.x * per_c, motion.y * per_c
    ux, uy = motion.vx * per_c, motion.vy * per_c
    eps2 = ex * ex + ey * ey
    margin = constants.eccentricity_limit2 - eps2
    margin_rate = -2.0 * (ex * ux + ey * uy)
    starved = load2(state.starved, 0)
    if any_negative(margin) or any_negative(-starved):
        margin = margin * (1.0 - 2.0 * starved)
        margin_rate = margin_rate * (1.0 - 2.0 * starved)
        held = both(
            held_eccentricity(constants, state, 0, eps2[0]), held_eccentricity(constants, state, 1, eps2[1])
        )
        ex, ey = ex * held, ey * held
    force_x, force_y = film_force(load2(constants.film_factor, 0), w, ex, ey, ux, uy)
    return Film(force_x, force_y, margin, margin_rate)


@hot
def bearings(constants: Record, state: Record, motion: Motion) -> Bearings:
    """Contacts (2)-(6) of both bearings, flags frozen."""
    d = square_root(motion.x * motion.x + motion.y * motion.y)
    inverse_d = 1.0 / at_least(d, TINY)
    nx, ny = motion.x * inverse_d, motion.y * inverse_d
    penetration = d - load2(constants.clearance, 0)
    closing = motion.vx * nx + motion.vy * ny
    contact, clamped = load2(state.contact, 0), load2(state.clamped, 0)
    if constants.kelvin:
        elastic = load2(constants.kelvin_stiffness, 0) * penetration
        damping = load2(constants.kelvin_damping, 0)
        total = elastic + damping * closing
        clamp = total
    else:
        depth = at_least(penetration, 0.0)
        elastic = load2(constants.hertz, 0) * depth * square_root(depth * d) * inverse_d
        per_speed = load2(constants.damping_factor, 0) / load2(state.impact_speed, 0)
        damping = elastic * per_speed
        clamp = 1.0 + per_speed * closing
        total = elastic * clamp
    force = (contact - clamped) * total
    return Bearings(
        force_x=-force * nx,
        force_y=-force * ny,
        penetration=penetration,
        closing=closing,
        damping=contact * damping,
        clamp=(1.0 - contact) + (contact - 2.0 * clamped) * clamp,
        loss_rate=(force - contact * elastic) * closing,
    )


@hot
def involute_functions(constants: Record, xi: float) -> tuple[float, float, float, float]:
    """inv alpha - inv alpha0, cos, sin and cot of alpha where tan^2 alpha = tan^2 alpha0 + ``xi``."""
    if abs(xi) > SERIES_REACH * constants.tan2_alpha0:
        tangent = math.sqrt(constants.tan2_alpha0 + xi)
        cosine = 1.0 / math.sqrt(1.0 + constants.tan2_alpha0 + xi)
        involute = tangent - math.atan(tangent) - constants.involute_alpha0
        return involute, cosine, cosine * tangent, 1.0 / tangent
    series = constants.involute_series
    xi2 = xi * xi
    xi4 = xi2 * xi2
    low = (load4(series, 0) + load4(series, 4) * xi) + (load4(series, 8) + load4(series, 12) * xi) * xi2
    high = (load4(series, 16) + load4(series, 20) * xi) + (load4(series, 24) + load4(series, 28) * xi) * xi2
    top = load4(series, 32) + load4(series, 36) * xi
    total = low + (high + top * xi4) * xi4
    return total[0], total[1], total[2], total[3]


@hot
def mesh(constants: Record, state: Record, motion: Motion, excitation: Floats, lag: float) -> Mesh:
    """Teeth in mesh (21)-(30), flags frozen.

    The state is ``lag`` rad of mesh phase ahead of ``excitation``.
    """
    r1, r2 = constants.base_radius[0], constants.base_radius[1]
    r_sum = r1 + r2
    half = 0.5 * lag
    phi_rate = phase_rate(constants, state, motion.omega[0])
    z, z_rate = surface_at(excitation, lag, phi_rate)
    k1 = constants.stiffness * (1.0 + excitation[STIFFNESS] + lag * excitation[STIFFNESS_SLOPE])
    k1_rate = constants.stiffness * phi_rate * excitation[STIFFNESS_SLOPE]
    e_moving = excitation[ERROR] + lag * (excitation[ERROR_SLOPE] + half * excitation[ERROR_CURVATURE])
    e = constants.error_mean + e_moving
    e_rate = phi_rate * (excitation[ERROR_SLOPE] + lag * excitation[ERROR_CURVATURE])

    ux, uy = motion.x[1] - motion.x[0], motion.y[1] - motion.y[0]
    wx, wy = motion.vx[1] - motion.vx[0], motion.vy[1] - motion.vy[0]
    dx = constants.centre_distance + ux
    xi = (ux * (constants.centre_distance + dx) + uy * uy) * (constants.per_radii * constants.per_radii)
    involute, cos_alpha, sin_alpha, cot_alpha = involute_functions(constants, xi)
    per_a = cos_alpha * constants.per_radii
    cos_beta, sin_beta = dx * per_a, uy * per_a
    sin_gamma = sin_alpha * cos_beta - cos_alpha * sin_beta
    cos_gamma = cos_alpha * cos_beta + sin_alpha * sin_beta
    a_rate = cos_beta * wx + sin_beta * wy
    beta_rate = (cos_beta * wy - sin_beta * wx) * per_a
    b1 = r_sum * involute + (constants.half_backlash - 0.5 * z)
    b1_rate = sin_alpha * a_rate - 0.5 * z_rate
    u_rate = r1 * motion.omega[0] - r2 * motion.omega[1]
    flank = state.flank
    along_x, along_y = sin_gamma, cos_gamma
    if constants.exact_geometry:
        q = (motion.u - e) - r_sum * position_angle(sin_beta, cos_beta)
        q_rate = (u_rate - e_rate) - r_sum * beta_rate
        if flank < 0.0:
            along_x = -(sin_alpha * cos_beta + cos_alpha * sin_beta)
            along_y = cos_alpha * cos_beta - sin_alpha * sin_beta
        lean_x, lean_y = along_x, along_y
    else:
        gamma_rate = (a_rate * per_a) * cot_alpha - beta_rate
        q = (motion.u - e) - ux * sin_gamma - uy * cos_gamma
        q_rate = (u_rate - e_rate) - wx * sin_gamma - wy * cos_gamma
        q_rate -= gamma_rate * (ux * cos_gamma - uy * sin_gamma)
        lean_x, lean_y = along_x + flank * sin_alpha * cos_beta, along_y + flank * sin_alpha * sin_beta

    touching = abs(flank)
    side = flank + (1.0 - touching)
    approach = touching * (q - flank * b1)
    approach_rate = q_rate - side * b1_rate
    elastic = k1 * approach
    if constants.contact_damping:
        force = (touching - state.mesh_clamped) * (elastic + constants.damping * approach_rate)
    else:
        force = elastic + constants.damping * q_rate
    return Mesh(
        force=force,
        along_x=along_x,
        along_y=along_y,
        q=q,
        q_rate=q_rate,
        cos_alpha=cos_alpha,
        sin_alpha=sin_alpha,
        half_backlash=b1,
        half_backlash_rate=b1_rate,
        approach=approach,
        approach_rate=approach_rate,
        stiffness=k1,
        stiffness_rate=k1_rate,
        surface=z,
        surface_rate=z_rate,
        lean_x=lean_x,
        lean_y=lean_y,
        excitation_power=0.5 * k1_rate * approach * approach - force * (e_rate - 0.5 * side * z_rate),
        loss_rate=(force - elastic) * approach_rate,
    )


@hot
def phase_rate(constants: Record, state: Record, omega1: float) -> float:
    """Rate of the mesh phase, rad/s."""
    speed = state.speed if constants.nominal_phase else omega1
    rate: float = constants.teeth1 * speed
    return rate


@hot
def position_angle(sin_beta: float, cos_beta: float) -> float:
    """beta of (27)."""
    if abs(sin_beta) > ARCSINE_REACH:
        return math.atan2(sin_beta, cos_beta)
    s2 = sin_beta * sin_beta
    return sin_beta + sin_beta * s2 * (
        (1.0 / 6.0 + s2 * 0.075) + s2 * s2 * (5.0 / 112.0 + s2 * (35.0 / 1152.0))
    )


@hot
def dynamics(
    constants: Record, state: Record, motion: Motion, excitation: Floats, lag: float
) -> tuple[Rates, Mesh, Bearings, Film, float]:
    """Right-hand side (31), (32) with flags frozen, all it was made of, and the load torque in N m.

    Inlined, so that a caller pays for what it uses.
    """
    teeth = mesh(constants, state, motion, excitation, lag)
    contacts = bearings(constants, state, motion)
    nothing = both(0.0, 0.0)
    oil = Film(nothing, nothing, both(1.0, 1.0), nothing)
    if constants.film:
        oil = film(constants, state, motion)
    load = state.load_torque
    if constants.brake:
        load *= math.tanh(motion.omega[1])
    load += constants.load_viscous * motion.omega[1]
    mesh_x, mesh_y = teeth.force * teeth.along_x, teeth.force * teeth.along_y
    per_mass = load2(constants.per_mass, 0)
    rates = Rates(
        ax=((contacts.force_x + oil.force_x) + both(-mesh_x, mesh_x)) * per_mass,
        ay=((contacts.force_y + oil.force_y) + both(-mesh_y, mesh_y)) * per_mass,
        alpha=both(
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


@hot
def motion_at(point: Record) -> Motion:
    """What the right-hand side needs of ``point``."""
    return Motion(
        load2(point.x, 0),
        load2(point.y, 0),
        point.u,
        load2(point.vx, 0),
        load2(point.vy, 0),
        load2(point.omega, 0),
    )


@hot
def evaluate(constants: Record, state: Record, point: Record, before: float) -> bool:
    """``dynamics`` at ``point``, kept there with the events' values and rates.

    Returns whether an event's value is negative, or was ``before`` s ago by its rate.
    """
    motion = motion_at(point)
    rates, teeth, contacts, oil, load = dynamics(constants, state, motion, point.excitation, point.lag)
    keep_rates(point, rates)
    point.q, point.q_rate = teeth.q, teeth.q_rate
    point.cos_alpha, point.sin_alpha = teeth.cos_alpha, teeth.sin_alpha
    point.half_backlash, point.load = teeth.half_backlash, load
    point.surface, point.surface_rate = teeth.surface, teeth.surface_rate
    point.mesh_energy = 0.5 * teeth.stiffness * teeth.approach * teeth.approach
    store(point.penetration, 0, contacts.penetration)
    store(point.closing, 0, contacts.closing)
    store(point.contact_x, 0, contacts.force_x)
    store(point.contact_y, 0, contacts.force_y)
    store(point.damping, 0, contacts.damping)
    store(point.film_x, 0, oil.force_x)
    store(point.film_y, 0, oil.force_y)
    crossed = keep_mesh_events(constants, state, point, teeth, rates, before)
    side = 2.0 * load2(state.contact, 0) - 1.0
    crossed |= keep_events(point, BEARING_GAP, side * contacts.penetration, side * contacts.closing, before)
    clamp_rate = bearing_clamp_rate(constants, state, motion, rates, contacts)
    crossed |= keep_events(point, BEARING_CLAMP, contacts.clamp, clamp_rate, before)
    crossed |= keep_events(point, FILM_LIMIT, oil.margin, oil.margin_rate, before)
    return crossed


@hot
def keep_events(point: Record, event: int, value: Pair, rate: Pair, before: float) -> bool:
    """Store both bearings' ``event``; whether a value is negative, or was ``before`` s ago by its rate."""
    store(point.value, event, value)
    store(point.rate, event, rate)
    return bool(any_negative(value) | any_negative(value - before * rate))


@hot
def keep_rates(point: Record, rates: Rates) -> None:
    """Store what a step integrates."""
    store(point.ax, 0, rates.ax)
    store(point.ay, 0, rates.ay)
    store(point.alpha, 0, rates.alpha)
    point.mesh_force, point.shaft_power = rates.force, rates.shaft_power
    point.excitation_power, point.mesh_loss_rate = rates.excitation_power, rates.mesh_loss_rate
    store(point.contact_loss_rate, 0, rates.contact_loss_rate)
    store(point.film_power, 0, rates.film_power)


@hot
def bearing_clamp_rate(
    constants: Record, state: Record, motion: Motion, rates: Rates, contacts: Bearings
) -> Pair:
    """Rate of the bearing contacts' ``clamp``."""
    inverse_d = 1.0 / at_least(contacts.penetration + load2(constants.clearance, 0), TINY)
    along = (rates.ax * motion.x + rates.ay * motion.y) * inverse_d
    speed2 = motion.vx * motion.vx + motion.vy * motion.vy
    closing_rate = along + (speed2 - contacts.closing * contacts.closing) * inverse_d
    if constants.kelvin:
        stiffness, damping = load2(constants.kelvin_stiffness, 0), load2(constants.kelvin_damping, 0)
        rate = stiffness * contacts.closing + damping * closing_rate
    else:
        rate = load2(constants.damping_factor, 0) / load2(state.impact_speed, 0) * closing_rate
    return (load2(state.contact, 0) - 2.0 * load2(state.clamped, 0)) * rate


@hot
def keep_mesh_events(
    constants: Record, state: Record, point: Record, teeth: Mesh, rates: Rates, before: float
) -> bool:
    """The flanks' gaps, and what would make the mesh pull, as ``keep_events`` does."""
    b1, b1_rate, flank = teeth.half_backlash, teeth.half_backlash_rate, state.flank
    upper, upper_rate = b1 - teeth.q, b1_rate - teeth.q_rate
    lower, lower_rate = teeth.q + b1, teeth.q_rate + b1_rate
    clamp, clamp_rate = 1.0, 0.0
    if flank > 0.0:
        upper, upper_rate, lower, lower_rate = -upper, -upper_rate, 1.0, 0.0
    elif flank < 0.0:
        upper, upper_rate, lower, lower_rate = 1.0, 0.0, -lower, -lower_rate
    if constants.contact_damping and flank != 0.0:
        sign = flank * (1.0 - 2.0 * state.mesh_clamped)
        clamp = sign * (teeth.stiffness * teeth.approach + constants.damping * teeth.approach_rate)
        clamp_rate = sign * push_rate(constants, state, point, teeth, rates)
    point.value[UPPER_GAP], point.value[LOWER_GAP], point.value[MESH_CLAMP] = upper, lower, clamp
    point.rate[UPPER_GAP], point.rate[LOWER_GAP], point.rate[MESH_CLAMP] = upper_rate, lower_rate, clamp_rate
    earlier_gaps = min(upper - before * upper_rate, lower - before * lower_rate)
    least = min(min(upper, lower), min(clamp, clamp - before * clamp_rate))
    return bool((least < 0.0) | (earlier_gaps < 0.0))


@hot
def push_rate(constants: Record, state: Record, point: Record, teeth: Mesh, rates: Rates) -> float:
    """Rate of the unclamped mesh force in contact.

    Up to products of the centres' speeds, which are some 1e-5 of it.
    """
    excitation = point.excitation
    phi_rate = phase_rate(constants, state, point.omega[0])
    phi_acceleration = constants.teeth1 * rates.alpha[0]
    if constants.nominal_phase:
        phi_acceleration = 0.0
    phi_rate2 = phi_rate * phi_rate
    z = phi_rate2 * excitation[SURFACE_CURVATURE] + phi_acceleration * excitation[SURFACE_SLOPE]
    e = phi_rate2 * excitation[ERROR_CURVATURE] + phi_acceleration * excitation[ERROR_SLOPE]
    ax, ay = rates.ax[1] - rates.ax[0], rates.ay[1] - rates.ay[0]
    acceleration = u_rate(constants, rates.alpha) - teeth.lean_x * ax - teeth.lean_y * ay
    acceleration += 0.5 * state.flank * z - e
    return float(
        teeth.stiffness_rate * teeth.approach
        + teeth.stiffness * teeth.approach_rate
        + constants.damping * acceleration
    )


@hot
def moved(constants: Record, start: Motion, h: float, drift: Motion, rates: Rates) -> Motion:
    """``start`` after ``h`` s at the speeds of ``drift`` and the accelerations of ``rates``."""
    return Motion(
        start.x + h * drift.vx,
        start.y + h * drift.vy,
        start.u + h * u_rate(constants, drift.omega),
        start.vx + h * rates.ax,
        start.vy + h * rates.ay,
        start.omega + h * rates.alpha,
    )


@hot
def u_rate(constants: Record, omega: Pair) -> float:
    """Rate of u, or of its rate, from those of the shaft angles."""
    value: float = constants.base_radius[0] * omega[0] - constants.base_radius[1] * omega[1]
    return value


@hot
def rates_at(point: Record) -> Rates:
    """Rates as ``evaluate`` left them."""
    return Rates(
        load2(point.ax, 0),
        load2(point.ay, 0),
        load2(point.alpha, 0),
        point.mesh_force,
        point.shaft_power,
        point.excitation_power,
        point.mesh_loss_rate,
        load2(point.contact_loss_rate, 0),
        load2(point.film_power, 0),
    )


@hot
def summed(h: float, first: Any, second: Any, third: Any, fourth: Any) -> Any:
    """Integral over a step of what the four stages of RK4 gave."""
    return h / 6.0 * (first + fourth) + h / 3.0 * (second + third)


@compiled
def try_step(
    constants: Record, state: Record, here: Record, end: Record, h: float, reference_speed: float
) -> bool:
    """Classic RK4 over ``h`` from ``here`` to ``end`` with frozen flags, in Nystrom's form.

    Returns whether a surface may have been crossed: the cubic through its values and rates stays positive
    where its values and those a third of the step along the tangents are.

    ``end`` brings its excitations and those of the middle, for a phase that moves at ``reference_speed``; the
    stages lie close to these phases and take the difference by Taylor's series.
    """
    half, third, sixth = 0.5 * h, h / 3.0, h / 6.0
    lagging = 0.0 if constants.nominal_phase else constants.teeth1
    start, first = motion_at(here), rates_at(here)

    motion2 = moved(constants, start, half, start, first)
    lag = lagging * half * (start.omega[0] - reference_speed)
    second, _, _, _, _ = dynamics(constants, state, motion2, end.middle, lag)

    motion3 = moved(constants, start, half, motion2, second)
    lag = lagging * half * (motion2.omega[0] - reference_speed)
    third_rates, teeth, _, _, _ = dynamics(constants, state, motion3, end.middle, lag)

    motion4 = moved(constants, start, h, motion3, third_rates)
    lag = lagging * h * (motion3.omega[0] - reference_speed)
    fourth, _, _, _, _ = dynamics(constants, state, motion4, end.excitation, lag)

    # Positions need k1 + k2 + k3 of the accelerations, speeds k1 + 2 k2 + 2 k3 + k4.
    ax, ay, alpha = second.ax + third_rates.ax, second.ay + third_rates.ay, second.alpha + third_rates.alpha
    turned = start.omega + sixth * (first.alpha + alpha)
    store(end.x, 0, start.x + h * (start.vx + sixth * (first.ax + ax)))
    store(end.y, 0, start.y + h * (start.vy + sixth * (first.ay + ay)))
    end.u = start.u + h * u_rate(constants, turned)
    end.theta1 = here.theta1 + h * turned[0]
    store(end.vx, 0, start.vx + (sixth * (first.ax + fourth.ax) + third * ax))
    store(end.vy, 0, start.vy + (sixth * (first.ay + fourth.ay) + third * ay))
    store(end.omega, 0, start.omega + (sixth * (first.alpha + fourth.alpha) + third * alpha))
    end.mesh_impulse = here.mesh_impulse + summed(
        h, first.force, second.force, third_rates.force, fourth.force
    )
    end.shaft_work = here.shaft_work + summed(
        h, first.shaft_power, second.shaft_power, third_rates.shaft_power, fourth.shaft_power
    )
    end.excitation_work = here.excitation_work + summed(
        h,
        first.excitation_power,
        second.excitation_power,
        third_rates.excitation_power,
        fourth.excitation_power,
    )
    end.mesh_loss = here.mesh_loss + summed(
        h, first.mesh_loss_rate, second.mesh_loss_rate, third_rates.mesh_loss_rate, fourth.mesh_loss_rate
    )
    contact_loss = summed(
        h,
        first.contact_loss_rate,
        second.contact_loss_rate,
        third_rates.contact_loss_rate,
        fourth.contact_loss_rate,
    )
    store(end.contact_loss, 0, load2(here.contact_loss, 0) + contact_loss)
    film_work = summed(h, first.film_power, second.film_power, third_rates.film_power, fourth.film_power)
    store(end.film_work, 0, load2(here.film_work, 0) + film_work)
    end.time = here.time + h
    end.lag = lagging * h * (turned[0] - reference_speed)
    if state.flank != 0.0:
        end.lag += lagging * add_surface_impulse(constants, state, here, end, h, end.lag, teeth)
    end.turn = TURNS_PER_RADIAN * end.theta1
    if constants.nominal_phase:
        end.turn = here.turn + TURNS_PER_RADIAN * h * state.speed
    leaving = load8(here.value, 0) + third * load8(here.rate, 0)
    last = EVENT_COUNT - 1
    eventful = any_negative(leaving) | (here.value[last] + third * here.rate[last] < 0.0)
    return bool(evaluate(constants, state, end, third) | eventful)


@hot
def surface_at(excitation: Floats, lag: float, phi_rate: float) -> tuple[float, float]:
    """Height z1 + z2 and its rate, ``lag`` rad of mesh phase ahead of ``excitation``."""
    slope = excitation[SURFACE_SLOPE] + 0.5 * lag * excitation[SURFACE_CURVATURE]
    rate = phi_rate * (excitation[SURFACE_SLOPE] + lag * excitation[SURFACE_CURVATURE])
    return excitation[SURFACE] + lag * slope, rate


@hot
def add_surface_impulse(
    constants: Record, state: Record, here: Record, end: Record, h: float, lag: float, middle: Mesh
) -> float:
    """Make up for what RK4 misses of the surfaces' share of the mesh force, f/2 (k1 z + c1 dz/dt).

    The shortest waves turn by a radian in a step; RK4 sums them by Simpson's rule, and the impacts magnify
    its error a hundredfold. Here the integral of dz/dt is the difference of z, that of z is taken to sixth
    order from values and rates, and the speed that dz/dt gives enters the damping. All of it follows the
    cubic through the phase's ends, so that what is added vanishes with the fifth power of ``h``. ``end`` is
    ``lag`` rad of mesh phase ahead of its excitations. Returns how far gear 1 turns by it, in rad.
    """
    rate0, rate1 = constants.teeth1 * here.omega[0], constants.teeth1 * end.omega[0]
    turned = constants.teeth1 * (end.theta1 - here.theta1)
    rate_middle = 1.5 * turned / h - 0.25 * (rate0 + rate1)
    lag_middle = 0.5 * lag + 0.125 * h * (rate0 - rate1)
    if constants.nominal_phase:
        rate1 = rate_middle = constants.teeth1 * state.speed
        lag_middle = 0.0
    z0, s0 = here.surface, here.surface_rate
    zm, sm = surface_at(end.middle, lag_middle, rate_middle)
    z1, s1 = surface_at(end.excitation, lag, rate1)
    integral = h * (7.0 * (z0 + z1) + 16.0 * zm) / 30.0 + h * h * (s0 - s1) / 60.0
    damping, grip = 0.0, 0.5 * state.flank
    if constants.contact_damping:
        damping = constants.damping
        grip *= 1.0 - state.mesh_clamped
    taken = h / 6.0 * (4.0 * (zm - z0) + (z1 - z0) - h * (s0 + 2.0 * sm))
    impulse = grip * (
        damping * ((z1 - z0) - h / 6.0 * (s0 + 4.0 * sm + s1))
        + middle.stiffness * (integral - h / 6.0 * (z0 + 4.0 * zm + z1))
        - damping * damping * constants.per_mesh_mass * taken
    )
    shift = grip * damping * (integral - h * z0 - h * h / 6.0 * (s0 + 2.0 * sm))
    per_mass = load2(constants.per_mass, 0)
    per_inertia = load2(constants.base_radius, 0) * load2(constants.per_inertia, 0)
    push, move = both(-impulse, impulse) * per_mass, both(-shift, shift) * per_mass
    turn = both(-shift, shift) * per_inertia
    store(end.vx, 0, load2(end.vx, 0) + push * middle.along_x)
    store(end.vy, 0, load2(end.vy, 0) + push * middle.along_y)
    store(end.omega, 0, load2(end.omega, 0) + both(-impulse, impulse) * per_inertia)
    store(end.x, 0, load2(end.x, 0) + move * middle.along_x)
    store(end.y, 0, load2(end.y, 0) + move * middle.along_y)
    end.u += u_rate(constants, turn)
    end.theta1 += turn[0]
    end.mesh_impulse += impulse
    return float(turn[0])


@compiled
def try_apart(
    constants: Record,
    state: Record,
    here: Record,
    end: Record,
    waves: Pointer,
    amplitudes: Pointer,
    h: float,
) -> None:
    """``try_step`` off the grid of whole steps: the excitations are evaluated where it leads."""
    speed = state.speed if constants.nominal_phase else here.omega[0]
    quarter = 0.5 * h * speed * TURNS_PER_RADIAN
    excite(constants, state, waves, amplitudes, here.turn + quarter, pointer(end.middle))
    excite(constants, state, waves, amplitudes, here.turn + 2.0 * quarter, pointer(end.excitation))
    try_step(constants, state, here, end, h, speed)


@compiled
def excite(
    constants: Record,
    state: Record,
    waves: Pointer,
    amplitudes: Pointer,
    turn: float,
    excitation: Pointer,
) -> None:
    """Sum of all periodic excitations where gear 1 has turned by ``turn`` beyond the whole turns."""
    set_waves(constants, waves, cycle_fraction(constants, state, turn), OTHER_COSINE, OTHER_SINE)
    store(excitation, 0, sum_waves(constants, waves, amplitudes, OTHER_COSINE, OTHER_SINE))


@hot
def cycle_fraction(constants: Record, state: Record, turn: float) -> float:
    """Fraction of the hunting cycle at ``turn`` turns beyond the whole ones."""
    fraction: float = (state.turn + turn) / constants.hunting
    return fraction


@compiled
def hermite_root(v0: float, r0: float, v1: float, r1: float) -> float:
    """Root in (0, 1) of the cubic with values v0 > 0 > v1 and slopes r0, r1 per unit of the bracket."""
    low, high = 0.0, 1.0
    s = v0 / (v0 - v1)
    c2 = 3.0 * (v1 - v0) - 2.0 * r0 - r1
    c3 = 2.0 * (v0 - v1) + r0 + r1
    for _ in range(12):
        value = v0 + s * (r0 + s * (c2 + s * c3))
        if value > 0.0:
            low = s
        else:
            high = s
        slope = r0 + s * (2.0 * c2 + 3.0 * s * c3)
        following = s - value / slope if slope != 0.0 else low
        if not (low < following < high):
            following = 0.5 * (low + high)
        if abs(following - s) < 1e-14:
            return following
        s = following
    return s


@compiled
def event_tolerance(event: int) -> float:
    """How close to zero ``event`` is located, relative to the change of its value."""
    return CLAMP_TOLERANCE if MESH_CLAMP <= event < FILM_LIMIT else GAP_TOLERANCE


@compiled
def first_violated(here: Record, end: Record, h: float) -> int:
    """The event that seems to come first of those whose value is negative at the end, or -1."""
    first, earliest = -1, 2.0
    for event in range(EVENT_COUNT):
        v1 = end.value[event]
        if v1 < 0.0:
            v0 = here.value[event]
            at = 0.0
            if v0 > 0.0:
                at = hermite_root(v0, h * here.rate[event], v1, h * end.rate[event])
            if at < earliest:
                first, earliest = event, at
    return first


@compiled
def grazing_fraction(here: Record, end: Record, h: float) -> float:
    """Fraction of the step at which a surface seems to be crossed and crossed back, or 0.

    Looks at values that are positive at both ends but fall at the start and rise at the end.
    """
    for event in range(EVENT_COUNT):
        v0, r0 = here.value[event], h * here.rate[event]
        if v0 > 0.0 and r0 < 0.0:
            v1, r1 = end.value[event], h * end.rate[event]
            if r1 > 0.0:
                c2 = 3.0 * (v1 - v0) - 2.0 * r0 - r1
                c3 = 2.0 * (v0 - v1) + r0 + r1
                low, high = 0.0, 1.0
                for _ in range(40):
                    middle = 0.5 * (low + high)
                    if r0 + middle * (2.0 * c2 + 3.0 * middle * c3) < 0.0:
                        low = middle
                    else:
                        high = middle
                if v0 + low * (r0 + low * (c2 + low * c3)) < 0.0:
                    return low
    return 0.0


@compiled
def flip(constants: Record, event: int, state: Record, here: Record, impacts: Pointer) -> None:
    """Change the flag that ``event`` stands for."""
    if event <= LOWER_GAP:
        side = 1.0 if event == UPPER_GAP else -1.0
        state.flank = side if state.flank == 0.0 else 0.0
        state.mesh_clamped = 0.0
        state.flank_changes += 1
    elif event == MESH_CLAMP:
        state.mesh_clamped = 1.0 - state.mesh_clamped
    elif event < MESH_CLAMP:
        gear = event - BEARING_GAP
        state.clamped[gear] = 0.0
        if state.contact[gear] == 0.0:
            begin_contact(constants, gear, state, here)
        else:
            end_contact(gear, state, here, impacts)
    elif event < FILM_LIMIT:
        state.clamped[event - BEARING_CLAMP] = 1.0 - state.clamped[event - BEARING_CLAMP]
    else:
        state.starved[event - FILM_LIMIT] = 1.0 - state.starved[event - FILM_LIMIT]
    state.events += 1


@compiled
def begin_contact(constants: Record, gear: int, state: Record, here: Record) -> None:
    """A bearing contact begins and latches its speed."""
    state.contact[gear] = 1.0
    state.impact_speed[gear] = max(here.closing[gear], constants.minimum_impact_speed)
    state.approach[gear] = here.closing[gear]
    state.impact_time[gear] = here.time
    state.contact_age[gear] = 0.0
    state.peak_force2[gear] = 0.0
    state.impacts += 1


@compiled
def end_contact(gear: int, state: Record, here: Record, impacts: Pointer) -> None:
    """A bearing contact ends and enters the list, a row of IMPACTS."""
    state.contact[gear] = 0.0
    at = IMPACT_SIZE * state.listed
    impacts[at + 0] = state.impact_time[gear]
    impacts[at + 1] = here.time
    impacts[at + 2] = gear
    impacts[at + 3] = state.approach[gear]
    impacts[at + 4] = -here.closing[gear]
    impacts[at + 5] = math.sqrt(state.peak_force2[gear])
    state.listed += 1


@compiled
def settled_with(event: int) -> int:
    """Bits of the events that one stop decides together with ``event``: itself, and of a gap its clamp.

    Where a contact begins or ends without damping, gap and clamp are the same surface, and rounding alone
    would say on which side of the clamp the state lies.
    """
    bits = 1 << event
    if event <= LOWER_GAP:
        bits |= 1 << MESH_CLAMP
    elif event < MESH_CLAMP:
        bits |= 1 << (event - BEARING_GAP + BEARING_CLAMP)
    return bits


@compiled
def settle(constants: Record, event: int, state: Record, here: Record, impacts: Pointer) -> None:
    """Flip ``event`` and, as events fall together, every other one that is past its surface."""
    flip(constants, event, state, here, impacts)
    flipped = settled_with(event)
    for _ in range(EVENT_COUNT):
        reevaluate(constants, state, here)
        following = -1
        for other in range(EVENT_COUNT):
            value, change = here.value[other], here.rate[other]
            # What an earlier stop of this step flipped may still be short of its surface, on its way there.
            if value <= 0.0 and change < 0.0 and not (flipped >> other) & 1:
                following = other
                break
        if following < 0:
            return
        flip(constants, following, state, here, impacts)
        flipped |= settled_with(following)


@compiled
def reevaluate(constants: Record, state: Record, here: Record) -> None:
    """``evaluate``, kept apart so that a rare call does not swell its caller."""
    evaluate(constants, state, here, 0.0)


@compiled
def locate(
    constants: Record,
    state: Record,
    here: Record,
    end: Record,
    low_end: Record,
    waves: Pointer,
    amplitudes: Pointer,
    h: float,
    event: int,
) -> tuple[float, int, int]:
    """Shorten the trial step ``h`` from ``here`` to ``end`` to the first event in it.

    That is ``event``, positive at ``here`` and negative at ``end``, or one before it. Each trial is a step of
    its own, at the root of a cubic through values and rates of the bracket; the late ones bisect. Returns
    (shortened step, event, 1 if the search met its limit of trials).
    """
    copy(here, low_end)
    low, high = 0.0, h
    v_high, r_high = end.value[event], end.rate[event]
    tolerance = event_tolerance(event) * (low_end.value[event] - v_high)
    at = h
    for trial in range(SEARCH_LIMIT):
        width = high - low
        v_low, r_low = low_end.value[event], low_end.rate[event]
        fraction = hermite_root(v_low, width * r_low, v_high, width * r_high)
        at = low + fraction * width
        if not (low < at < high) or trial >= SEARCH_LIMIT // 2:
            at = 0.5 * (low + high)
        try_apart(constants, state, here, end, waves, amplitudes, at)
        earlier = -1
        for other in range(EVENT_COUNT):
            v0, v1 = low_end.value[other], end.value[other]
            if other != event and v0 > 0.0 and v1 < -event_tolerance(other) * (v0 - v1):
                earlier = other
        if earlier >= 0:
            event, high = earlier, at
            v_high, r_high = end.value[event], end.rate[event]
            tolerance = event_tolerance(event) * (low_end.value[event] - v_high)
            continue
        value = end.value[event]
        if abs(value) <= tolerance or width <= 1e-12 * h:
            return at, event, 0
        if value < 0.0:
            high, v_high, r_high = at, value, end.rate[event]
        else:
            low = at
            copy(end, low_end)
    return at, event, 1


@compiled
def split_step(
    constants: Record,
    state: Record,
    here: Record,
    end: Record,
    low_end: Record,
    waves: Pointer,
    amplitudes: Pointer,
    impacts: Pointer,
    longest: float,
) -> None:
    """One step in substeps of at most ``longest``, split at every event; it ends in ``here``.

    Starts from a first trial of ``longest``, at ``end``. Searches that met their limit are counted as capped.
    """
    step = constants.step
    done, h, stops = 0.0, longest, 0
    tried = True
    while True:
        if not tried:
            try_apart(constants, state, here, end, waves, amplitudes, h)
        tried = False
        event = -1
        if stops < STOPS_PER_STEP:
            event = first_violated(here, end, h)
            if event < 0:
                fraction = grazing_fraction(here, end, h)
                if fraction > SHORTEST_SUBSTEP:
                    h *= fraction
                    stops += 1
                    continue
            elif here.value[event] > 0.0:
                h, event, capped = locate(constants, state, here, end, low_end, waves, amplitudes, h, event)
                state.capped += capped
                stops += 1
            elif h > SHORTEST_SUBSTEP * step:
                # Just flipped, yet past its surface at the end: look for a point before that.
                h *= 0.5
                continue
            else:
                state.capped += 1
                stops += 1
            if stops == STOPS_PER_STEP:
                state.capped += 1
        copy(end, here)
        note_contacts(state, here, h)
        done += h
        if event >= 0:
            settle(constants, event, state, here, impacts)
        h = step - done
        if h <= SHORTEST_SUBSTEP * step:
            break
        h = min(h, longest, longest_near_gap(constants, state, here, h))
    if stops >= STOPS_PER_STEP:
        late = -1
        for event in range(EVENT_COUNT):
            if here.value[event] < 0.0:
                late = event
        if late >= 0:
            settle(constants, late, state, here, impacts)


@compiled
def longest_substep(constants: Record, state: Record, here: Record) -> float:
    """The step, halved until it bears the damping of the bearing contacts at ``here``.

    A contact that began slowly has a damping coefficient, a k_h delta^1.5 / v_impact, without a bound:
    pressed in later it would overshoot its own resting point.
    """
    rate = max(here.damping[0] * constants.per_mass[0], here.damping[1] * constants.per_mass[1])
    step: float = longest_near_gap(constants, state, here, constants.step)
    substeps = 1.0
    while step * rate > STIFFNESS_LIMIT * substeps:
        substeps *= 2.0
        if substeps == SUBSTEPS_LIMIT:
            state.capped += 1
            break
    return step / substeps


@compiled
def longest_near_gap(constants: Record, state: Record, here: Record, h: float) -> float:
    """``h``, or less where a bearing contact begins or ends, where delta^1.5 is not smooth.

    No substep is longer than the age of a contact, nor than half the time it seems to have left.
    """
    longest = h
    if constants.kelvin:
        return longest
    shortest = GAP_FRACTION * constants.step
    for gear in range(2):
        if state.contact[gear] == 1.0:
            longest = min(longest, max(state.contact_age[gear], shortest))
            opening = -here.closing[gear]
            if 2.0 * longest * opening > here.penetration[gear]:
                longest = max(0.5 * here.penetration[gear] / opening, min(longest, shortest))
    return longest


@hot
def note_contacts(state: Record, here: Record, h: float) -> None:
    """Keep age and greatest force of both bearings' contacts after a step of ``h`` to ``here``."""
    force_x, force_y = load2(here.contact_x, 0), load2(here.contact_y, 0)
    store(state.peak_force2, 0, at_least(force_x * force_x + force_y * force_y, load2(state.peak_force2, 0)))
    store(state.contact_age, 0, load2(state.contact_age, 0) + h)


@hot
def wrap(constants: Record, state: Record, here: Record) -> None:
    """Bring theta1 back to one revolution and count it; the phase counts modulo the hunting cycle."""
    revolutions = 0
    if here.theta1 >= TWO_PI:
        here.theta1 -= TWO_PI
        revolutions = 1
    elif here.theta1 < 0.0:
        here.theta1 += TWO_PI
        revolutions = -1
    if revolutions != 0:
        state.revolutions += revolutions
        if not constants.nominal_phase:
            state.turn = (state.turn + revolutions) % constants.hunting
            here.turn = TURNS_PER_RADIAN * here.theta1


@njit(cache=True, error_model="numpy")
def advance_nominal(constants: Record, state: Record, here: Record) -> None:
    """One step of the nominal phase, without the drift of a plain sum (Kahan); must not be contracted."""
    increment = state.speed * constants.step * TURNS_PER_RADIAN - state.nominal_rest
    before = state.nominal_turn
    turn = before + increment
    state.nominal_rest = (turn - before) - increment
    if turn >= 1.0:
        turn -= 1.0
        state.turn = (state.turn + 1) % constants.hunting
    elif turn < 0.0:
        turn += 1.0
        state.turn = (state.turn - 1) % constants.hunting
    state.nominal_turn = turn
    here.turn = turn


@compiled
def govern(constants: Record, state: Record, here: Record, interval: float) -> None:
    """PI governor, once a sample: T_M = clip(Kp err + I); I stands still while clipped."""
    error = state.speed - here.omega[0]
    wanted = constants.governor_proportional * error + state.governor
    limit = constants.governor_limit
    state.drive_torque = min(max(wanted, -limit), limit)
    if -limit <= wanted <= limit:
        state.governor += constants.governor_integral * error * interval


@compiled
def write_sample(
    constants: Record, state: Record, here: Record, row: int, samples: Floats, angles: Floats
) -> None:
    """One row of CHANNELS and the accumulated angles of both shafts."""
    samples[row, 0] = here.time
    samples[row, 1] = here.q
    samples[row, 2] = here.q_rate
    samples[row, 3] = here.mesh_force
    samples[row, 4] = math.atan2(here.sin_alpha, here.cos_alpha)
    samples[row, 5] = math.atan2(here.y[1] - here.y[0], constants.centre_distance + here.x[1] - here.x[0])
    samples[row, 6] = here.half_backlash
    samples[row, 7] = state.flank
    for gear in range(2):
        samples[row, 8 + 2 * gear] = here.x[gear]
        samples[row, 9 + 2 * gear] = here.y[gear]
        samples[row, 12 + 2 * gear] = here.contact_x[gear]
        samples[row, 13 + 2 * gear] = here.contact_y[gear]
        samples[row, 16 + 2 * gear] = here.film_x[gear]
        samples[row, 17 + 2 * gear] = here.film_y[gear]
        samples[row, 20 + gear] = here.penetration[gear]
        samples[row, 22 + gear] = here.omega[gear]
    samples[row, 24] = state.drive_torque
    samples[row, 25] = here.load
    samples[row, 26] = here.theta1
    mesh_turn = constants.teeth1 * here.turn
    samples[row, 27] = TWO_PI * (mesh_turn - math.floor(mesh_turn))
    angles[row, 0] = TWO_PI * state.revolutions + here.theta1
    angles[row, 1] = (constants.base_radius[0] * angles[row, 0] - here.u) / constants.base_radius[1]


@compiled
def elastic_energy(constants: Record, state: Record, here: Record, gear: int) -> float:
    """Energy in the spring of one bearing's contact, N m: the integral of its elastic force."""
    depth = here.penetration[gear]
    if state.contact[gear] == 0.0 or depth <= 0.0:
        return 0.0
    if constants.kelvin:
        energy: float = 0.5 * constants.kelvin_stiffness[gear] * depth * depth
        return energy
    clearance = constants.clearance[gear]
    x = depth / clearance
    factor = constants.hertz[gear] * clearance * clearance
    if x < 0.05:
        # Binomial series: the closed form below loses digits here.
        term, total = 1.0, 0.0
        for k in range(16):
            total += term / (k + 2.5)
            term *= -x * (k + 0.5) / (k + 1.0)
        energy = factor * x * x * math.sqrt(x) * total
        return energy
    root = math.sqrt(x)
    energy = factor * (0.25 * (2.0 * x - 3.0) * root * math.sqrt(1.0 + x) + 0.75 * math.asinh(root))
    return energy


@compiled
def stored_energy(constants: Record, state: Record, here: Record) -> float:
    """Energy in the springs of teeth and bearing contacts, N m."""
    total: float = here.mesh_energy
    for gear in range(2):
        total += elastic_energy(constants, state, here, gear)
    return total


@compiled
def write_energies(
    constants: Record, state: Record, here: Record, rows: Floats, row: int, first: int
) -> None:
    """ENERGIES into ``row``, from column ``first`` on."""
    kinetic = 0.0
    for gear in range(2):
        kinetic += 0.5 * (here.vx[gear] ** 2 + here.vy[gear] ** 2) / constants.per_mass[gear]
        kinetic += 0.5 * here.omega[gear] ** 2 / constants.per_inertia[gear]
        rows[row, first + 3 + gear] = here.contact_loss[gear]
        rows[row, first + 5 + gear] = here.film_work[gear]
    rows[row, first] = here.shaft_work
    rows[row, first + 1] = here.excitation_work
    rows[row, first + 2] = here.mesh_loss
    rows[row, first + 7] = kinetic
    rows[row, first + 8] = stored_energy(constants, state, here)


@compiled
def refresh(constants: Record, state: Record, here: Record, waves: Pointer, speed: float) -> None:
    """Waves on the grid afresh at ``here``, and their turn over half a step at ``speed``."""
    set_waves(constants, waves, cycle_fraction(constants, state, here.turn), COSINE, SINE)
    quarter = 0.5 * constants.step * speed * TURNS_PER_RADIAN / constants.hunting
    set_waves(constants, waves, quarter, TURN_COSINE, TURN_SINE)


@hot
def step_on(
    constants: Record,
    state: Record,
    here: Record,
    end: Record,
    low_end: Record,
    waves: Pointer,
    amplitudes: Pointer,
    impacts: Pointer,
    reference_speed: float,
) -> bool:
    """One step; returns whether it ended at ``here`` after a detour, not at ``end``."""
    step = constants.step
    longest = longest_substep(constants, state, here)
    turn_waves(constants, waves)
    store(end.middle, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    turn_waves(constants, waves)
    store(end.excitation, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    if longest == step:
        if not try_step(constants, state, here, end, step, reference_speed):
            note_contacts(state, end, step)
            close_step(constants, state, end, waves, TURNS_PER_RADIAN * end.lag / constants.teeth1)
            return False
    else:
        try_apart(constants, state, here, end, waves, amplitudes, longest)
    grid_turn = here.turn + step * reference_speed * TURNS_PER_RADIAN
    split_step(constants, state, here, end, low_end, waves, amplitudes, impacts, longest)
    close_step(constants, state, here, waves, here.turn - grid_turn)
    return True


@hot
def close_step(constants: Record, state: Record, now: Record, waves: Pointer, off_grid: float) -> None:
    """What is due once a step; the state is ``off_grid`` turns ahead of the waves on the grid."""
    wrap(constants, state, now)
    if constants.nominal_phase:
        advance_nominal(constants, state, now)
    else:
        nudge_waves(constants, waves, off_grid / constants.hunting)
    state.steps += 1
    if now.half_backlash <= 0.0:
        state.pressed = 1


@compiled
def open_point(constants: Record, state: Record, here: Record, waves: Pointer, amplitudes: Pointer) -> None:
    """Evaluate ``here`` afresh at the motion it holds, with the waves on the grid there."""
    here.turn = TURNS_PER_RADIAN * here.theta1
    speed = here.omega[0]
    if constants.nominal_phase:
        here.turn = state.nominal_turn
        speed = state.speed
    here.lag = 0.0
    refresh(constants, state, here, waves, speed)
    store(here.excitation, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    evaluate(constants, state, here, 0.0)


@compiled
def copy_motion(source: Record, target: Record) -> None:
    """Integrated values from a state to a point or back."""
    for gear in range(2):
        target.x[gear], target.y[gear] = source.x[gear], source.y[gear]
        target.vx[gear], target.vy[gear] = source.vx[gear], source.vy[gear]
        target.omega[gear] = source.omega[gear]
        target.contact_loss[gear], target.film_work[gear] = source.contact_loss[gear], source.film_work[gear]
    target.u, target.theta1 = source.u, source.theta1
    target.mesh_impulse, target.shaft_work = source.mesh_impulse, source.shaft_work
    target.excitation_work, target.mesh_loss = source.excitation_work, source.mesh_loss


@compiled
def touch(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> None:
    """Set u so that the drive flank just touches (q = b1), in contact if the gap is closing."""
    state[0].flank = 0.0
    state[0].u = 0.0
    look(constants, state, points, waves, amplitudes)
    here = points[HERE]
    state[0].u = here.half_backlash - here.q
    if here.rate[UPPER_GAP] < 0.0:
        state[0].flank = 1.0


@compiled
def look(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> None:
    """Evaluate the state, flags frozen, into the point HERE."""
    here = points[HERE]
    copy_motion(state[0], here)
    open_point(constants[0], state[0], here, pointer(waves), pointer(amplitudes))


@compiled
def look_before(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> float:
    """``look`` at what is about to change under the same motion; returns the stored energy, N m."""
    look(constants, state, points, waves, amplitudes)
    return float(stored_energy(constants[0], state[0], points[HERE]))


@compiled
def adapt(
    constants: NDArray[Any],
    state: NDArray[Any],
    points: NDArray[Any],
    waves: Floats,
    amplitudes: Floats,
    impact_rows: Floats,
    stored_before: float,
) -> None:
    """Bring the flags into line with a change of constants or excitations, after ``look_before``.

    What the change brought past its surface is flipped and counted; the gaps of the bearings it can't move.
    What the springs gain by it, the excitations have put in.
    """
    here, before = points[HERE], points[LOW]
    copy(here, before)
    look(constants, state, points, waves, amplitudes)
    flipped = 0
    for _ in range(EVENT_COUNT):
        following = -1
        for event in range(EVENT_COUNT):
            value = here.value[event]
            # One that rounding left short of its surface, on its way there, is not the change's doing.
            if value < 0.0 and value < before.value[event] and not (flipped >> event) & 1:
                following = event
                break
        if following < 0:
            break
        flip(constants[0], following, state[0], here, pointer(impact_rows))
        flipped |= 1 << following
        reevaluate(constants[0], state[0], here)
    state[0].excitation_work += stored_energy(constants[0], state[0], here) - stored_before


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def run(
    all_constants: NDArray[Any],
    all_state: NDArray[Any],
    points: NDArray[Any],
    wave_rows: Floats,
    amplitude_rows: Floats,
    first_sample: int,
    interval_ns: int,
    samples: Floats,
    angles: Floats,
    energies: Floats,
    impact_rows: Floats,
) -> tuple[int, int]:
    """Integrate and sample: row k of ``samples`` (n, 28) and ``angles`` (n, 2) is the state before its steps.

    ``samples`` of 37 columns take ENERGIES too; ``energies`` (1, 9) takes them at the end. ``impact_rows``
    take the bearing contacts that end, ``state.listed`` of them; the run halts early where they might not
    suffice for another sample with IMPACTS_PER_STEP. Changes the state in place;
    returns (rows written, status). On OVER_SPEED and CENTRES_PRESSED the last row is the state that broke the
    limit; a NON_FINITE state is not written.
    """
    # A lone record is slow to hand over from Python, and numba counts references to arrays at every call.
    constants, state = all_constants[0], all_state[0]
    here, end, low_end = points[HERE], points[END], points[LOW]
    waves, amplitudes, impacts = pointer(wave_rows), pointer(amplitude_rows), pointer(impact_rows)
    n = samples.shape[0]
    limit, step = constants.speed_limit, constants.step
    interval = step * constants.steps_per_sample
    most_impacts = IMPACTS_PER_STEP * constants.steps_per_sample
    written, status = n, RUNNING
    copy_motion(state, here)
    state.listed = 0
    for row in range(n):
        if state.listed + most_impacts > impact_rows.shape[0]:
            written = row
            break
        if constants.governed:
            govern(constants, state, here, interval)
        time = (first_sample + row) * interval_ns / 1e9
        here.time = time
        open_point(constants, state, here, waves, amplitudes)
        speed = state.speed if constants.nominal_phase else here.omega[0]
        if not is_finite(here):
            written, status = row, NON_FINITE
            break
        write_sample(constants, state, here, row, samples, angles)
        if samples.shape[1] > CHANNEL_COUNT:
            write_energies(constants, state, here, samples, row, CHANNEL_COUNT)
        if abs(here.omega[0]) > limit or abs(here.omega[1]) > limit:
            written, status = row + 1, OVER_SPEED
            break
        if here.half_backlash <= 0.0 or state.pressed == 1:
            written, status = row + 1, CENTRES_PRESSED
            break
        for k in range(constants.steps_per_sample):
            here.time = time + k * step
            if k > 0 and k % REFRESH_STEPS == 0:
                speed = state.speed if constants.nominal_phase else here.omega[0]
                refresh(constants, state, here, waves, speed)
            detour = step_on(constants, state, here, end, low_end, waves, amplitudes, impacts, speed)
            if not detour:
                here, end = end, here
    write_energies(constants, state, here, energies, 0, 0)
    copy_motion(here, state)
    return written, status


@compiled
def is_finite(here: Record) -> bool:
    """Whether motion and accelerations are finite."""
    total = here.u + here.theta1
    for gear in range(2):
        total += here.x[gear] + here.y[gear] + here.vx[gear] + here.vy[gear] + here.omega[gear]
        total += here.ax[gear] + here.ay[gear] + here.alpha[gear]
    return math.isfinite(total)
