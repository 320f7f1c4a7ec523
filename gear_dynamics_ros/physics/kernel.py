"""Every compiled function of the model and of its integrator.

One file on purpose: numba's cache looks at the file of the outermost function only. Symbols and equation
numbers are the paper's; all values are SI. A hot function returns a status, never raises.

Arrays passed around, the first three with a row each for HERE, END, ... of a step:
``states`` (integrated and latched values), ``points`` (everything evaluated at one state), ``excs`` (periodic
excitations at one phase); ``flags`` the discrete state; ``waves`` and ``amplitudes`` the excitation table.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.int64]
Rates = tuple[float, float, float, float, float, float]
Mesh = tuple[float, float, float, float, float]
Bearing = tuple[float, float, float, float, float, float, float, float, float, float, float, float]

TWO_PI = 2.0 * math.pi
TURNS_PER_RADIAN = 1.0 / TWO_PI

# State. The first twelve are integrated; the rest changes at samples or at events.
X1, Y1, X2, Y2, U, THETA1, VX1, VY1, VX2, VY2, OMEGA1, OMEGA2 = range(12)
MECHANICAL = 12
MESH_IMPULSE = 12  # N s, integral of F_p
IMPACT_SPEED = 13  # and 14: latched impact speed of each bearing, m/s
NOMINAL_TURN = 15  # nominal angle of gear 1 in turns, 0 to 1
NOMINAL_REST = 16  # what rounding took from it
GOVERNOR = 17  # integral part of the governor's torque, N m
DRIVE_TORQUE = 18  # torque applied, held over a sample interval, N m
STATE_SIZE = 19

# Discrete state.
FLANK = 0  # 1 drive flank, 0 apart, -1 back flank
MESH_CLAMPED = 1  # the mesh would pull: force held at zero
CONTACT = 2  # and 3: bearing in contact
CLAMPED = 4  # and 5: bearing would pull
STARVED = 6  # and 7: eccentricity beyond the film's limit
TURN = 8  # whole turns of the phase modulo the hunting cycle
REVOLUTIONS = 9  # whole revolutions of gear 1 since the start
STEPS, EVENTS, CAPPED, IMPACTS, FLANK_CHANGES = range(10, 15)
PRESSED = 15  # the backlash was used up at the end of a step
FLAGS_SIZE = 16

# Events: a surface's value is positive on the side its flag stands for.
UPPER_GAP = 0
LOWER_GAP = 1
MESH_CLAMP = 2
BEARING_GAP = 3  # and 4
BEARING_CLAMP = 5  # and 6
FILM_LIMIT = 7  # and 8
EVENT_COUNT = 9

# Point: accelerations, event values and rates, and what a sample shows.
AX1, AY1, AX2, AY2, ALPHA1, ALPHA2 = range(6)
VALUE = 6
RATE = VALUE + EVENT_COUNT
Q, Q_RATE, MESH_FORCE, TAN_ALPHA, HALF_BACKLASH, LOAD = range(24, 30)
PENETRATION, CLOSING, CONTACT_X, CONTACT_Y, FILM_X, FILM_Y, DAMPING = range(30, 44, 2)
POINT_SIZE = 44

# Columns of the excitation table, one pair of amplitudes (cosine, sine) each, and of its values.
SURFACE, SURFACE_SLOPE, SURFACE_CURVATURE, STIFFNESS, STIFFNESS_SLOPE, ERROR, ERROR_SLOPE, ERROR_CURVATURE = (
    range(8)
)
EXCITATIONS = 8
ROW_BLOCK = 8  # rows are padded to whole blocks of vector lanes

SERIES_TERMS = 10
SERIES_REACH = 1.0 / 40.0  # of tan^2(alpha0): beyond it the involute is evaluated in full
ARCTANGENT_REACH = 1e-2
ARCTANGENT_SERIES_REACH = 0.2

# Of the change of an event's value over its step. A gap may open onto a jump of the damping force; a clamp is
# a mere kink, where an error in time counts by its square.
GAP_TOLERANCE = 1e-10
CLAMP_TOLERANCE = 1e-7
SEARCH_LIMIT = 30
STOPS_PER_STEP = 24
# Of what is left of the step, for the first substep of a bearing contact: delta^1.5 is not smooth there.
ONSET_FRACTION = 0.1
# The largest product of substep and damping rate of a bearing contact; RK4 itself bears 2.78.
STIFFNESS_LIMIT = 0.25
SUBSTEPS_LIMIT = 4096.0
SHORTEST_SUBSTEP = 1e-9  # of the step

# Rows of states, points and excitations: start, end and middle of the step, lower end of a search.
HERE, END, MIDDLE, LOW = range(4)
ROWS = 4

RUNNING, OVER_SPEED, NON_FINITE, CENTRES_PRESSED = range(4)


CONSTANTS = np.dtype(
    [
        ("kelvin", np.int64),
        ("film", np.int64),
        ("exact_geometry", np.int64),
        ("contact_damping", np.int64),
        ("nominal_phase", np.int64),
        ("brake", np.int64),
        ("governed", np.int64),
        ("hunting", np.int64),  # turns of gear 1 after which the same teeth meet again
        ("steps_per_sample", np.int64),
        ("centre_distance", np.float64),  # a_s, m
        ("base_radius1", np.float64),  # m
        ("base_radius2", np.float64),
        ("per_radii2", np.float64),  # 1 / (r_b1 + r_b2)^2, 1/m^2
        ("tan2_alpha0", np.float64),
        ("involute_alpha0", np.float64),
        ("involute_series", np.float64, SERIES_TERMS),  # inv alpha - inv alpha0 in powers of xi
        ("half_backlash", np.float64),  # b0, m
        ("stiffness", np.float64),  # k_m, N/m
        ("damping", np.float64),  # c1, N s/m
        ("error_mean", np.float64),  # e_m, m
        ("per_mass1", np.float64),  # 1/kg
        ("per_mass2", np.float64),
        ("per_inertia1", np.float64),  # 1/(kg m^2)
        ("per_inertia2", np.float64),
        ("teeth1", np.float64),
        ("clearance", np.float64, 2),  # b_b, m, of each bearing as all that follow
        ("kelvin_stiffness", np.float64, 2),  # N/m
        ("kelvin_damping", np.float64, 2),  # N s/m
        ("hertz", np.float64, 2),  # k_h sqrt(b_b + delta) of (2), N/m
        ("damping_factor", np.float64, 2),  # a
        ("per_oil_clearance", np.float64, 2),  # 1 / C, 1/m
        ("film_factor", np.float64, 2),  # mu (D/2) L^3 / (4 C^2), N s
        ("minimum_impact_speed", np.float64),  # m/s
        ("eccentricity_limit2", np.float64),  # squared
        ("load_viscous", np.float64),  # N m s
        ("governor_proportional", np.float64),  # N m s
        ("governor_integral", np.float64),  # N m
        ("governor_limit", np.float64),  # N m
        ("speed_limit", np.float64),  # rad/s
        ("step", np.float64),  # s
    ],
    align=True,
)


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def excite(turn: float, waves: Floats, amplitudes: Floats, excs: Floats, e_row: int) -> None:
    """Sum of all periodic excitations at ``turn``, the fraction of the hunting cycle, into row ``e_row``.

    ``waves`` (3, n): orders per cycle, then room for cosine and sine; ``amplitudes`` (2, n, EXCITATIONS).
    Sine and cosine come from Taylor polynomials of the half angle, |x| <= pi/2, exact to rounding, in a loop
    without branches that the compiler turns into vectors.
    """
    n = waves.shape[1]
    for j in range(n):
        r = waves[0, j] * turn
        r -= (r + 6755399441055744.0) - 6755399441055744.0
        x = math.pi * r
        x2 = x * x
        s = 1.0 / 51090942171709440000.0
        s = s * x2 - 1.0 / 121645100408832000.0
        s = s * x2 + 1.0 / 355687428096000.0
        s = s * x2 - 1.0 / 1307674368000.0
        s = s * x2 + 1.0 / 6227020800.0
        s = s * x2 - 1.0 / 39916800.0
        s = s * x2 + 1.0 / 362880.0
        s = s * x2 - 1.0 / 5040.0
        s = s * x2 + 1.0 / 120.0
        s = s * x2 - 1.0 / 6.0
        s = x + x * x2 * s
        c = 1.0 / 2432902008176640000.0
        c = c * x2 - 1.0 / 6402373705728000.0
        c = c * x2 + 1.0 / 20922789888000.0
        c = c * x2 - 1.0 / 87178291200.0
        c = c * x2 + 1.0 / 479001600.0
        c = c * x2 - 1.0 / 3628800.0
        c = c * x2 + 1.0 / 40320.0
        c = c * x2 - 1.0 / 720.0
        c = c * x2 + 1.0 / 24.0
        c = c * x2 - 0.5
        c = c * x2 + 1.0
        waves[2, j] = 2.0 * s * c
        waves[1, j] = 1.0 - 2.0 * s * s
    v0 = v1 = v2 = v3 = v4 = v5 = v6 = v7 = 0.0
    for j in range(n):
        c, s = waves[1, j], waves[2, j]
        v0 += c * amplitudes[0, j, 0] + s * amplitudes[1, j, 0]
        v1 += c * amplitudes[0, j, 1] + s * amplitudes[1, j, 1]
        v2 += c * amplitudes[0, j, 2] + s * amplitudes[1, j, 2]
        v3 += c * amplitudes[0, j, 3] + s * amplitudes[1, j, 3]
        v4 += c * amplitudes[0, j, 4] + s * amplitudes[1, j, 4]
        v5 += c * amplitudes[0, j, 5] + s * amplitudes[1, j, 5]
        v6 += c * amplitudes[0, j, 6] + s * amplitudes[1, j, 6]
        v7 += c * amplitudes[0, j, 7] + s * amplitudes[1, j, 7]
    excs[e_row, 0] = v0
    excs[e_row, 1] = v1
    excs[e_row, 2] = v2
    excs[e_row, 3] = v3
    excs[e_row, 4] = v4
    excs[e_row, 5] = v5
    excs[e_row, 6] = v6
    excs[e_row, 7] = v7


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def arctangent(x: float) -> float:
    """atan x to rounding: Taylor's series where the film mostly is, without a call that spills registers."""
    if abs(x) > ARCTANGENT_SERIES_REACH:
        return math.atan(x)
    x2 = x * x
    x4 = x2 * x2
    even = 1.0 / 5.0 + x4 * (1.0 / 9.0 + x4 * (1.0 / 13.0 + x4 * (1.0 / 17.0 + x4 * (1.0 / 21.0))))
    odd = 1.0 / 3.0 + x4 * (1.0 / 7.0 + x4 * (1.0 / 11.0 + x4 * (1.0 / 15.0 + x4 * (1.0 / 19.0))))
    return x - x * x2 * (odd - x2 * even)


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def film_force(
    coefficient: float, w: float, ex: float, ey: float, ux: float, uy: float
) -> tuple[float, float]:
    """Capone's short-bearing film (9)-(15): force on the shaft (x, y) in N.

    ``coefficient`` mu (D/2) L^3 / (4 C^2) in N s, ``w`` signed shaft speed in rad/s; ``ex``, ``ey``
    eccentricity (dimensionless, below 1) and ``ux``, ``uy`` velocity, both divided by the radial clearance C.
    """
    a = w * ex - 2.0 * uy
    b = w * ey + 2.0 * ux
    m = math.sqrt(a * a + b * b)
    if m == 0.0:
        return 0.0, 0.0
    inverse_m = 1.0 / m
    cos_al, sin_al = -a * inverse_m, -b * inverse_m
    inverse_root = 1.0 / math.sqrt(1.0 - (ex * ex + ey * ey))
    inverse_s = inverse_root * inverse_root
    h = ey * cos_al - ex * sin_al
    g = 2.0 * inverse_root * (0.5 * math.pi + arctangent(h * inverse_root))
    v = (2.0 + h * g) * inverse_s
    c = ex * cos_al + ey * sin_al
    big_s = c / (1.0 - c * c)
    f = -coefficient * m * inverse_s
    return (
        f * (3.0 * ex * v - sin_al * g - 2.0 * cos_al * big_s),
        f * (3.0 * ey * v + cos_al * g - 2.0 * sin_al * big_s),
    )


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def bearing(
    constants: np.record,
    gear: int,
    w: float,
    x: float,
    y: float,
    vx: float,
    vy: float,
    latched: float,
    flags: Flags,
) -> Bearing:
    """Contact (2)-(6) and film (9)-(15) of one bearing, flags frozen.

    Returns (contact force x, y; film force x, y in N; penetration m, its rate m/s; events' values: gap, its
    rate, clamp, film margin, its rate; damping N s/m).
    """
    d = math.sqrt(x * x + y * y)
    nx, ny, inverse_d = 1.0, 0.0, 0.0
    if d > 0.0:
        inverse_d = 1.0 / d
        nx, ny = x * inverse_d, y * inverse_d
    delta = d - constants.clearance[gear]
    closing = vx * nx + vy * ny
    force = 0.0
    gap_sign, damping = -1.0, 0.0
    clamp_value = 1.0
    if flags[CONTACT + gear] == 1:
        gap_sign = 1.0
        if constants.kelvin:
            clamp_value = constants.kelvin_stiffness[gear] * delta + constants.kelvin_damping[gear] * closing
            force = clamp_value
            damping = constants.kelvin_damping[gear]
        else:
            depth = max(delta, 0.0)
            clamp_value = 1.0 + constants.damping_factor[gear] * closing / latched
            force = constants.hertz[gear] * depth * math.sqrt(depth * inverse_d)
            damping = force * constants.damping_factor[gear] / latched
            force *= clamp_value
        if flags[CLAMPED + gear] == 1:
            force = 0.0
            clamp_value = -clamp_value
    film_x, film_y, margin, margin_rate = 0.0, 0.0, 1.0, 0.0
    if constants.film:
        per_c = constants.per_oil_clearance[gear]
        relative = d * per_c
        eps2 = relative * relative
        margin, margin_rate = constants.eccentricity_limit2 - eps2, -2.0 * relative * closing * per_c
        # Before the event is located a trial step may overshoot the limit, yet never the wall.
        bound2 = 0.5 * (1.0 + constants.eccentricity_limit2)
        starved = flags[STARVED + gear] == 1
        if starved:
            bound2 = constants.eccentricity_limit2
            margin, margin_rate = -margin, -margin_rate
        ex, ey = x * per_c, y * per_c
        if starved or eps2 > bound2:
            scale = math.sqrt(bound2 / eps2)
            ex, ey = ex * scale, ey * scale
        film_x, film_y = film_force(constants.film_factor[gear], w, ex, ey, vx * per_c, vy * per_c)
    return (
        -force * nx,
        -force * ny,
        film_x,
        film_y,
        delta,
        closing,
        gap_sign * delta,
        gap_sign * closing,
        clamp_value,
        margin,
        margin_rate,
        damping,
    )


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def dynamics(
    constants: np.record,
    speed: float,
    load: float,
    states: Floats,
    s: int,
    flags: Flags,
    excs: Floats,
    e_row: int,
    lag: float,
) -> tuple[Rates, float, Mesh, Mesh, Bearing, Bearing]:
    """Right-hand side at row ``s`` of ``states`` with ``flags`` frozen, and the events' values.

    ``speed`` set-point in rad/s and ``load`` commanded load torque in N m; row ``e_row`` of ``excs`` holds
    the excitations at a phase that the state is ahead of by ``lag`` rad of mesh phase. (21)-(32).

    Returns (accelerations; mesh force; mesh events: upper gap and rate, lower gap and rate, clamp; (q, its
    rate, tan alpha, b1, load torque); bearing 1; bearing 2). Inlined, so that a caller pays for what it uses.
    """
    x1, y1, x2, y2 = states[s, X1], states[s, Y1], states[s, X2], states[s, Y2]
    vx1, vy1, vx2, vy2 = states[s, VX1], states[s, VY1], states[s, VX2], states[s, VY2]
    omega1, omega2 = states[s, OMEGA1], states[s, OMEGA2]
    rb1, rb2 = constants.base_radius1, constants.base_radius2
    r_sum = rb1 + rb2

    phase_speed = speed if constants.nominal_phase else omega1
    phi_rate = constants.teeth1 * phase_speed
    half = 0.5 * lag
    z = excs[e_row, SURFACE] + lag * (excs[e_row, SURFACE_SLOPE] + half * excs[e_row, SURFACE_CURVATURE])
    z_rate = phi_rate * (excs[e_row, SURFACE_SLOPE] + lag * excs[e_row, SURFACE_CURVATURE])
    k1 = constants.stiffness * (1.0 + excs[e_row, STIFFNESS] + lag * excs[e_row, STIFFNESS_SLOPE])
    e = (
        constants.error_mean
        + excs[e_row, ERROR]
        + lag * (excs[e_row, ERROR_SLOPE] + half * excs[e_row, ERROR_CURVATURE])
    )
    e_rate = phi_rate * (excs[e_row, ERROR_SLOPE] + lag * excs[e_row, ERROR_CURVATURE])

    ux, uy = x2 - x1, y2 - y1
    wx, wy = vx2 - vx1, vy2 - vy1
    dx = constants.centre_distance + ux
    a2 = dx * dx + uy * uy
    per_a = 1.0 / math.sqrt(a2)
    per_a2 = per_a * per_a
    xi = (ux * (2.0 * constants.centre_distance + ux) + uy * uy) * constants.per_radii2
    tan_alpha = math.sqrt(constants.tan2_alpha0 + xi)
    if abs(xi) < SERIES_REACH * constants.tan2_alpha0:
        series = constants.involute_series
        involute = series[SERIES_TERMS - 1]
        for i in range(SERIES_TERMS - 2, -1, -1):
            involute = involute * xi + series[i]
        involute *= xi
    else:
        involute = tan_alpha - math.atan(tan_alpha) - constants.involute_alpha0
    slope = uy / dx
    if abs(slope) < ARCTANGENT_REACH:
        s2 = slope * slope
        beta = slope * (1.0 - s2 * (1.0 / 3.0 - s2 * (0.2 - s2 * (1.0 / 7.0 - s2 * (1.0 / 9.0)))))
    else:
        beta = math.atan2(uy, dx)
    cos_beta, sin_beta = dx * per_a, uy * per_a
    cos_alpha = r_sum * per_a
    sin_alpha = cos_alpha * tan_alpha
    sin_gamma = sin_alpha * cos_beta - cos_alpha * sin_beta
    cos_gamma = cos_alpha * cos_beta + sin_alpha * sin_beta

    a_rate_over_a = (dx * wx + uy * wy) * per_a2
    beta_rate = (dx * wy - uy * wx) * per_a2
    b1 = r_sum * involute + constants.half_backlash - 0.5 * z
    b1_rate = r_sum * tan_alpha * a_rate_over_a - 0.5 * z_rate

    u_rate = rb1 * omega1 - rb2 * omega2
    if constants.exact_geometry:
        q = states[s, U] - r_sum * beta - e
        q_rate = u_rate - r_sum * beta_rate - e_rate
    else:
        gamma_rate = a_rate_over_a / tan_alpha - beta_rate
        q = states[s, U] - ux * sin_gamma - uy * cos_gamma - e
        q_rate = (
            u_rate - wx * sin_gamma - wy * cos_gamma - gamma_rate * (ux * cos_gamma - uy * sin_gamma) - e_rate
        )

    flank = flags[FLANK]
    upper, upper_rate = b1 - q, b1_rate - q_rate
    lower, lower_rate = q + b1, q_rate + b1_rate
    along_x, along_y = sin_gamma, cos_gamma
    clamp_value = 1.0
    force = 0.0
    if flank == 1:
        upper, upper_rate = -upper, -upper_rate
        lower, lower_rate = 1.0, 0.0
        force = k1 * upper
    elif flank == -1:
        force = k1 * lower
        lower, lower_rate = -lower, -lower_rate
        upper, upper_rate = 1.0, 0.0
        if constants.exact_geometry:
            along_x = -(sin_alpha * cos_beta + cos_alpha * sin_beta)
            along_y = cos_alpha * cos_beta - sin_alpha * sin_beta
    if constants.contact_damping:
        if flank != 0:
            force += constants.damping * (q_rate - flank * b1_rate)
            clamp_value = flank * force
            if flags[MESH_CLAMPED] == 1:
                clamp_value = -clamp_value
                force = 0.0
    else:
        force += constants.damping * q_rate

    w1, w2 = omega1, -omega2
    if constants.nominal_phase:
        w1, w2 = speed, -speed * rb1 / rb2
    bearing1 = bearing(constants, 0, w1, x1, y1, vx1, vy1, states[s, IMPACT_SPEED], flags)
    bearing2 = bearing(constants, 1, w2, x2, y2, vx2, vy2, states[s, IMPACT_SPEED + 1], flags)
    load_torque = load
    if constants.brake:
        load_torque = load * math.tanh(omega2)
    load_torque += constants.load_viscous * omega2

    return (
        (
            (bearing1[0] + bearing1[2] - force * along_x) * constants.per_mass1,
            (bearing1[1] + bearing1[3] - force * along_y) * constants.per_mass1,
            (bearing2[0] + bearing2[2] + force * along_x) * constants.per_mass2,
            (bearing2[1] + bearing2[3] + force * along_y) * constants.per_mass2,
            (states[s, DRIVE_TORQUE] - force * rb1) * constants.per_inertia1,
            (force * rb2 - load_torque) * constants.per_inertia2,
        ),
        force,
        (upper, upper_rate, lower, lower_rate, clamp_value),
        (q, q_rate, tan_alpha, b1, load_torque),
        bearing1,
        bearing2,
    )


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def evaluate(
    constants: np.record,
    speed: float,
    load: float,
    states: Floats,
    s: int,
    flags: Flags,
    excs: Floats,
    e_row: int,
    lag: float,
    points: Floats,
    p: int,
) -> None:
    """``dynamics`` at row ``s`` of ``states``, all of it kept in row ``p`` of ``points``."""
    acceleration, force, mesh, shown, bearing1, bearing2 = dynamics(
        constants, speed, load, states, s, flags, excs, e_row, lag
    )
    for i in range(6):
        points[p, AX1 + i] = acceleration[i]
    points[p, MESH_FORCE] = force
    points[p, VALUE + UPPER_GAP], points[p, RATE + UPPER_GAP] = mesh[0], mesh[1]
    points[p, VALUE + LOWER_GAP], points[p, RATE + LOWER_GAP] = mesh[2], mesh[3]
    points[p, VALUE + MESH_CLAMP] = mesh[4]
    points[p, Q], points[p, Q_RATE], points[p, TAN_ALPHA] = shown[0], shown[1], shown[2]
    points[p, HALF_BACKLASH], points[p, LOAD] = shown[3], shown[4]
    keep_bearing(points, p, 0, bearing1)
    keep_bearing(points, p, 1, bearing2)


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def keep_bearing(points: Floats, p: int, gear: int, values: Bearing) -> None:
    """Store what ``bearing`` returned."""
    points[p, CONTACT_X + gear], points[p, CONTACT_Y + gear] = values[0], values[1]
    points[p, FILM_X + gear], points[p, FILM_Y + gear] = values[2], values[3]
    points[p, PENETRATION + gear], points[p, CLOSING + gear] = values[4], values[5]
    points[p, VALUE + BEARING_GAP + gear], points[p, RATE + BEARING_GAP + gear] = values[6], values[7]
    points[p, VALUE + BEARING_CLAMP + gear] = values[8]
    points[p, VALUE + FILM_LIMIT + gear], points[p, RATE + FILM_LIMIT + gear] = values[9], values[10]
    points[p, DAMPING + gear] = values[11]


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def phase_turn(constants: np.record, turns: int, turn: float) -> float:
    """Fraction of the hunting cycle at ``turns`` whole and ``turn`` further turns of gear 1."""
    fraction: float = (turns + turn) / constants.hunting
    return fraction


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def rates(constants: np.record, states: Floats, row: int) -> Rates:
    """Rates of (x1, y1, x2, y2, u, theta1) at ``row``."""
    return (
        states[row, VX1],
        states[row, VY1],
        states[row, VX2],
        states[row, VY2],
        constants.base_radius1 * states[row, OMEGA1] - constants.base_radius2 * states[row, OMEGA2],
        states[row, OMEGA1],
    )


@njit(cache=True, fastmath={"contract"}, error_model="numpy", forceinline=True)
def set_stage(states: Floats, h: float, rate: Rates, acceleration: Rates) -> None:
    """END becomes HERE after ``h`` s of constant ``rate`` and ``acceleration``."""
    states[END, X1] = states[HERE, X1] + h * rate[0]
    states[END, Y1] = states[HERE, Y1] + h * rate[1]
    states[END, X2] = states[HERE, X2] + h * rate[2]
    states[END, Y2] = states[HERE, Y2] + h * rate[3]
    states[END, U] = states[HERE, U] + h * rate[4]
    states[END, THETA1] = states[HERE, THETA1] + h * rate[5]
    states[END, VX1] = states[HERE, VX1] + h * acceleration[AX1]
    states[END, VY1] = states[HERE, VY1] + h * acceleration[AY1]
    states[END, VX2] = states[HERE, VX2] + h * acceleration[AX2]
    states[END, VY2] = states[HERE, VY2] + h * acceleration[AY2]
    states[END, OMEGA1] = states[HERE, OMEGA1] + h * acceleration[ALPHA1]
    states[END, OMEGA2] = states[HERE, OMEGA2] + h * acceleration[ALPHA2]


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def try_step(
    constants: np.record,
    speed: float,
    load: float,
    waves: Floats,
    amplitudes: Floats,
    states: Floats,
    flags: Flags,
    phase: float,
    points: Floats,
    excs: Floats,
    h: float,
) -> float:
    """Classic RK4 over ``h`` from HERE to END with frozen flags, in Nystrom's form.

    ``phase`` is the nominal turn at HERE. Fills row END of states, points and excitations and returns the lag
    of the end state behind those excitations, in rad of mesh phase. They are summed at two phases a step; the
    other stages lie within the square of the step of these and take them by Taylor's series.
    """
    turns = flags[TURN]
    half = 0.5 * h
    nominal = constants.nominal_phase
    start = (
        points[HERE, AX1],
        points[HERE, AY1],
        points[HERE, AX2],
        points[HERE, AY2],
        points[HERE, ALPHA1],
        points[HERE, ALPHA2],
    )
    # Latched impact speeds change at HERE only, between trials.
    states[END, IMPACT_SPEED] = states[HERE, IMPACT_SPEED]
    states[END, IMPACT_SPEED + 1] = states[HERE, IMPACT_SPEED + 1]

    rate = rates(constants, states, HERE)
    set_stage(states, half, rate, start)
    turn = phase + half * speed * TURNS_PER_RADIAN if nominal else states[END, THETA1] * TURNS_PER_RADIAN
    excite(phase_turn(constants, turns, turn), waves, amplitudes, excs, MIDDLE)
    middle, force_middle, _, _, _, _ = dynamics(constants, speed, load, states, END, flags, excs, MIDDLE, 0.0)

    rate2 = rates(constants, states, END)
    set_stage(states, half, rate2, middle)
    lag = 0.0 if nominal else constants.teeth1 * half * (rate2[5] - rate[5])
    late, force_late, _, _, _, _ = dynamics(constants, speed, load, states, END, flags, excs, MIDDLE, lag)

    set_stage(states, h, rates(constants, states, END), late)
    theta1 = states[END, THETA1]
    turn = phase + h * speed * TURNS_PER_RADIAN if nominal else theta1 * TURNS_PER_RADIAN
    excite(phase_turn(constants, turns, turn), waves, amplitudes, excs, END)
    last, force_last, _, _, _, _ = dynamics(constants, speed, load, states, END, flags, excs, END, 0.0)

    third, sixth = h / 3.0, h / 6.0
    ax1, ay1, ax2, ay2, alpha1, alpha2 = (
        middle[AX1] + late[AX1],
        middle[AY1] + late[AY1],
        middle[AX2] + late[AX2],
        middle[AY2] + late[AY2],
        middle[ALPHA1] + late[ALPHA1],
        middle[ALPHA2] + late[ALPHA2],
    )
    # Positions need k1 + k2 + k3 of the accelerations, speeds k1 + 2 k2 + 2 k3 + k4.
    drift = (
        start[AX1] + ax1,
        start[AY1] + ay1,
        start[AX2] + ax2,
        start[AY2] + ay2,
        constants.base_radius1 * (start[ALPHA1] + alpha1) - constants.base_radius2 * (start[ALPHA2] + alpha2),
        start[ALPHA1] + alpha1,
    )
    for i in range(6):
        states[END, i] = states[HERE, i] + h * (rate[i] + sixth * drift[i])
    states[END, VX1] = states[HERE, VX1] + sixth * (start[AX1] + last[AX1]) + third * ax1
    states[END, VY1] = states[HERE, VY1] + sixth * (start[AY1] + last[AY1]) + third * ay1
    states[END, VX2] = states[HERE, VX2] + sixth * (start[AX2] + last[AX2]) + third * ax2
    states[END, VY2] = states[HERE, VY2] + sixth * (start[AY2] + last[AY2]) + third * ay2
    states[END, OMEGA1] = states[HERE, OMEGA1] + sixth * (start[ALPHA1] + last[ALPHA1]) + third * alpha1
    states[END, OMEGA2] = states[HERE, OMEGA2] + sixth * (start[ALPHA2] + last[ALPHA2]) + third * alpha2
    states[END, MESH_IMPULSE] = (
        states[HERE, MESH_IMPULSE]
        + sixth * (points[HERE, MESH_FORCE] + force_last)
        + third * (force_middle + force_late)
    )
    lag = 0.0 if nominal else constants.teeth1 * (states[END, THETA1] - theta1)
    evaluate(constants, speed, load, states, END, flags, excs, END, lag, points, END)
    return lag


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
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


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def has_rate(event: int) -> bool:
    """Whether the rate of ``event`` is known: clamps have none, it would need accelerations."""
    return event != MESH_CLAMP and event != BEARING_CLAMP and event != BEARING_CLAMP + 1


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def event_tolerance(event: int) -> float:
    """How close to zero ``event`` is located, relative to the change of its value."""
    return GAP_TOLERANCE if has_rate(event) else CLAMP_TOLERANCE


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def first_violated(points: Floats, h: float) -> int:
    """The event that seems to come first of those whose value is negative at END, or -1."""
    first, earliest = -1, 2.0
    for event in range(EVENT_COUNT):
        v1 = points[END, VALUE + event]
        if v1 < 0.0:
            v0 = points[HERE, VALUE + event]
            at = 0.0
            if v0 > 0.0:
                if has_rate(event):
                    at = hermite_root(v0, h * points[HERE, RATE + event], v1, h * points[END, RATE + event])
                else:
                    at = v0 / (v0 - v1)
            if at < earliest:
                first, earliest = event, at
    return first


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def grazing_fraction(points: Floats, h: float) -> float:
    """Fraction of the step at which a gap seems to close and open again, or 0.

    Looks at gaps that are open at both ends but close at the start and open at the end.
    """
    for event in (UPPER_GAP, LOWER_GAP, BEARING_GAP, BEARING_GAP + 1):
        v0, r0 = points[HERE, VALUE + event], h * points[HERE, RATE + event]
        if v0 > 0.0 and v0 + r0 < 0.0:
            v1, r1 = points[END, VALUE + event], h * points[END, RATE + event]
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


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def flip(constants: np.record, event: int, states: Floats, flags: Flags, points: Floats) -> None:
    """Change the flag that ``event`` stands for; a bearing contact that begins latches its speed."""
    if event <= LOWER_GAP:
        side = 1 if event == UPPER_GAP else -1
        flags[FLANK] = side if flags[FLANK] == 0 else 0
        flags[MESH_CLAMPED] = 0
        flags[FLANK_CHANGES] += 1
    elif event == MESH_CLAMP:
        flags[MESH_CLAMPED] = 1 - flags[MESH_CLAMPED]
    elif event < BEARING_CLAMP:
        gear = event - BEARING_GAP
        flags[CLAMPED + gear] = 0
        flags[CONTACT + gear] = 1 - flags[CONTACT + gear]
        if flags[CONTACT + gear] == 1:
            states[HERE, IMPACT_SPEED + gear] = max(
                points[HERE, CLOSING + gear], constants.minimum_impact_speed
            )
            flags[IMPACTS] += 1
    elif event < FILM_LIMIT:
        flags[CLAMPED + event - BEARING_CLAMP] = 1 - flags[CLAMPED + event - BEARING_CLAMP]
    else:
        flags[STARVED + event - FILM_LIMIT] = 1 - flags[STARVED + event - FILM_LIMIT]
    flags[EVENTS] += 1


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def settled_with(event: int) -> int:
    """Bits of the events that one stop decides together with ``event``: itself, and of a gap its clamp.

    Where a contact begins or ends without damping, gap and clamp are the same surface, and rounding alone
    would say on which side of the clamp the state lies.
    """
    bits = 1 << event
    if event <= LOWER_GAP:
        bits |= 1 << MESH_CLAMP
    elif event == BEARING_GAP or event == BEARING_GAP + 1:
        bits |= 1 << (event - BEARING_GAP + BEARING_CLAMP)
    return bits


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def settle(
    constants: np.record,
    speed: float,
    load: float,
    event: int,
    states: Floats,
    flags: Flags,
    excs: Floats,
    lag: float,
    points: Floats,
) -> None:
    """Flip ``event`` at HERE and, as events fall together, every other one that is past its surface."""
    flip(constants, event, states, flags, points)
    flipped = settled_with(event)
    for _ in range(EVENT_COUNT):
        evaluate(constants, speed, load, states, HERE, flags, excs, HERE, lag, points, HERE)
        following = -1
        for other in range(EVENT_COUNT):
            value, change = points[HERE, VALUE + other], points[HERE, RATE + other]
            # What an earlier stop of this step flipped may still be short of its surface, on its way there.
            if value <= 0.0 and change < 0.0 and not (flipped >> other) & 1:
                following = other
                break
        if following < 0:
            return
        flip(constants, following, states, flags, points)
        flipped |= settled_with(following)


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def locate(
    constants: np.record,
    speed: float,
    load: float,
    waves: Floats,
    amplitudes: Floats,
    states: Floats,
    flags: Flags,
    phase: float,
    points: Floats,
    excs: Floats,
    h: float,
    event: int,
) -> tuple[float, int, float, int]:
    """Shorten the step ``h`` until it ends on the first event; returns (h, event, lag at END, capped).

    ``event`` is positive at HERE and negative at END on entry. Steps are tried at the root of the cubic
    through both ends of the bracket (of the secant, weighted after Illinois, where no rate is known). A
    second event that turns out to come earlier takes over.
    """
    low, high = 0.0, h
    points[LOW, :] = points[HERE, :]
    v_high, r_high = points[END, VALUE + event], points[END, RATE + event]
    tolerance = event_tolerance(event) * (points[HERE, VALUE + event] - v_high)
    weight_low, weight_high, side = 1.0, 1.0, 0
    at, lag_end = h, 0.0
    for _ in range(SEARCH_LIMIT):
        v_low, width = points[LOW, VALUE + event], high - low
        if has_rate(event):
            fraction = hermite_root(v_low, width * points[LOW, RATE + event], v_high, width * r_high)
        else:
            fraction = weight_low * v_low / (weight_low * v_low - weight_high * v_high)
        at = low + fraction * width
        if not (low < at < high):
            at = 0.5 * (low + high)
        lag_end = try_step(constants, speed, load, waves, amplitudes, states, flags, phase, points, excs, at)
        earlier = -1
        for other in range(EVENT_COUNT):
            v0, v1 = points[LOW, VALUE + other], points[END, VALUE + other]
            if other != event and v0 > 0.0 and v1 < -event_tolerance(other) * (v0 - v1):
                earlier = other
        value = points[END, VALUE + (event if earlier < 0 else earlier)]
        if earlier >= 0:
            event, high = earlier, at
            v_high, r_high = value, points[END, RATE + event]
            tolerance = event_tolerance(event) * (points[LOW, VALUE + event] - value)
            weight_low, weight_high, side = 1.0, 1.0, 0
        elif abs(value) <= tolerance or width <= 1e-12 * h:
            return at, event, lag_end, 0
        elif value < 0.0:
            high, v_high, r_high = at, value, points[END, RATE + event]
            weight_high = 1.0
            weight_low = 0.5 * weight_low if side == -1 else 1.0
            side = -1
        else:
            low = at
            points[LOW, :] = points[END, :]
            weight_low = 1.0
            weight_high = 0.5 * weight_high if side == 1 else 1.0
            side = 1
    return at, event, lag_end, 1


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def split_step(
    constants: np.record,
    speed: float,
    load: float,
    waves: Floats,
    amplitudes: Floats,
    states: Floats,
    flags: Flags,
    points: Floats,
    excs: Floats,
    lag_end: float,
    longest: float,
) -> None:
    """One step in substeps of at most ``longest``, split at every event.

    Starts from a first trial of ``longest``, at END with ``lag_end``. Searches that met their limit are
    counted in CAPPED.
    """
    step = constants.step
    phase = states[HERE, NOMINAL_TURN]
    done, h, stops = 0.0, longest, 0
    tried = True
    contacts = flags[CONTACT] + flags[CONTACT + 1]
    while True:
        if not tried:
            lag_end = try_step(
                constants, speed, load, waves, amplitudes, states, flags, phase, points, excs, h
            )
        tried = False
        event = -1
        if stops < STOPS_PER_STEP:
            event = first_violated(points, h)
            if event < 0:
                fraction = grazing_fraction(points, h)
                if fraction > SHORTEST_SUBSTEP:
                    h *= fraction
                    stops += 1
                    continue
            elif points[HERE, VALUE + event] > 0.0:
                h, event, lag_end, capped = locate(
                    constants, speed, load, waves, amplitudes, states, flags, phase, points, excs, h, event
                )
                flags[CAPPED] += capped
                stops += 1
            elif h > SHORTEST_SUBSTEP * step:
                # Just flipped, yet past its surface at the end: look for a point before that.
                h *= 0.5
                continue
            else:
                flags[CAPPED] += 1
                stops += 1
            if stops == STOPS_PER_STEP:
                flags[CAPPED] += 1
        note_clamp_rates(points, h)
        accept(states, points, excs)
        done += h
        phase += h * speed * TURNS_PER_RADIAN
        if event >= 0:
            settle(constants, speed, load, event, states, flags, excs, lag_end, points)
        h = step - done
        if h <= SHORTEST_SUBSTEP * step:
            break
        h = min(h, longest)
        begun = flags[CONTACT] + flags[CONTACT + 1] > contacts
        contacts = flags[CONTACT] + flags[CONTACT + 1]
        if begun:
            h *= ONSET_FRACTION
    if stops >= STOPS_PER_STEP:
        late = -1
        for event in range(EVENT_COUNT):
            if points[HERE, VALUE + event] < 0.0:
                late = event
        if late >= 0:
            settle(constants, speed, load, late, states, flags, excs, lag_end, points)


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def longest_substep(constants: np.record, points: Floats, flags: Flags) -> float:
    """The step, halved until it bears the damping of the bearing contacts at HERE.

    A contact that began slowly has a damping coefficient, a k_h delta^1.5 / v_impact, without a bound:
    pressed in later it would overshoot its own resting point.
    """
    rate = max(points[HERE, DAMPING] * constants.per_mass1, points[HERE, DAMPING + 1] * constants.per_mass2)
    step: float = constants.step
    substeps = 1.0
    while step * rate > STIFFNESS_LIMIT * substeps:
        substeps *= 2.0
        if substeps == SUBSTEPS_LIMIT:
            flags[CAPPED] += 1
            break
    return step / substeps


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def note_clamp_rates(points: Floats, h: float) -> None:
    """The clamps' mean rates over the substep, in place of the rates that would need accelerations."""
    for event in (MESH_CLAMP, BEARING_CLAMP, BEARING_CLAMP + 1):
        points[END, RATE + event] = (points[END, VALUE + event] - points[HERE, VALUE + event]) / h


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def accept(states: Floats, points: Floats, excs: Floats) -> None:
    """The end of the trial becomes the state."""
    for i in range(MECHANICAL + 1):
        states[HERE, i] = states[END, i]
    for i in range(POINT_SIZE):
        points[HERE, i] = points[END, i]
    for i in range(EXCITATIONS):
        excs[HERE, i] = excs[END, i]


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def is_eventful(points: Floats, h: float) -> bool:
    """Whether a surface was crossed over the trial step, or a gap may have closed and opened again."""
    crossed = False
    for event in range(EVENT_COUNT):
        crossed |= points[END, VALUE + event] < 0.0
    for event in (UPPER_GAP, LOWER_GAP, BEARING_GAP, BEARING_GAP + 1):
        crossed |= points[HERE, VALUE + event] + h * points[HERE, RATE + event] < 0.0
    return crossed


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def wrap(constants: np.record, states: Floats, flags: Flags) -> None:
    """Bring theta1 back to one revolution and count it; the phase counts modulo the hunting cycle."""
    revolutions = 0
    if states[HERE, THETA1] >= TWO_PI:
        states[HERE, THETA1] -= TWO_PI
        revolutions = 1
    elif states[HERE, THETA1] < 0.0:
        states[HERE, THETA1] += TWO_PI
        revolutions = -1
    if revolutions != 0:
        flags[REVOLUTIONS] += revolutions
        if not constants.nominal_phase:
            flags[TURN] = (flags[TURN] + revolutions) % constants.hunting


@njit(cache=True, error_model="numpy")
def advance_nominal(constants: np.record, speed: float, states: Floats, flags: Flags) -> None:
    """One step of the nominal phase, without the drift of a plain sum (Kahan); must not be contracted."""
    increment = speed * constants.step * TURNS_PER_RADIAN - states[HERE, NOMINAL_REST]
    before = states[HERE, NOMINAL_TURN]
    turn = before + increment
    states[HERE, NOMINAL_REST] = (turn - before) - increment
    if turn >= 1.0:
        turn -= 1.0
        flags[TURN] = (flags[TURN] + 1) % constants.hunting
    elif turn < 0.0:
        turn += 1.0
        flags[TURN] = (flags[TURN] - 1) % constants.hunting
    states[HERE, NOMINAL_TURN] = turn


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def govern(constants: np.record, speed: float, states: Floats, interval: float) -> None:
    """PI governor, once a sample: T_M = clip(Kp err + I); I stands still while clipped."""
    error = speed - states[HERE, OMEGA1]
    wanted = constants.governor_proportional * error + states[HERE, GOVERNOR]
    limit = constants.governor_limit
    states[HERE, DRIVE_TORQUE] = min(max(wanted, -limit), limit)
    if -limit <= wanted <= limit:
        states[HERE, GOVERNOR] += constants.governor_integral * error * interval


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def write_sample(
    constants: np.record,
    time: float,
    turn: float,
    states: Floats,
    flags: Flags,
    points: Floats,
    row: Floats,
    angles: Floats,
) -> None:
    """One row of CHANNELS and the accumulated angles of both shafts."""
    row[0] = time
    row[1] = points[HERE, Q]
    row[2] = points[HERE, Q_RATE]
    row[3] = points[HERE, MESH_FORCE]
    row[4] = math.atan(points[HERE, TAN_ALPHA])
    row[5] = math.atan2(
        states[HERE, Y2] - states[HERE, Y1], constants.centre_distance + states[HERE, X2] - states[HERE, X1]
    )
    row[6] = points[HERE, HALF_BACKLASH]
    row[7] = flags[FLANK]
    for i in range(4):
        row[8 + i] = states[HERE, X1 + i]
    for gear in range(2):
        row[12 + 2 * gear] = points[HERE, CONTACT_X + gear]
        row[13 + 2 * gear] = points[HERE, CONTACT_Y + gear]
        row[16 + 2 * gear] = points[HERE, FILM_X + gear]
        row[17 + 2 * gear] = points[HERE, FILM_Y + gear]
        row[20 + gear] = points[HERE, PENETRATION + gear]
    row[22] = states[HERE, OMEGA1]
    row[23] = states[HERE, OMEGA2]
    row[24] = states[HERE, DRIVE_TORQUE]
    row[25] = points[HERE, LOAD]
    row[26] = states[HERE, THETA1]
    mesh_turn = constants.teeth1 * turn
    row[27] = TWO_PI * (mesh_turn - math.floor(mesh_turn))
    angles[0] = TWO_PI * flags[REVOLUTIONS] + states[HERE, THETA1]
    angles[1] = (constants.base_radius1 * angles[0] - states[HERE, U]) / constants.base_radius2


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def open_point(
    constants: np.record,
    speed: float,
    load: float,
    waves: Floats,
    amplitudes: Floats,
    states: Floats,
    flags: Flags,
    points: Floats,
    excs: Floats,
) -> float:
    """Evaluate the state HERE afresh; returns the turn of gear 1 that sets the phase."""
    turn: float = states[HERE, THETA1] * TURNS_PER_RADIAN
    if constants.nominal_phase:
        turn = states[HERE, NOMINAL_TURN]
    excite(phase_turn(constants, flags[TURN], turn), waves, amplitudes, excs, HERE)
    evaluate(constants, speed, load, states, HERE, flags, excs, HERE, 0.0, points, HERE)
    return turn


@njit(cache=True, error_model="numpy")
def make_work(y: Floats, orders: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Scratch of the integrator around the state ``y``: (states, points, excs, waves)."""
    states = np.zeros((2, STATE_SIZE))
    states[HERE, :] = y
    states[END, :] = y
    waves = np.zeros((3, orders.shape[0]))
    waves[0, :] = orders
    return states, np.zeros((ROWS, POINT_SIZE)), np.zeros((ROWS, EXCITATIONS)), waves


@njit(cache=True, error_model="numpy")
def touch(
    constants: np.record,
    commands: tuple[float, float],
    orders: Floats,
    amplitudes: Floats,
    y: Floats,
    flags: Flags,
) -> None:
    """Set u so that the drive flank just touches (q = b1), in contact if the gap is closing."""
    speed, load = commands
    flags[FLANK] = 0
    y[U] = 0.0
    states, points, excs, waves = make_work(y, orders)
    open_point(constants, speed, load, waves, amplitudes, states, flags, points, excs)
    y[U] = points[HERE, HALF_BACKLASH] - points[HERE, Q]
    if points[HERE, RATE + UPPER_GAP] < 0.0:
        flags[FLANK] = 1


@njit(cache=True, error_model="numpy")
def accelerations(
    constants: np.record,
    commands: tuple[float, float],
    orders: Floats,
    amplitudes: Floats,
    y: Floats,
    flags: Flags,
) -> Floats:
    """Accelerations (x1, y1, x2, y2 in m/s^2; omega1, omega2 in rad/s^2) at ``y`` with ``flags`` frozen."""
    speed, load = commands
    states, points, excs, waves = make_work(y, orders)
    open_point(constants, speed, load, waves, amplitudes, states, flags, points, excs)
    return points[HERE, :6].copy()


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def run(
    constants: np.record,
    commands: tuple[float, float],
    orders: Floats,
    amplitudes: Floats,
    y: Floats,
    flags: Flags,
    first_sample: int,
    interval_ns: int,
    samples: Floats,
    angles: Floats,
) -> tuple[int, int]:
    """Integrate and sample: row k of ``samples`` (n, 28) and ``angles`` (n, 2) is the state before its steps.

    ``commands`` (speed, load torque). Changes ``y`` and ``flags`` in place; returns (rows written, status).
    On OVER_SPEED and CENTRES_PRESSED the last row is the state that broke the limit; a NON_FINITE state is
    not written.
    """
    speed, load = commands
    n = samples.shape[0]
    states, points, excs, waves = make_work(y, orders)
    limit, step = constants.speed_limit, constants.step
    interval = step * constants.steps_per_sample
    written, status = n, RUNNING
    for row in range(n):
        if constants.governed:
            govern(constants, speed, states, interval)
            states[END, DRIVE_TORQUE] = states[HERE, DRIVE_TORQUE]
        turn = open_point(constants, speed, load, waves, amplitudes, states, flags, points, excs)
        total = 0.0
        for i in range(MECHANICAL):
            total += states[HERE, i] + points[HERE, AX1 + i % 6]
        if not math.isfinite(total):
            written, status = row, NON_FINITE
            break
        time = (first_sample + row) * interval_ns / 1e9
        write_sample(constants, time, turn, states, flags, points, samples[row], angles[row])
        if abs(states[HERE, OMEGA1]) > limit or abs(states[HERE, OMEGA2]) > limit:
            written, status = row + 1, OVER_SPEED
            break
        if points[HERE, HALF_BACKLASH] <= 0.0 or flags[PRESSED] == 1:
            written, status = row + 1, CENTRES_PRESSED
            break
        for _ in range(constants.steps_per_sample):
            phase = states[HERE, NOMINAL_TURN]
            longest = longest_substep(constants, points, flags)
            lag = try_step(
                constants, speed, load, waves, amplitudes, states, flags, phase, points, excs, longest
            )
            if longest < step or is_eventful(points, step):
                split_step(
                    constants, speed, load, waves, amplitudes, states, flags, points, excs, lag, longest
                )
            else:
                accept(states, points, excs)
            wrap(constants, states, flags)
            if constants.nominal_phase:
                advance_nominal(constants, speed, states, flags)
            flags[STEPS] += 1
            if points[HERE, HALF_BACKLASH] <= 0.0:
                flags[PRESSED] = 1
    y[:] = states[HERE, :]
    return written, status
