"""Teeth in mesh, (21)-(30), see "Mesh" and "Four switches" in docs/model.md."""

from __future__ import annotations

from typing import NamedTuple

from gear_dynamics_ros.physics.kernel.compiling import inlined
from gear_dynamics_ros.physics.kernel.records import (
    Floats,
    KernelRecord,
    Motion,
    Pair,
    Rates,
)
from gear_dynamics_ros.physics.kernel.series import involute_functions, position_angle
from gear_dynamics_ros.physics.kernel.waves import (
    ERROR,
    ERROR_CURVATURE,
    ERROR_SLOPE,
    STIFFNESS,
    STIFFNESS_SLOPE,
    SURFACE_CURVATURE,
    SURFACE_SLOPE,
    surface_at,
)


class MeshForces(NamedTuple):
    """The mesh at one motion."""

    force: float  # N, F_p of (30)
    along_x: float  # d, direction of the force on gear 2
    along_y: float
    q: float  # m, DTE (28)
    q_rate: float  # m/s
    cos_alpha: float  # of the pressure angle (22)
    sin_alpha: float
    half_backlash: float  # m, b_1 of (23)
    half_backlash_rate: float  # m/s
    deflection: float  # m, g of (29)
    deflection_rate: float  # m/s
    stiffness: float  # N/m, k_1 of (24)
    stiffness_rate: float  # N/(m s)
    surface: float  # m, z1 + z2
    surface_rate: float  # m/s
    gradient_x: float  # by how much g falls as gear 2 moves, dimensionless
    gradient_y: float
    dte_gradient_x: float  # by how much q falls
    dte_gradient_y: float
    excitation_power: float  # W, P_k + P_e + P_z of "Energy ledger"
    loss_rate: float  # W, D_m


@inlined
def mesh_forces(
    constants: KernelRecord, state: KernelRecord, motion: Motion, excitation: Floats, lead: float
) -> MeshForces:
    """Teeth in mesh (21)-(30), flags frozen.

    The state is ``lead`` rad of mesh phase ahead of ``excitation``.
    """
    r1, r2 = constants.base_radius[0], constants.base_radius[1]
    r_sum = r1 + r2
    half = 0.5 * lead
    phi_rate = phase_rate(constants, state, motion.omega[0])
    z, z_rate = surface_at(excitation, lead, phi_rate)
    k1 = constants.stiffness * (1.0 + excitation[STIFFNESS] + lead * excitation[STIFFNESS_SLOPE])
    k1_rate = constants.stiffness * phi_rate * excitation[STIFFNESS_SLOPE]
    e_moving = excitation[ERROR] + lead * (excitation[ERROR_SLOPE] + half * excitation[ERROR_CURVATURE])
    e = constants.error_mean + e_moving
    e_rate = phi_rate * (excitation[ERROR_SLOPE] + lead * excitation[ERROR_CURVATURE])

    shift_x, shift_y = motion.x[1] - motion.x[0], motion.y[1] - motion.y[0]
    shift_x_rate, shift_y_rate = motion.vx[1] - motion.vx[0], motion.vy[1] - motion.vy[0]
    dx = constants.centre_distance + shift_x
    a2_change = shift_x * (constants.centre_distance + dx) + shift_y * shift_y  # a^2 - a_s^2
    tan2_change = a2_change * (constants.per_radii * constants.per_radii)
    involute, cos_alpha, sin_alpha, cot_alpha = involute_functions(constants, tan2_change)
    per_a = cos_alpha * constants.per_radii
    cos_beta, sin_beta = dx * per_a, shift_y * per_a
    sin_gamma = sin_alpha * cos_beta - cos_alpha * sin_beta
    cos_gamma = cos_alpha * cos_beta + sin_alpha * sin_beta
    a_rate = cos_beta * shift_x_rate + sin_beta * shift_y_rate
    beta_rate = (cos_beta * shift_y_rate - sin_beta * shift_x_rate) * per_a
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
        gradient_x, gradient_y = along_x, along_y
        dte_gradient_x, dte_gradient_y = -cos_alpha * sin_beta, cos_alpha * cos_beta
    else:
        gamma_rate = (a_rate * per_a) * cot_alpha - beta_rate
        q = (motion.u - e) - shift_x * sin_gamma - shift_y * cos_gamma
        q_rate = (u_rate - e_rate) - shift_x_rate * sin_gamma - shift_y_rate * cos_gamma
        q_rate -= gamma_rate * (shift_x * cos_gamma - shift_y * sin_gamma)
        dte_gradient_x, dte_gradient_y = along_x, along_y
        gradient_x = along_x + flank * sin_alpha * cos_beta
        gradient_y = along_y + flank * sin_alpha * sin_beta

    touching = abs(flank)
    side = flank + (1.0 - touching)
    deflection = touching * (q - flank * b1)
    deflection_rate = q_rate - side * b1_rate
    elastic = k1 * deflection
    if constants.contact_damping:
        force = (touching - state.mesh_clamped) * (elastic + constants.damping * deflection_rate)
    else:
        force = elastic + constants.damping * q_rate
    return MeshForces(
        force=force,
        along_x=along_x,
        along_y=along_y,
        q=q,
        q_rate=q_rate,
        cos_alpha=cos_alpha,
        sin_alpha=sin_alpha,
        half_backlash=b1,
        half_backlash_rate=b1_rate,
        deflection=deflection,
        deflection_rate=deflection_rate,
        stiffness=k1,
        stiffness_rate=k1_rate,
        surface=z,
        surface_rate=z_rate,
        gradient_x=gradient_x,
        gradient_y=gradient_y,
        dte_gradient_x=dte_gradient_x,
        dte_gradient_y=dte_gradient_y,
        excitation_power=0.5 * k1_rate * deflection * deflection - force * (e_rate - 0.5 * side * z_rate),
        loss_rate=(force - elastic) * deflection_rate,
    )


@inlined
def phase_rate(constants: KernelRecord, state: KernelRecord, omega1: float) -> float:
    """Rate of the mesh phase phi, rad/s, from the speed of gear 1 in rad/s; see "Frame, state, phase"."""
    speed = state.speed if constants.nominal_phase else omega1
    rate: float = constants.teeth1 * speed
    return rate


@inlined
def rolling_rate(constants: KernelRecord, omega: Pair) -> float:
    """Rate of u in m/s from the speeds of the shafts, or its acceleration from theirs."""
    value: float = constants.base_radius[0] * omega[0] - constants.base_radius[1] * omega[1]
    return value


@inlined
def push_rate(
    constants: KernelRecord, state: KernelRecord, point: KernelRecord, teeth: MeshForces, rates: Rates
) -> float:
    """Rate of the unclamped mesh force in contact, N/s.

    Up to products of the centres' speeds, which are some 1e-5 of it.
    """
    excitation = point.excitation
    phi_rate = phase_rate(constants, state, point.omega[0])
    phi_acceleration = constants.teeth1 * rates.omega_rate[0]
    if constants.nominal_phase:
        phi_acceleration = 0.0
    phi_rate2 = phi_rate * phi_rate
    z = phi_rate2 * excitation[SURFACE_CURVATURE] + phi_acceleration * excitation[SURFACE_SLOPE]
    e = phi_rate2 * excitation[ERROR_CURVATURE] + phi_acceleration * excitation[ERROR_SLOPE]
    ax, ay = rates.ax[1] - rates.ax[0], rates.ay[1] - rates.ay[0]
    acceleration = rolling_rate(constants, rates.omega_rate) - teeth.gradient_x * ax - teeth.gradient_y * ay
    acceleration += 0.5 * state.flank * z - e
    return float(
        teeth.stiffness_rate * teeth.deflection
        + teeth.stiffness * teeth.deflection_rate
        + constants.damping * acceleration
    )
