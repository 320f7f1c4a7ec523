"""One whole step: substeps, stops at events, and what is due at its end.

See "Integration", A step and Substeps, in docs/model.md.
"""

from __future__ import annotations

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined, uncontracted
from gear_dynamics_ros.physics.kernel.lanes import copy_record, store
from gear_dynamics_ros.physics.kernel.records import (
    EVENT_COUNT,
    TURNS_PER_RADIAN,
    TWO_PI,
    ImpactList,
    KernelRecord,
    Pointer,
)
from gear_dynamics_ros.physics.kernel.search import first_crossed, grazing_fraction, locate_event
from gear_dynamics_ros.physics.kernel.step import trial_off_grid, trial_step
from gear_dynamics_ros.physics.kernel.switches import note_contacts, settle_events
from gear_dynamics_ros.physics.kernel.waves import COSINE, SINE, nudge_waves, rotate_waves, sum_waves

STOPS_PER_STEP = 24
# Each stop, and what is settled late after the last, may end the contacts of both bearings.
IMPACTS_PER_STEP = 2 * (STOPS_PER_STEP + 1)
# Of the step: the shortest substep that the beginning or end of a bearing contact asks for.
GAP_FRACTION = 0.1
# Of the age of a bearing contact: the longest substep.
SHARE_OF_AGE = 0.25
# The largest product of substep and damping rate of a bearing contact; RK4 itself bears 2.78. Hertz contacts
# that began long ago move little: there a whole step bears more.
STIFFNESS_LIMIT = 0.25
SETTLED_STIFFNESS_LIMIT = 1.0
SETTLED_AGE = 500.0  # steps
SUBSTEPS_LIMIT = 4096.0
SHORTEST_SUBSTEP = 1e-9  # of the step


@compiled
def split_step(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    low_end: KernelRecord,
    waves: Pointer,
    amplitudes: Pointer,
    impacts: ImpactList,
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
            trial_off_grid(constants, state, here, end, waves, amplitudes, h)
        tried = False
        event = -1
        if stops < STOPS_PER_STEP:
            event = first_crossed(here, end, h)
            if event < 0:
                fraction = grazing_fraction(here, end, h)
                if fraction > SHORTEST_SUBSTEP:
                    h *= fraction
                    stops += 1
                    continue
            elif here.value[event] > 0.0:
                h, event, capped = locate_event(
                    constants, state, here, end, low_end, waves, amplitudes, h, event
                )
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
        copy_record(end, here)
        note_contacts(state, here, h)
        done += h
        if event >= 0:
            settle_events(constants, event, state, here, impacts)
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
            settle_events(constants, late, state, here, impacts)


@compiled
def longest_substep(constants: KernelRecord, state: KernelRecord, here: KernelRecord) -> float:
    """The step, halved until it bears the damping of the bearing contacts at ``here``.

    A contact that began slowly has a damping coefficient, a k_h delta^1.5 / v_impact, without a bound:
    pressed in later it would overshoot its own resting point.
    """
    rate = max(here.damping[0] * constants.per_mass[0], here.damping[1] * constants.per_mass[1])
    step: float = longest_near_gap(constants, state, here, constants.step)
    age = min(state.contact_age[0], state.contact_age[1])
    settled = age >= SETTLED_AGE * constants.step and not constants.kelvin
    if settled and step * rate <= SETTLED_STIFFNESS_LIMIT:
        return step
    substeps = 1.0
    while step * rate > STIFFNESS_LIMIT * substeps:
        substeps *= 2.0
        if substeps == SUBSTEPS_LIMIT:
            state.capped += 1
            break
    return step / substeps


@compiled
def longest_near_gap(constants: KernelRecord, state: KernelRecord, here: KernelRecord, h: float) -> float:
    """``h``, or less where a bearing contact begins or ends, where delta^1.5 is not smooth.

    No substep is longer than a quarter of the age of a contact, nor than half the time it seems to have left.
    """
    longest = h
    if constants.kelvin:
        return longest
    shortest = GAP_FRACTION * constants.step
    for gear in range(2):
        if state.contact[gear] == 1.0:
            longest = min(longest, max(SHARE_OF_AGE * state.contact_age[gear], shortest))
            opening = -here.penetration_rate[gear]
            if 2.0 * longest * opening > here.penetration[gear]:
                longest = max(0.5 * here.penetration[gear] / opening, min(longest, shortest))
    return longest


@inlined
def advance_step(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    low_end: KernelRecord,
    waves: Pointer,
    amplitudes: Pointer,
    impacts: ImpactList,
    reference_speed: float,
) -> bool:
    """One step; returns whether it ended at ``here`` after a detour, not at ``end``."""
    step = constants.step
    longest = longest_substep(constants, state, here)
    rotate_waves(constants, waves)
    store(end.middle, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    rotate_waves(constants, waves)
    store(end.excitation, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    if longest == step:
        if not trial_step(constants, state, here, end, step, reference_speed):
            note_contacts(state, end, step)
            close_step(constants, state, end, waves, TURNS_PER_RADIAN * end.lead / constants.teeth1)
            return False
    else:
        trial_off_grid(constants, state, here, end, waves, amplitudes, longest)
    grid_turn = here.part_turn + step * reference_speed * TURNS_PER_RADIAN
    split_step(constants, state, here, end, low_end, waves, amplitudes, impacts, longest)
    close_step(constants, state, here, waves, here.part_turn - grid_turn)
    return True


@inlined
def close_step(
    constants: KernelRecord, state: KernelRecord, now: KernelRecord, waves: Pointer, off_grid: float
) -> None:
    """What is due once a step; the state is ``off_grid`` turns of gear 1 ahead of the waves on the grid."""
    wrap_angle(constants, state, now)
    if constants.nominal_phase:
        advance_nominal(constants, state, now)
    else:
        nudge_waves(constants, waves, off_grid / constants.hunting)
    state.steps += 1
    if now.half_backlash <= 0.0:
        state.pressed = 1


@inlined
def wrap_angle(constants: KernelRecord, state: KernelRecord, here: KernelRecord) -> None:
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
            state.whole_turns = (state.whole_turns + revolutions) % constants.hunting
            here.part_turn = TURNS_PER_RADIAN * here.theta1


@uncontracted
def advance_nominal(constants: KernelRecord, state: KernelRecord, here: KernelRecord) -> None:
    """One step of the nominal phase, without the drift of a plain sum (Kahan); must not be contracted."""
    increment = state.speed * constants.step * TURNS_PER_RADIAN - state.nominal_rest
    before = state.nominal_turn
    turn = before + increment
    state.nominal_rest = (turn - before) - increment
    if turn >= 1.0:
        turn -= 1.0
        state.whole_turns = (state.whole_turns + 1) % constants.hunting
    elif turn < 0.0:
        turn += 1.0
        state.whole_turns = (state.whole_turns - 1) % constants.hunting
    state.nominal_turn = turn
    here.part_turn = turn
