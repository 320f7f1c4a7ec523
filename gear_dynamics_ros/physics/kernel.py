"""Every compiled function of the model and of its integrator.

One file on purpose: numba's cache looks at the file of the outermost function only. Symbols and equation
numbers are those of docs/model.md and of the paper; all values are SI. A hot function returns a status, never
raises. Arrays passed around: ``y`` the state (STATE_SIZE), ``flags`` the discrete state (FLAGS_SIZE),
``point`` everything evaluated at one state (POINT_SIZE).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

TWO_PI = 2.0 * math.pi
TURNS_PER_RADIAN = 1.0 / TWO_PI

# State y. The first twelve are integrated; the rest changes at samples or at events.
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
Q, Q_RATE, MESH_FORCE, TAN_ALPHA, HALF_BACKLASH, BACKLASH_RATE, LOAD = range(24, 31)
PENETRATION, CLOSING, CONTACT_X, CONTACT_Y, FILM_X, FILM_Y = range(31, 43, 2)
POINT_SIZE = 43

# Columns of the excitation table, one pair of amplitudes (cosine, sine) each, and of its values.
SURFACE, SURFACE_SLOPE, SURFACE_CURVATURE, STIFFNESS, STIFFNESS_SLOPE, ERROR, ERROR_SLOPE, ERROR_CURVATURE = range(8)
EXCITATIONS = 8
ROW_BLOCK = 8  # rows are padded to whole blocks of vector lanes

SERIES_TERMS = 10
SERIES_REACH = 1.0 / 40.0  # of tan^2(alpha0): beyond it the involute is evaluated in full
ARCTANGENT_REACH = 1e-2

EVENT_TOLERANCE = 1e-10  # of the change of an event's value over its step
SEARCH_LIMIT = 30
STOPS_PER_STEP = 24
SHORTEST_SUBSTEP = 1e-9  # of the step

RUNNING, OVER_SPEED, NON_FINITE, CENTRES_PRESSED = range(4)


class BearingConstants(NamedTuple):
    """One gear's bearing."""

    clearance: float  # b_b, m
    kelvin_stiffness: float  # N/m
    kelvin_damping: float  # N s/m
    hertz: float  # k_h sqrt(b_b + delta) of (2), N/m
    damping_factor: float  # a
    oil_clearance: float  # C, m
    film: float  # mu (D/2) L^3 / (4 C^2), N s


class Constants(NamedTuple):
    """What the kernel needs of the parameters, computed once."""

    kelvin: bool
    film: bool
    exact_geometry: bool
    contact_damping: bool
    nominal_phase: bool
    brake: bool
    governed: bool
    centre_distance: float  # a_s
    base_radius1: float
    base_radius2: float
    tan2_alpha0: float
    involute_alpha0: float
    involute_series: tuple[float, ...]  # inv alpha - inv alpha0 in powers of xi
    half_backlash: float  # b0
    stiffness: float  # k_m
    damping: float  # c1
    error_mean: float  # e_m
    mass1: float
    mass2: float
    inertia1: float
    inertia2: float
    teeth1: float
    hunting: float  # turns of gear 1 after which both gears meet again
    bearing1: BearingConstants
    bearing2: BearingConstants
    minimum_impact_speed: float
    eccentricity_limit2: float  # squared
    load_viscous: float
    governor_proportional: float
    governor_integral: float
    governor_limit: float
    speed_limit: float
    step: float
    steps_per_sample: int


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def excite(turn, orders, cosines, sines, waves, values):
    """Sum of all periodic excitations at ``turn``, the fraction of the hunting cycle, into ``values``.

    ``orders`` (n,) waves per cycle; ``cosines``, ``sines`` (n, EXCITATIONS) amplitudes; ``waves`` (2, n) scratch.
    Sine and cosine come from Taylor polynomials of the half angle, |x| <= pi/2, exact to rounding, in a loop
    without branches that the compiler turns into vectors.
    """
    n = orders.shape[0]
    cosine, sine = waves[0], waves[1]
    for j in range(n):
        r = orders[j] * turn
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
        sine[j] = 2.0 * s * c
        cosine[j] = 1.0 - 2.0 * s * s
    for i in range(EXCITATIONS):
        values[i] = 0.0
    for j in range(n):
        for i in range(EXCITATIONS):
            values[i] += cosine[j] * cosines[j, i] + sine[j] * sines[j, i]


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def film_force(coefficient, w, ex, ey, ux, uy):
    """Capone's short-bearing film (9)-(15): force on the shaft (x, y) in N.

    ``coefficient`` mu (D/2) L^3 / (4 C^2) in N s, ``w`` signed shaft speed in rad/s; ``ex``, ``ey`` eccentricity
    (dimensionless, below 1) and ``ux``, ``uy`` velocity, both divided by the radial clearance C.
    """
    a = w * ex - 2.0 * uy
    b = w * ey + 2.0 * ux
    m = math.sqrt(a * a + b * b)
    if m == 0.0:
        return 0.0, 0.0
    cos_al, sin_al = -a / m, -b / m
    s = 1.0 - (ex * ex + ey * ey)
    root = math.sqrt(s)
    h = ey * cos_al - ex * sin_al
    g = 2.0 / root * (0.5 * math.pi + math.atan(h / root))
    v = (2.0 + h * g) / s
    c = ex * cos_al + ey * sin_al
    big_s = c / (1.0 - c * c)
    f = -coefficient * m / s
    return (
        f * (3.0 * ex * v - sin_al * g - 2.0 * cos_al * big_s),
        f * (3.0 * ey * v + cos_al * g - 2.0 * sin_al * big_s),
    )


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def evaluate_bearing(constants, bearing, gear, w, x, y, vx, vy, latched, flags, point):
    """Contact (2)-(6) and film of one bearing into ``point``; returns the total force on the gear in N."""
    d = math.sqrt(x * x + y * y)
    nx, ny = 1.0, 0.0
    if d > 0.0:
        nx, ny = x / d, y / d
    delta = d - bearing.clearance
    closing = vx * nx + vy * ny
    force = 0.0
    gap_sign = -1.0
    clamp_value = 1.0
    if flags[CONTACT + gear] == 1:
        gap_sign = 1.0
        if constants.kelvin:
            clamp_value = bearing.kelvin_stiffness * delta + bearing.kelvin_damping * closing
            force = clamp_value
        else:
            depth = max(delta, 0.0)
            clamp_value = 1.0 + bearing.damping_factor * closing / latched
            force = bearing.hertz / math.sqrt(d) * depth * math.sqrt(depth) * clamp_value
        if flags[CLAMPED + gear] == 1:
            force = 0.0
            clamp_value = -clamp_value
    fx, fy = -force * nx, -force * ny
    point[PENETRATION + gear] = delta
    point[CLOSING + gear] = closing
    point[CONTACT_X + gear] = fx
    point[CONTACT_Y + gear] = fy
    point[VALUE + BEARING_GAP + gear] = gap_sign * delta
    point[RATE + BEARING_GAP + gear] = gap_sign * closing
    point[VALUE + BEARING_CLAMP + gear] = clamp_value
    if constants.film:
        c = bearing.oil_clearance
        eps2 = d * d / (c * c)
        margin, margin_rate = constants.eccentricity_limit2 - eps2, -2.0 * d * closing / (c * c)
        # Before the event is located a trial step may overshoot the limit, yet never the wall.
        bound2 = 0.5 * (1.0 + constants.eccentricity_limit2)
        starved = flags[STARVED + gear] == 1
        if starved:
            bound2 = constants.eccentricity_limit2
            margin, margin_rate = -margin, -margin_rate
        ex, ey = x / c, y / c
        if starved or eps2 > bound2:
            scale = math.sqrt(bound2 / eps2)
            ex, ey = ex * scale, ey * scale
        film_x, film_y = film_force(bearing.film, w, ex, ey, vx / c, vy / c)
        point[FILM_X + gear] = film_x
        point[FILM_Y + gear] = film_y
        point[VALUE + FILM_LIMIT + gear] = margin
        point[RATE + FILM_LIMIT + gear] = margin_rate
        fx += film_x
        fy += film_y
    return fx, fy


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def evaluate(constants, speed, load, y, flags, exc, lag, point):
    """Right-hand side at state ``y`` with ``flags`` frozen, and the events' values, into ``point``.

    ``speed`` set-point in rad/s and ``load`` commanded load torque in N m; ``exc`` (EXCITATIONS,) excitations at
    a phase that ``y`` is ahead of by ``lag`` rad of mesh phase. (21)-(32).
    """
    x1, y1, x2, y2 = y[X1], y[Y1], y[X2], y[Y2]
    vx1, vy1, vx2, vy2 = y[VX1], y[VY1], y[VX2], y[VY2]
    omega1, omega2 = y[OMEGA1], y[OMEGA2]
    rb1, rb2 = constants.base_radius1, constants.base_radius2
    r_sum = rb1 + rb2

    phase_speed = speed if constants.nominal_phase else omega1
    phi_rate = constants.teeth1 * phase_speed
    half = 0.5 * lag
    z = exc[SURFACE] + lag * (exc[SURFACE_SLOPE] + half * exc[SURFACE_CURVATURE])
    z_rate = phi_rate * (exc[SURFACE_SLOPE] + lag * exc[SURFACE_CURVATURE])
    k1 = constants.stiffness * (1.0 + exc[STIFFNESS] + lag * exc[STIFFNESS_SLOPE])
    e = constants.error_mean + exc[ERROR] + lag * (exc[ERROR_SLOPE] + half * exc[ERROR_CURVATURE])
    e_rate = phi_rate * (exc[ERROR_SLOPE] + lag * exc[ERROR_CURVATURE])

    ux, uy = x2 - x1, y2 - y1
    wx, wy = vx2 - vx1, vy2 - vy1
    dx = constants.centre_distance + ux
    a2 = dx * dx + uy * uy
    a = math.sqrt(a2)
    xi = (ux * (2.0 * constants.centre_distance + ux) + uy * uy) / (r_sum * r_sum)
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
    cos_beta, sin_beta = dx / a, uy / a
    cos_alpha = r_sum / a
    sin_alpha = cos_alpha * tan_alpha
    sin_gamma = sin_alpha * cos_beta - cos_alpha * sin_beta
    cos_gamma = cos_alpha * cos_beta + sin_alpha * sin_beta

    a_rate_over_a = (dx * wx + uy * wy) / a2
    beta_rate = (dx * wy - uy * wx) / a2
    b1 = r_sum * involute + constants.half_backlash - 0.5 * z
    b1_rate = r_sum * tan_alpha * a_rate_over_a - 0.5 * z_rate

    u_rate = rb1 * omega1 - rb2 * omega2
    if constants.exact_geometry:
        q = y[U] - r_sum * beta - e
        q_rate = u_rate - r_sum * beta_rate - e_rate
    else:
        gamma_rate = a_rate_over_a / tan_alpha - beta_rate
        q = y[U] - ux * sin_gamma - uy * cos_gamma - e
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
    f1x, f1y = evaluate_bearing(
        constants, constants.bearing1, 0, w1, x1, y1, vx1, vy1, y[IMPACT_SPEED], flags, point
    )
    f2x, f2y = evaluate_bearing(
        constants, constants.bearing2, 1, w2, x2, y2, vx2, vy2, y[IMPACT_SPEED + 1], flags, point
    )
    load_torque = load
    if constants.brake:
        load_torque = load * math.tanh(omega2)
    load_torque += constants.load_viscous * omega2

    point[AX1] = (f1x - force * along_x) / constants.mass1
    point[AY1] = (f1y - force * along_y) / constants.mass1
    point[AX2] = (f2x + force * along_x) / constants.mass2
    point[AY2] = (f2y + force * along_y) / constants.mass2
    point[ALPHA1] = (y[DRIVE_TORQUE] - force * rb1) / constants.inertia1
    point[ALPHA2] = (force * rb2 - load_torque) / constants.inertia2
    point[VALUE + UPPER_GAP] = upper
    point[RATE + UPPER_GAP] = upper_rate
    point[VALUE + LOWER_GAP] = lower
    point[RATE + LOWER_GAP] = lower_rate
    point[VALUE + MESH_CLAMP] = clamp_value
    point[Q] = q
    point[Q_RATE] = q_rate
    point[MESH_FORCE] = force
    point[TAN_ALPHA] = tan_alpha
    point[HALF_BACKLASH] = b1
    point[BACKLASH_RATE] = b1_rate
    point[LOAD] = load_torque


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def phase_turn(constants, turns, turn):
    """Fraction of the hunting cycle at ``turns`` whole and ``turn`` further turns of gear 1."""
    return (turns + turn) / constants.hunting


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def try_step(constants, commands, table, work, y, flags, phase, start, exc_start, lag_start, h, end, exc_end):
    """Classic RK4 over ``h`` with frozen flags, in Nystrom's form: from ``y`` and its point ``start``.

    ``phase`` is the nominal turn at ``y``. Fills ``work.y_end``, ``end`` and ``exc_end`` (the excitations at the
    phase of stage 4) and returns the lag of the end state behind them in rad of mesh phase. The excitations are
    summed at two phases a step; the stages between differ from those by the square of the step and take them
    by Taylor's series.
    """
    speed, load = commands
    orders, cosines, sines, waves = table
    stage, exc_mid, middle, late = work
    turns = flags[TURN]
    half = 0.5 * h
    rb1, rb2 = constants.base_radius1, constants.base_radius2
    nominal = constants.nominal_phase

    # Stage 2
    for i in range(STATE_SIZE):
        stage[i] = y[i]
    u_rate1 = rb1 * y[OMEGA1] - rb2 * y[OMEGA2]
    for i in range(4):
        stage[X1 + i] = y[X1 + i] + half * y[VX1 + i]
        stage[VX1 + i] = y[VX1 + i] + half * start[AX1 + i]
    stage[U] = y[U] + half * u_rate1
    stage[THETA1] = y[THETA1] + half * y[OMEGA1]
    stage[OMEGA1] = y[OMEGA1] + half * start[ALPHA1]
    stage[OMEGA2] = y[OMEGA2] + half * start[ALPHA2]
    theta_mid = stage[THETA1]
    turn_mid = phase + half * speed * TURNS_PER_RADIAN if nominal else theta_mid * TURNS_PER_RADIAN
    excite(phase_turn(constants, turns, turn_mid), orders, cosines, sines, waves, exc_mid)
    evaluate(constants, speed, load, stage, flags, exc_mid, 0.0, middle)

    # Stage 3
    u_rate2 = rb1 * stage[OMEGA1] - rb2 * stage[OMEGA2]
    omega1_2 = stage[OMEGA1]
    for i in range(4):
        stage[X1 + i] = y[X1 + i] + half * stage[VX1 + i]
        stage[VX1 + i] = y[VX1 + i] + half * middle[AX1 + i]
    stage[U] = y[U] + half * u_rate2
    stage[THETA1] = y[THETA1] + half * omega1_2
    stage[OMEGA1] = y[OMEGA1] + half * middle[ALPHA1]
    stage[OMEGA2] = y[OMEGA2] + half * middle[ALPHA2]
    lag = 0.0 if nominal else constants.teeth1 * half * (omega1_2 - y[OMEGA1])
    evaluate(constants, speed, load, stage, flags, exc_mid, lag, late)

    # Stage 4
    u_rate3 = rb1 * stage[OMEGA1] - rb2 * stage[OMEGA2]
    omega1_3 = stage[OMEGA1]
    sixth = h * h / 6.0
    for i in range(4):
        stage[X1 + i] = y[X1 + i] + h * stage[VX1 + i]
        stage[VX1 + i] = y[VX1 + i] + h * late[AX1 + i]
    stage[U] = y[U] + h * u_rate3
    stage[THETA1] = y[THETA1] + h * omega1_3
    stage[OMEGA1] = y[OMEGA1] + h * late[ALPHA1]
    stage[OMEGA2] = y[OMEGA2] + h * late[ALPHA2]
    theta_end = stage[THETA1]
    turn_end = phase + h * speed * TURNS_PER_RADIAN if nominal else theta_end * TURNS_PER_RADIAN
    excite(phase_turn(constants, turns, turn_end), orders, cosines, sines, waves, exc_end)
    evaluate(constants, speed, load, stage, flags, exc_end, 0.0, end)

    weight = h / 6.0
    for i in range(4):
        pair = middle[AX1 + i] + late[AX1 + i]
        stage[X1 + i] = y[X1 + i] + h * y[VX1 + i] + sixth * (start[AX1 + i] + pair)
        stage[VX1 + i] = y[VX1 + i] + weight * (start[AX1 + i] + 2.0 * pair + end[AX1 + i])
    pair1 = middle[ALPHA1] + late[ALPHA1]
    pair2 = middle[ALPHA2] + late[ALPHA2]
    u_sum = rb1 * (start[ALPHA1] + pair1) - rb2 * (start[ALPHA2] + pair2)
    stage[U] = y[U] + h * u_rate1 + sixth * u_sum
    stage[THETA1] = y[THETA1] + h * y[OMEGA1] + sixth * (start[ALPHA1] + pair1)
    stage[OMEGA1] = y[OMEGA1] + weight * (start[ALPHA1] + 2.0 * pair1 + end[ALPHA1])
    stage[OMEGA2] = y[OMEGA2] + weight * (start[ALPHA2] + 2.0 * pair2 + end[ALPHA2])
    stage[MESH_IMPULSE] = y[MESH_IMPULSE] + weight * (
        start[MESH_FORCE] + 2.0 * (middle[MESH_FORCE] + late[MESH_FORCE]) + end[MESH_FORCE]
    )
    lag_end = 0.0 if nominal else constants.teeth1 * (stage[THETA1] - theta_end)
    evaluate(constants, speed, load, stage, flags, exc_end, lag_end, end)
    return lag_end


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def hermite_root(v0, r0, v1, r1):
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
def crossing(event, start, end, h):
    """Fraction of the step ``h`` at which ``event``, positive at ``start`` and negative at ``end``, is zero."""
    v0, v1 = start[VALUE + event], end[VALUE + event]
    if event == MESH_CLAMP or event == BEARING_CLAMP or event == BEARING_CLAMP + 1:
        return v0 / (v0 - v1)
    return hermite_root(v0, h * start[RATE + event], v1, h * end[RATE + event])


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def first_violated(start, end, h):
    """The event that seems to come first of those whose value is negative at ``end``, or -1."""
    first, earliest = -1, 2.0
    for event in range(EVENT_COUNT):
        if end[VALUE + event] < 0.0:
            at = 0.0
            if start[VALUE + event] > 0.0:
                at = crossing(event, start, end, h)
            if at < earliest:
                first, earliest = event, at
    return first


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def grazing_fraction(start, end, h):
    """Fraction of the step at which a gap seems to close and open again, or 0.

    Looks at gaps that are open at both ends but close at the start and open at the end.
    """
    for event in (UPPER_GAP, LOWER_GAP, BEARING_GAP, BEARING_GAP + 1):
        v0, r0 = start[VALUE + event], h * start[RATE + event]
        r1 = h * end[RATE + event]
        if v0 > 0.0 and r0 < 0.0 and r1 > 0.0 and v0 + r0 < 0.0:
            v1 = end[VALUE + event]
            c2 = 3.0 * (v1 - v0) - 2.0 * r0 - r1
            c3 = 2.0 * (v0 - v1) + r0 + r1
            low, high = 0.0, 1.0
            for _ in range(40):
                s = 0.5 * (low + high)
                if r0 + s * (2.0 * c2 + 3.0 * s * c3) < 0.0:
                    low = s
                else:
                    high = s
            if v0 + low * (r0 + low * (c2 + low * c3)) < 0.0:
                return low
    return 0.0


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def flip(constants, event, y, flags, point):
    """Change the flag that ``event`` stands for; a bearing contact that begins latches its impact speed."""
    if event == UPPER_GAP or event == LOWER_GAP:
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
            y[IMPACT_SPEED + gear] = max(point[CLOSING + gear], constants.minimum_impact_speed)
            flags[IMPACTS] += 1
    elif event < FILM_LIMIT:
        flags[CLAMPED + event - BEARING_CLAMP] = 1 - flags[CLAMPED + event - BEARING_CLAMP]
    else:
        flags[STARVED + event - FILM_LIMIT] = 1 - flags[STARVED + event - FILM_LIMIT]
    flags[EVENTS] += 1


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def settle(constants, commands, event, y, flags, exc, lag, point):
    """Flip ``event`` and, as events fall together, every other one that is past its surface."""
    speed, load = commands
    flip(constants, event, y, flags, point)
    flipped = 1 << event
    for _ in range(EVENT_COUNT):
        evaluate(constants, speed, load, y, flags, exc, lag, point)
        following = -1
        for other in range(EVENT_COUNT):
            if point[VALUE + other] < 0.0 and not (flipped >> other) & 1:
                following = other
                break
        if following < 0:
            return
        flip(constants, following, y, flags, point)
        flipped |= 1 << following


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def locate(constants, commands, table, work, y, flags, phase, start, exc, lag, h, end, exc_end, event, low_point):
    """Shorten the step ``h`` until it ends on the first event; returns (h, event, lag at the end, capped).

    ``event`` is positive at ``start`` and negative at ``end`` on entry. Steps are tried at the root of the cubic
    through both ends of the bracket (of the secant, where no rate is known, weighted after Illinois). A second
    event that turns out to come earlier takes over.
    """
    low, high = 0.0, h
    for i in range(POINT_SIZE):
        low_point[i] = start[i]
    v_high, r_high = end[VALUE + event], end[RATE + event]
    tolerance = EVENT_TOLERANCE * (start[VALUE + event] - v_high)
    weight_low, weight_high, side = 1.0, 1.0, 0
    lag_end = 0.0
    for _ in range(SEARCH_LIMIT):
        v_low, width = low_point[VALUE + event], high - low
        if event == MESH_CLAMP or event == BEARING_CLAMP or event == BEARING_CLAMP + 1:
            a, b = weight_low * v_low, weight_high * v_high
            fraction = a / (a - b)
        else:
            fraction = hermite_root(v_low, width * low_point[RATE + event], v_high, width * r_high)
        at = low + fraction * width
        if not (low < at < high):
            at = 0.5 * (low + high)
        lag_end = try_step(
            constants, commands, table, work, y, flags, phase, start, exc, lag, at, end, exc_end
        )
        earlier = -1
        for other in range(EVENT_COUNT):
            value = end[VALUE + other]
            if other != event and value < 0.0 and low_point[VALUE + other] > 0.0:
                if value < -EVENT_TOLERANCE * (low_point[VALUE + other] - value):
                    earlier = other
        if earlier >= 0:
            event, high = earlier, at
            v_high, r_high = end[VALUE + event], end[RATE + event]
            tolerance = EVENT_TOLERANCE * (low_point[VALUE + event] - v_high)
            weight_low, weight_high, side = 1.0, 1.0, 0
            continue
        value = end[VALUE + event]
        if abs(value) <= tolerance or high - low <= 1e-12 * h:
            return at, event, lag_end, 0
        if value < 0.0:
            high, v_high, r_high = at, value, end[RATE + event]
            weight_high = 1.0
            weight_low = 0.5 * weight_low if side == -1 else 1.0
            side = -1
        else:
            low = at
            for i in range(POINT_SIZE):
                low_point[i] = end[i]
            weight_low = 1.0
            weight_high = 0.5 * weight_high if side == 1 else 1.0
            side = 1
    return at, event, lag_end, 1


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def take_step(constants, commands, table, work, y, flags, phase, points, excs, lag):
    """Advance ``y`` by one step, split at every event; returns the lag of the excitations in ``excs[0]``.

    On entry and return ``points[0]`` is the point of ``y`` and ``excs[0]`` belongs to it with the lag.
    """
    step = constants.step
    done = 0.0
    stops = 0
    h = step
    while True:
        lag_end = try_step(
            constants, commands, table, work, y, flags, phase, points[0], excs[0], lag, h, points[1], excs[1]
        )
        event = -1
        if stops < STOPS_PER_STEP:
            event = first_violated(points[0], points[1], h)
            if event < 0:
                fraction = grazing_fraction(points[0], points[1], h)
                if fraction > SHORTEST_SUBSTEP:
                    h *= fraction
                    stops += 1
                    continue
            elif points[0][VALUE + event] <= 0.0:
                # Just flipped and past its surface again: look for a point before that.
                if h > SHORTEST_SUBSTEP * step:
                    h *= 0.5
                    continue
                flags[CAPPED] += 1
            else:
                h, event, lag_end, capped = locate(
                    constants,
                    commands,
                    table,
                    work,
                    y,
                    flags,
                    phase,
                    points[0],
                    excs[0],
                    lag,
                    h,
                    points[1],
                    excs[1],
                    event,
                    points[2],
                )
                flags[CAPPED] += capped
            stops += 1
            if stops == STOPS_PER_STEP:
                flags[CAPPED] += 1
        for i in range(MECHANICAL + 1):
            y[i] = work[0][i]
        for i in range(POINT_SIZE):
            points[0][i] = points[1][i]
        for i in range(EXCITATIONS):
            excs[0][i] = excs[1][i]
        lag = lag_end
        done += h
        phase += h * commands[0] * TURNS_PER_RADIAN
        if event >= 0:
            settle(constants, commands, event, y, flags, excs[0], lag, points[0])
        h = step - done
        if h <= SHORTEST_SUBSTEP * step:
            break
    if stops >= STOPS_PER_STEP:
        late = first_violated(points[0], points[0], step)
        if late >= 0:
            settle(constants, commands, late, y, flags, excs[0], lag, points[0])
    return lag


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def wrap(constants, y, flags):
    """Bring theta1 back to one revolution and count it; the phase counts modulo the hunting cycle."""
    revolutions = 0
    if y[THETA1] >= TWO_PI:
        y[THETA1] -= TWO_PI
        revolutions = 1
    elif y[THETA1] < 0.0:
        y[THETA1] += TWO_PI
        revolutions = -1
    flags[REVOLUTIONS] += revolutions
    if not constants.nominal_phase:
        flags[TURN] = (flags[TURN] + revolutions) % int(constants.hunting)


@njit(cache=True, error_model="numpy")
def advance_nominal(constants, speed, y, flags):
    """One step of the nominal phase, without the drift of a plain sum (Kahan); must not be contracted."""
    increment = speed * constants.step * TURNS_PER_RADIAN - y[NOMINAL_REST]
    turn = y[NOMINAL_TURN] + increment
    y[NOMINAL_REST] = (turn - y[NOMINAL_TURN]) - increment
    if turn >= 1.0:
        turn -= 1.0
        flags[TURN] = (flags[TURN] + 1) % int(constants.hunting)
    elif turn < 0.0:
        turn += 1.0
        flags[TURN] = (flags[TURN] - 1) % int(constants.hunting)
    y[NOMINAL_TURN] = turn


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def govern(constants, speed, y, interval):
    """PI governor, once a sample: T_M = clip(Kp err + I); I stands still while clipped."""
    error = speed - y[OMEGA1]
    wanted = constants.governor_proportional * error + y[GOVERNOR]
    limit = constants.governor_limit
    y[DRIVE_TORQUE] = min(max(wanted, -limit), limit)
    if -limit <= wanted <= limit:
        y[GOVERNOR] += constants.governor_integral * error * interval


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def write_sample(constants, time, turn, y, flags, point, row, angles):
    """One row of CHANNELS and the accumulated angles of both shafts."""
    row[0] = time
    row[1] = point[Q]
    row[2] = point[Q_RATE]
    row[3] = point[MESH_FORCE]
    row[4] = math.atan(point[TAN_ALPHA])
    row[5] = math.atan2(y[Y2] - y[Y1], constants.centre_distance + y[X2] - y[X1])
    row[6] = point[HALF_BACKLASH]
    row[7] = flags[FLANK]
    for i in range(4):
        row[8 + i] = y[X1 + i]
    for gear in range(2):
        row[12 + 2 * gear] = point[CONTACT_X + gear]
        row[13 + 2 * gear] = point[CONTACT_Y + gear]
        row[16 + 2 * gear] = point[FILM_X + gear]
        row[17 + 2 * gear] = point[FILM_Y + gear]
        row[20 + gear] = point[PENETRATION + gear]
    row[22] = y[OMEGA1]
    row[23] = y[OMEGA2]
    row[24] = y[DRIVE_TORQUE]
    row[25] = point[LOAD]
    row[26] = y[THETA1]
    mesh_turn = constants.teeth1 * turn
    row[27] = TWO_PI * (mesh_turn - math.floor(mesh_turn))
    angles[0] = TWO_PI * flags[REVOLUTIONS] + y[THETA1]
    angles[1] = (constants.base_radius1 * angles[0] - y[U]) / constants.base_radius2


@njit(cache=True, error_model="numpy")
def make_work():
    """Scratch of the integrator: (stage state, excitations, two points)."""
    return np.zeros(STATE_SIZE), np.zeros(EXCITATIONS), np.zeros(POINT_SIZE), np.zeros(POINT_SIZE)


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def open_point(constants, commands, orders, cosines, sines, waves, y, flags, exc, point):
    """Evaluate ``y`` afresh into ``exc`` and ``point``; returns the turn of gear 1 that sets the phase."""
    speed, load = commands
    turn = y[NOMINAL_TURN] if constants.nominal_phase else y[THETA1] * TURNS_PER_RADIAN
    excite(phase_turn(constants, flags[TURN], turn), orders, cosines, sines, waves, exc)
    evaluate(constants, speed, load, y, flags, exc, 0.0, point)
    return turn


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def touch(constants, commands, orders, cosines, sines, y, flags):
    """Set u so that the drive flank just touches (q = b1), in contact if the gap is closing."""
    exc, point, waves = np.zeros(EXCITATIONS), np.zeros(POINT_SIZE), np.zeros((2, orders.shape[0]))
    flags[FLANK] = 0
    y[U] = 0.0
    open_point(constants, commands, orders, cosines, sines, waves, y, flags, exc, point)
    y[U] = point[HALF_BACKLASH] - point[Q]
    if point[RATE + UPPER_GAP] < 0.0:
        flags[FLANK] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def run(constants, commands, orders, cosines, sines, y, flags, first_sample, interval_ns, samples, angles):
    """Integrate and sample: fills ``samples`` (n, 28) and ``angles`` (n, 2), row k the state before sample k's steps.

    ``commands`` (speed, load torque). Changes ``y`` and ``flags`` in place; returns (rows
    written, status). On OVER_SPEED and CENTRES_PRESSED the last row is the state that broke the limit; a
    NON_FINITE state is not written.
    """
    n = samples.shape[0]
    waves = np.zeros((2, orders.shape[0]))
    table = (orders, cosines, sines, waves)
    work = make_work()
    points = np.zeros((3, POINT_SIZE))
    excs = np.zeros((2, EXCITATIONS))
    limit = constants.speed_limit
    interval = constants.step * constants.steps_per_sample
    for row in range(n):
        if constants.governed:
            govern(constants, commands[0], y, interval)
        turn = open_point(constants, commands, orders, cosines, sines, waves, y, flags, excs[0], points[0])
        total = 0.0
        for i in range(MECHANICAL):
            total += y[i] + points[0][AX1 + i % 6]
        if not math.isfinite(total):
            return row, NON_FINITE
        write_sample(
            constants, (first_sample + row) * interval_ns / 1e9, turn, y, flags, points[0], samples[row], angles[row]
        )
        if abs(y[OMEGA1]) > limit or abs(y[OMEGA2]) > limit:
            return row + 1, OVER_SPEED
        if points[0][HALF_BACKLASH] <= 0.0 or flags[PRESSED] == 1:
            return row + 1, CENTRES_PRESSED
        lag = 0.0
        for _ in range(constants.steps_per_sample):
            lag = take_step(
                constants, commands, table, work, y, flags, y[NOMINAL_TURN], points, excs, lag
            )
            wrap(constants, y, flags)
            if constants.nominal_phase:
                advance_nominal(constants, commands[0], y, flags)
            flags[STEPS] += 1
            if points[0][HALF_BACKLASH] <= 0.0:
                flags[PRESSED] = 1
    return n, RUNNING
