"""What RK4 misses of the mesh force over a step, and what the bearing contacts make of it.

See "Mesh impulse" in docs/model.md, whose letters are used here.
"""

from __future__ import annotations

from typing import NamedTuple

from gear_dynamics_ros.physics.kernel.bearing import BearingForces
from gear_dynamics_ros.physics.kernel.compiling import inlined
from gear_dynamics_ros.physics.kernel.lanes import both, load2, store
from gear_dynamics_ros.physics.kernel.mesh import MeshForces, rolling_rate
from gear_dynamics_ros.physics.kernel.records import Floats, KernelRecord, Motion, Pair, Rates
from gear_dynamics_ros.physics.kernel.waves import (
    ERROR_CURVATURE,
    ERROR_SLOPE,
    STIFFNESS,
    STIFFNESS_SLOPE,
    SURFACE,
    SURFACE_CURVATURE,
    SURFACE_SLOPE,
)


class LastStage(NamedTuple):
    """Fourth stage of RK4: close to the end of the step, off by the third power of its length."""

    motion: Motion
    rates: Rates
    teeth: MeshForces
    lead: float  # rad of mesh phase ahead of the excitations at the end
    phase_rate: float  # rad/s
    flank: float


class Phase(NamedTuple):
    """Mesh phase at start, middle and end of a step: cubic between the ends."""

    rate: float  # rad/s, at the start
    rate_middle: float
    rate_end: float
    acceleration: float  # rad/s^2, at the start
    acceleration_middle: float
    acceleration_end: float
    lead_middle: float  # rad ahead of the excitations
    lead_end: float


class Rise(NamedTuple):
    """What the surfaces add to the deflection, s = f z / 2, over a step from t = 0 to h."""

    start: float  # m
    middle: float
    end: float
    start_rate: float  # m/s
    middle_rate: float
    end_rate: float
    integral: float  # m s, of s
    moment: float  # m s^2, of (h - t) s
    second_moment: float  # m s^3, of (h - t)^2 s / 2
    skew: float  # m, of -tau s over tau = t/h - 1/2
    spread: float  # m, of tau^2 s


class Deflection(NamedTuple):
    """The deflection without the surfaces, w = g - s, over a step, its stiffness, and what is damped."""

    start: float  # m
    middle: float
    end: float
    start_rate: float  # m/s
    end_rate: float
    stiffness: float  # N/m, at the start
    stiffness_middle: float
    stiffness_end: float
    stiffness_rate: float  # N/(m s), at the start
    stiffness_end_rate: float
    damped_end: float  # m, what the damper has at its ends: g, or the DTE with the damping ``always``
    damped_end_rate: float  # m/s


class Missed(NamedTuple):
    """What RK4 misses of the mesh force: its moments, of (h - t)^n / n! F, less those of the stages."""

    impulse: float  # N s, n = 0
    shift: float  # N s^2, n = 1
    second: float  # N s^3, n = 2 and 3, of the surfaces' share alone
    third: float  # N s^4


@inlined
def phase_over(
    constants: KernelRecord, state: KernelRecord, here: KernelRecord, end: KernelRecord, h: float, last: Rates
) -> Phase:
    """Mesh phase over the step ``h`` from ``here`` to ``end``; ``last`` are the rates near its end."""
    teeth1 = constants.teeth1
    if constants.nominal_phase:
        speed = teeth1 * state.speed
        return Phase(speed, speed, speed, 0.0, 0.0, 0.0, 0.0, end.lead)
    rate, rate_end = teeth1 * here.omega[0], teeth1 * end.omega[0]
    mean = teeth1 * (end.theta1 - here.theta1) / h
    return Phase(
        rate=rate,
        rate_middle=1.5 * mean - 0.25 * (rate + rate_end),
        rate_end=rate_end,
        acceleration=teeth1 * here.omega_rate[0],
        acceleration_middle=(rate_end - rate) / h,
        acceleration_end=teeth1 * last.omega_rate[0],
        lead_middle=0.5 * end.lead + 0.125 * h * (rate - rate_end),
        lead_end=end.lead,
    )


@inlined
def surface_motion(
    excitation: Floats, lead: float, rate: float, acceleration: float, h: float
) -> tuple[float, float, float]:
    """Height z1 + z2, its first derivative times ``h`` and its second times ``h`` squared; m.

    ``lead`` rad of mesh phase ahead of ``excitation``, at this ``rate`` and ``acceleration`` of the phase.
    """
    slope = excitation[SURFACE_SLOPE] + lead * excitation[SURFACE_CURVATURE]
    height = excitation[SURFACE] + 0.5 * lead * (excitation[SURFACE_SLOPE] + slope)
    turn = h * rate
    return height, turn * slope, turn * turn * excitation[SURFACE_CURVATURE] + h * h * acceleration * slope


@inlined
def surface_rise(state: KernelRecord, here: KernelRecord, end: KernelRecord, h: float, phase: Phase) -> Rise:
    """Surfaces over a step, integrated as the polynomial of eighth degree.

    It has their heights and two derivatives at start, middle and end: exact to 1e-7 of the height for waves
    that turn by 2.6 rad in the step.
    """
    z0, a0, b0 = surface_motion(here.excitation, here.lead, phase.rate, phase.acceleration, h)
    zm, am, bm = surface_motion(
        end.middle, phase.lead_middle, phase.rate_middle, phase.acceleration_middle, h
    )
    z1, a1, b1 = surface_motion(end.excitation, phase.lead_end, phase.rate_end, phase.acceleration_end, h)
    z, a, b = z0 + z1, a0 - a1, b0 + b1
    mean = 41.0 / 210.0 * z + 64.0 / 105.0 * zm + a / 70.0 + b / 2520.0 + 2.0 / 315.0 * bm
    spread = 167.0 / 5544.0 * z + 16.0 / 693.0 * zm + 5.0 / 2772.0 * a + b / 22176.0 + bm / 2310.0
    skew = (z0 - z1) / 12.0 + 2.0 / 315.0 * (a0 + a1 - 2.0 * am) + (b0 - b1) / 5040.0
    half = 0.5 * state.flank
    per_step = half / h
    return Rise(
        start=half * z0,
        middle=half * zm,
        end=half * z1,
        start_rate=per_step * a0,
        middle_rate=per_step * am,
        end_rate=per_step * a1,
        integral=half * h * mean,
        moment=half * h * h * (0.5 * mean + skew),
        second_moment=half * h * h * h * (0.125 * mean + 0.5 * (skew + spread)),
        skew=half * skew,
        spread=half * spread,
    )


@inlined
def approach(teeth: MeshForces, x: Pair, y: Pair) -> float:
    """By how much g falls as the centres move by ``x`` and ``y``, m; also of speeds and accelerations."""
    value: float = teeth.gradient_x * (x[1] - x[0]) + teeth.gradient_y * (y[1] - y[0])
    return value


@inlined
def relative_rate(constants: KernelRecord, teeth: MeshForces, vx: Pair, vy: Pair, omega: Pair) -> float:
    """Rate of g in m/s from the speeds of centres and shafts; also its acceleration from theirs."""
    value: float = rolling_rate(constants, omega) - approach(teeth, vx, vy)
    return value


@inlined
def smooth_deflection(
    constants: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    h: float,
    phase: Phase,
    rise: Rise,
    last: LastStage,
) -> Deflection:
    """w from ``here`` to ``end``, where it is that of the ``last`` stage and what their motions differ by.

    In the middle it is the polynomial of fifth degree with values, rates and accelerations at both ends.
    """
    teeth, rates, stiffness = last.teeth, last.rates, constants.stiffness
    x, y = load2(end.x, 0) - last.motion.x, load2(end.y, 0) - last.motion.y
    vx, vy = load2(end.vx, 0) - last.motion.vx, load2(end.vy, 0) - last.motion.vy
    slope = here.excitation[ERROR_SLOPE] + here.lead * here.excitation[ERROR_CURVATURE]
    slope_end = end.excitation[ERROR_SLOPE] + phase.lead_end * end.excitation[ERROR_CURVATURE]
    later = phase.lead_end - last.lead
    stage_slope = slope_end - later * end.excitation[ERROR_CURVATURE]
    moved = end.u - last.motion.u - approach(teeth, x, y) - later * slope_end
    moved_rate = relative_rate(constants, teeth, vx, vy, load2(end.omega, 0) - last.motion.omega)
    moved_rate -= phase.rate_end * slope_end - last.phase_rate * stage_slope

    half_flank = 0.5 * last.flank
    w0, w0_rate = here.deflection - rise.start, here.deflection_rate - rise.start_rate
    w1 = teeth.deflection - half_flank * teeth.surface + moved
    w1_rate = teeth.deflection_rate - half_flank * teeth.surface_rate + moved_rate
    k1 = teeth.stiffness + stiffness * later * end.excitation[STIFFNESS_SLOPE]
    if constants.contact_damping:
        damped, damped_rate = w1 + rise.end, w1_rate + rise.end_rate
    else:
        off_x, off_y = teeth.gradient_x - teeth.dte_gradient_x, teeth.gradient_y - teeth.dte_gradient_y
        damped = teeth.q + moved + off_x * (x[1] - x[0]) + off_y * (y[1] - y[0])
        damped_rate = teeth.q_rate + moved_rate + off_x * (vx[1] - vx[0]) + off_y * (vy[1] - vy[0])
    force = k1 * (w1 + rise.end) + constants.damping * damped_rate

    # Sum of the accelerations at both ends, along the direction at the end; what the turning of that
    # direction adds is the same at both, and follows from the rates.
    accelerations = relative_rate(
        constants,
        teeth,
        load2(here.ax, 0) + rates.ax,
        load2(here.ay, 0) + rates.ay,
        load2(here.omega_rate, 0) + rates.omega_rate,
    )
    accelerations -= phase.rate * phase.rate * here.excitation[ERROR_CURVATURE] + phase.acceleration * slope
    accelerations -= phase.rate_end * phase.rate_end * end.excitation[ERROR_CURVATURE]
    accelerations -= phase.acceleration_end * slope_end + constants.per_mesh_mass * (force - teeth.force)
    straight = relative_rate(
        constants,
        teeth,
        load2(end.vx, 0) - load2(here.vx, 0),
        load2(end.vy, 0) - load2(here.vy, 0),
        load2(end.omega, 0) - load2(here.omega, 0),
    )
    straight -= phase.rate_end * slope_end - phase.rate * slope
    accelerations += 2.0 / h * (w1_rate - w0_rate - straight)
    return Deflection(
        start=w0,
        middle=0.5 * (w0 + w1) + 5.0 / 32.0 * h * (w0_rate - w1_rate) + h * h / 64.0 * accelerations,
        end=w1,
        start_rate=w0_rate,
        end_rate=w1_rate,
        stiffness=here.stiffness,
        stiffness_middle=stiffness
        * (1.0 + end.middle[STIFFNESS] + phase.lead_middle * end.middle[STIFFNESS_SLOPE]),
        stiffness_end=k1,
        stiffness_rate=here.stiffness_rate,
        stiffness_end_rate=stiffness * phase.rate_end * end.excitation[STIFFNESS_SLOPE],
        damped_end=damped,
        damped_end_rate=damped_rate,
    )


@inlined
def sixth_order(
    h: float, start: float, middle: float, end: float, start_rate: float, end_rate: float
) -> float:
    """Integral over a step of the polynomial through three values and two rates."""
    return h * (7.0 * (start + end) + 16.0 * middle) / 30.0 + h * h / 60.0 * (start_rate - end_rate)


@inlined
def ripple_beyond(constants: KernelRecord, h: float, rise: Rise, damping: float, stiffness: float) -> float:
    """Integral of the surfaces' quick ripple of w, less what ``sixth_order`` makes of it; m s."""
    push_start = damping * rise.start_rate + stiffness * rise.start
    push_end = damping * rise.end_rate + stiffness * rise.end
    end = damping * (rise.integral - h * rise.start) + stiffness * rise.moment
    end_rate = damping * (rise.end - rise.start) + stiffness * rise.integral
    integral = damping * (rise.moment - 0.5 * h * h * rise.start) + stiffness * rise.second_moment
    middle = 0.5 * end - 5.0 / 32.0 * h * end_rate + h * h / 64.0 * (push_start + push_end)
    beyond: float = constants.per_mesh_mass * (sixth_order(h, 0.0, middle, end, 0.0, end_rate) - integral)
    return beyond


@inlined
def missed_moments(
    constants: KernelRecord,
    here: KernelRecord,
    h: float,
    taken: float,
    shifted: float,
    rise: Rise,
    w: Deflection,
) -> Missed:
    """The moments of F = k (w + s) + c d(w + s)/dt less ``taken`` in N s and ``shifted`` in N s^2."""
    c, mu, km = constants.damping, constants.per_mesh_mass, w.stiffness_middle
    rough = c if constants.contact_damping else 0.0
    beyond = ripple_beyond(constants, h, rise, rough, km)
    p0, p1 = w.stiffness * w.start, w.stiffness_end * w.end
    p0_rate = w.stiffness_rate * w.start + w.stiffness * w.start_rate
    p1_rate = w.stiffness_end_rate * w.end + w.stiffness_end * w.end_rate
    rising = w.stiffness_end - w.stiffness
    bowed = w.stiffness_end + w.stiffness - 2.0 * km

    elastic = sixth_order(h, p0, km * w.middle, p1, p0_rate, p1_rate)
    elastic += km * (beyond + rise.integral) + h * (2.0 * bowed * rise.spread - rising * rise.skew)
    moment = 0.5 * h * elastic + h * h * (0.1 * (p0 - p1) + h / 120.0 * (p0_rate + p1_rate))
    moment += h * h * (km * rise.skew - rising * rise.spread)
    if constants.contact_damping:
        damped = here.deflection
        integral = sixth_order(h, w.start, w.middle, w.end, w.start_rate, w.end_rate)
        integral += beyond + rise.integral
    else:
        damped = here.q
        integral = 0.5 * h * (here.q + w.damped_end) + h * h / 12.0 * (here.q_rate - w.damped_end_rate)
    shift = c * (integral - h * damped) + moment - shifted
    impulse = c * (w.damped_end - damped) + elastic - taken
    # What the shift and the impulse themselves change of w at the end.
    impulse -= mu * (c + 0.5 * h * km) * shift
    impulse += 0.1 * h * h * km * mu * impulse

    push = rough * rise.start_rate + km * rise.start
    push_middle = rough * rise.middle_rate + km * rise.middle
    second = rough * (rise.moment - 0.5 * h * h * rise.start) + km * rise.second_moment
    third = rise.second_moment - h * h * h * (rise.start / 6.0 + h / 24.0 * rise.start_rate)
    return Missed(impulse, shift, second - h * h * h / 12.0 * (push + push_middle), rough * third)


@inlined
def add_mesh_impulse(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    h: float,
    taken: float,
    shifted: float,
    middle: MeshForces,
    contacts: BearingForces,
    last: LastStage,
) -> float:
    """Add what RK4 missed of the mesh force from ``here`` to ``end``; returns how far it turns gear 1, rad.

    The stages' integral of that force was ``taken``, N s, its double integral ``shifted``, N s^2; ``middle``
    and ``contacts`` are those of the third stage.
    """
    phase = phase_over(constants, state, here, end, h, last.rates)
    rise = surface_rise(state, here, end, h, phase)
    w = smooth_deflection(constants, here, end, h, phase, rise, last)
    missed = missed_moments(constants, here, h, taken, shifted, rise, w)
    impulse, shift = missed.impulse, missed.shift
    per_mass = load2(constants.per_mass, 0)
    per_inertia = load2(constants.base_radius, 0) * load2(constants.per_inertia, 0)
    speed_change, displacement = both(-impulse, impulse) * per_mass, both(-shift, shift) * per_mass
    rotation = both(-shift, shift) * per_inertia

    # A contact's damping answers to the shift, and the more terms of it the stiffer it is.
    nx, ny = contacts.normal_x, contacts.normal_y
    rate = per_mass * (load2(state.contact, 0) - load2(state.clamped, 0)) * contacts.damping
    share = both(-1.0, 1.0) * per_mass * (nx * middle.along_x + ny * middle.along_y)
    slowed = share * rate * (rate * (missed.second - rate * missed.third) - shift)
    held = share * rate * (rate * missed.third - missed.second)

    store(end.vx, 0, load2(end.vx, 0) + speed_change * middle.along_x + slowed * nx)
    store(end.vy, 0, load2(end.vy, 0) + speed_change * middle.along_y + slowed * ny)
    store(end.omega, 0, load2(end.omega, 0) + both(-impulse, impulse) * per_inertia)
    store(end.x, 0, load2(end.x, 0) + displacement * middle.along_x + held * nx)
    store(end.y, 0, load2(end.y, 0) + displacement * middle.along_y + held * ny)
    end.u += rolling_rate(constants, rotation)
    end.theta1 += rotation[0]
    end.mesh_impulse += impulse
    return float(rotation[0])
