"""Contact of the gears' shafts with their sleeves, (1)-(6), see "Bearing contact" in docs/model.md."""

from __future__ import annotations

import math
from typing import NamedTuple

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.lanes import at_least, load2, square_root
from gear_dynamics_ros.physics.kernel.records import TINY, KernelRecord, Motion, Pair, Rates


class BearingForces(NamedTuple):
    """Both bearings' contacts."""

    force_x: Pair  # N, on the gear, -F_b n
    force_y: Pair
    normal_x: Pair  # n, from the bearing's centre to the journal's
    normal_y: Pair
    penetration: Pair  # m, delta
    penetration_rate: Pair  # m/s
    damping: Pair  # N s/m
    clamp: Pair  # positive while the contact pushes: N (Kelvin) or dimensionless (Hertz)
    loss_rate: Pair  # W, D_i of "Energy ledger"


@inlined
def bearing_forces(constants: KernelRecord, state: KernelRecord, motion: Motion) -> BearingForces:
    """Contacts of both bearings, flags frozen: Kelvin, or Hertz with restitution (2), (6)."""
    d = square_root(motion.x * motion.x + motion.y * motion.y)
    inverse_d = 1.0 / at_least(d, TINY)
    nx, ny = motion.x * inverse_d, motion.y * inverse_d
    penetration = d - load2(constants.clearance, 0)
    penetration_rate = motion.vx * nx + motion.vy * ny
    contact, clamped = load2(state.contact, 0), load2(state.clamped, 0)
    if constants.kelvin:
        elastic = load2(constants.kelvin_stiffness, 0) * penetration
        damping = load2(constants.kelvin_damping, 0)
        total = elastic + damping * penetration_rate
        clamp = total
    else:
        depth = at_least(penetration, 0.0)
        elastic = load2(constants.hertz, 0) * depth * square_root(depth * d) * inverse_d
        per_speed = load2(constants.damping_factor, 0) / load2(state.impact_speed, 0)
        damping = elastic * per_speed
        clamp = 1.0 + per_speed * penetration_rate
        total = elastic * clamp
    force = (contact - clamped) * total
    return BearingForces(
        force_x=-force * nx,
        force_y=-force * ny,
        normal_x=nx,
        normal_y=ny,
        penetration=penetration,
        penetration_rate=penetration_rate,
        damping=contact * damping,
        clamp=(1.0 - contact) + (contact - 2.0 * clamped) * clamp,
        loss_rate=(force - contact * elastic) * penetration_rate,
    )


@inlined
def bearing_clamp_rate(
    constants: KernelRecord, state: KernelRecord, motion: Motion, rates: Rates, contacts: BearingForces
) -> Pair:
    """Rate of the bearing contacts' ``clamp``, from the accelerations ``rates``."""
    inverse_d = 1.0 / at_least(contacts.penetration + load2(constants.clearance, 0), TINY)
    along = (rates.ax * motion.x + rates.ay * motion.y) * inverse_d
    speed2 = motion.vx * motion.vx + motion.vy * motion.vy
    penetration_acceleration = (
        along + (speed2 - contacts.penetration_rate * contacts.penetration_rate) * inverse_d
    )
    if constants.kelvin:
        stiffness, damping = load2(constants.kelvin_stiffness, 0), load2(constants.kelvin_damping, 0)
        rate = stiffness * contacts.penetration_rate + damping * penetration_acceleration
    else:
        rate = load2(constants.damping_factor, 0) / load2(state.impact_speed, 0) * penetration_acceleration
    return (load2(state.contact, 0) - 2.0 * load2(state.clamped, 0)) * rate


@compiled
def elastic_energy(constants: KernelRecord, state: KernelRecord, here: KernelRecord, gear: int) -> float:
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
