"""One trial step with frozen flags: RK4 in Nystrom's form, and what it misses of the mesh.

See "Integration" in docs/model.md.
"""

from __future__ import annotations

from typing import Any

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.dynamics import motion_after, right_hand_side
from gear_dynamics_ros.physics.kernel.events import evaluate_point
from gear_dynamics_ros.physics.kernel.impulse import LastStage, add_mesh_impulse
from gear_dynamics_ros.physics.kernel.lanes import any_negative, load2, load8, pointer, store
from gear_dynamics_ros.physics.kernel.mesh import phase_rate, rolling_rate
from gear_dynamics_ros.physics.kernel.records import (
    EVENT_COUNT,
    TURNS_PER_RADIAN,
    KernelRecord,
    Pointer,
    motion_at,
    rates_at,
)
from gear_dynamics_ros.physics.kernel.waves import excite_at


@inlined
def rk4_integral(h: float, first: Any, second: Any, third: Any, fourth: Any) -> Any:
    """Integral over a step of what the four stages of RK4 gave."""
    return h / 6.0 * (first + fourth) + h / 3.0 * (second + third)


@compiled
def trial_step(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    h: float,
    reference_speed: float,
) -> bool:
    """Classic RK4 over ``h`` in s from ``here`` to ``end`` with frozen flags, in Nystrom's form.

    Returns whether a surface may have been crossed: the cubic through its values and rates stays positive
    where its values and those a third of the step along the tangents are.

    ``end`` brings its excitations and those of the middle, for a phase that moves at ``reference_speed`` of
    gear 1, rad/s; the stages lie close to these phases and take the difference by Taylor's series.
    """
    half, third, sixth = 0.5 * h, h / 3.0, h / 6.0
    lead_factor = 0.0 if constants.nominal_phase else constants.teeth1
    start, first = motion_at(here), rates_at(here)

    motion2 = motion_after(constants, start, half, start, first)
    lead = lead_factor * half * (start.omega[0] - reference_speed)
    second, _, _, _, _ = right_hand_side(constants, state, motion2, end.middle, lead)

    motion3 = motion_after(constants, start, half, motion2, second)
    lead = lead_factor * half * (motion2.omega[0] - reference_speed)
    third_rates, teeth, contacts, _, _ = right_hand_side(constants, state, motion3, end.middle, lead)

    motion4 = motion_after(constants, start, h, motion3, third_rates)
    lead = lead_factor * h * (motion3.omega[0] - reference_speed)
    fourth, last_teeth, _, _, _ = right_hand_side(constants, state, motion4, end.excitation, lead)

    # Positions need k1 + k2 + k3 of the accelerations, speeds k1 + 2 k2 + 2 k3 + k4.
    ax, ay = second.ax + third_rates.ax, second.ay + third_rates.ay
    omega_rate = second.omega_rate + third_rates.omega_rate
    mean_omega = start.omega + sixth * (first.omega_rate + omega_rate)
    store(end.x, 0, start.x + h * (start.vx + sixth * (first.ax + ax)))
    store(end.y, 0, start.y + h * (start.vy + sixth * (first.ay + ay)))
    end.u = start.u + h * rolling_rate(constants, mean_omega)
    end.theta1 = here.theta1 + h * mean_omega[0]
    store(end.vx, 0, start.vx + (sixth * (first.ax + fourth.ax) + third * ax))
    store(end.vy, 0, start.vy + (sixth * (first.ay + fourth.ay) + third * ay))
    store(end.omega, 0, start.omega + (sixth * (first.omega_rate + fourth.omega_rate) + third * omega_rate))
    end.mesh_impulse = here.mesh_impulse + rk4_integral(
        h, first.force, second.force, third_rates.force, fourth.force
    )
    end.shaft_work = here.shaft_work + rk4_integral(
        h, first.shaft_power, second.shaft_power, third_rates.shaft_power, fourth.shaft_power
    )
    end.excitation_work = here.excitation_work + rk4_integral(
        h,
        first.excitation_power,
        second.excitation_power,
        third_rates.excitation_power,
        fourth.excitation_power,
    )
    end.mesh_loss = here.mesh_loss + rk4_integral(
        h, first.mesh_loss_rate, second.mesh_loss_rate, third_rates.mesh_loss_rate, fourth.mesh_loss_rate
    )
    contact_loss = rk4_integral(
        h,
        first.contact_loss_rate,
        second.contact_loss_rate,
        third_rates.contact_loss_rate,
        fourth.contact_loss_rate,
    )
    store(end.contact_loss, 0, load2(here.contact_loss, 0) + contact_loss)
    film_work = rk4_integral(
        h, first.film_power, second.film_power, third_rates.film_power, fourth.film_power
    )
    store(end.film_work, 0, load2(here.film_work, 0) + film_work)
    end.time = here.time + h
    end.lead = lead_factor * h * (mean_omega[0] - reference_speed)
    if state.flank != 0.0 and state.mesh_clamped == 0.0:
        taken = rk4_integral(h, first.force, second.force, third_rates.force, fourth.force)
        shifted = h * sixth * (first.force + second.force + third_rates.force)
        phase_rate4 = phase_rate(constants, state, motion4.omega[0])
        stage = LastStage(motion4, fourth, last_teeth, lead, phase_rate4, state.flank)
        rotation = add_mesh_impulse(constants, state, here, end, h, taken, shifted, teeth, contacts, stage)
        end.lead += lead_factor * rotation
    end.part_turn = TURNS_PER_RADIAN * end.theta1
    if constants.nominal_phase:
        end.part_turn = here.part_turn + TURNS_PER_RADIAN * h * state.speed
    leaving = load8(here.value, 0) + third * load8(here.rate, 0)
    last = EVENT_COUNT - 1
    eventful = any_negative(leaving) | (here.value[last] + third * here.rate[last] < 0.0)
    return bool(evaluate_point(constants, state, end, third) | eventful)


@compiled
def trial_off_grid(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    waves: Pointer,
    amplitudes: Pointer,
    h: float,
) -> None:
    """``trial_step`` off the grid of whole steps: the excitations are evaluated where it leads."""
    speed = state.speed if constants.nominal_phase else here.omega[0]
    half_turn = 0.5 * h * speed * TURNS_PER_RADIAN  # what half the step adds
    excite_at(constants, state, waves, amplitudes, here.part_turn + half_turn, pointer(end.middle))
    excite_at(constants, state, waves, amplitudes, here.part_turn + 2.0 * half_turn, pointer(end.excitation))
    trial_step(constants, state, here, end, h, speed)
