"""What an event switches, and how several that fall together are settled.

See "Integration", Switching surfaces and A step, in docs/model.md.
"""

from __future__ import annotations

import math

from gear_dynamics_ros.physics.kernel.columns import (
    IMPACT_BEARING,
    IMPACT_BEGIN,
    IMPACT_END,
    IMPACT_SIZE,
    IMPACT_SPEED,
    PEAK_FORCE,
    REBOUND_SPEED,
)
from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.events import (
    BEARING_CLAMP,
    BEARING_GAP,
    DECIDED_WITH,
    DRIVE_FLANK,
    FLANKS,
    GEAR,
    KIND,
    MESH_CLAMP,
    evaluate_again,
)
from gear_dynamics_ros.physics.kernel.lanes import at_least, load2, store
from gear_dynamics_ros.physics.kernel.records import EVENT_COUNT, ImpactList, KernelRecord


@compiled
def flip_flag(
    constants: KernelRecord, event: int, state: KernelRecord, here: KernelRecord, impacts: ImpactList
) -> None:
    """Change the flag that ``event`` stands for."""
    kind, gear = KIND[event], GEAR[event]
    if kind in FLANKS:
        side = 1.0 if kind == DRIVE_FLANK else -1.0
        state.flank = side if state.flank == 0.0 else 0.0
        state.mesh_clamped = 0.0
        state.flank_changes += 1
    elif kind == MESH_CLAMP:
        state.mesh_clamped = 1.0 - state.mesh_clamped
    elif kind == BEARING_GAP:
        state.clamped[gear] = 0.0
        if state.contact[gear] == 0.0:
            begin_contact(constants, gear, state, here)
        else:
            end_contact(gear, state, here, impacts)
    elif kind == BEARING_CLAMP:
        state.clamped[gear] = 1.0 - state.clamped[gear]
    else:
        state.film_limited[gear] = 1.0 - state.film_limited[gear]
    state.events += 1


@compiled
def begin_contact(constants: KernelRecord, gear: int, state: KernelRecord, here: KernelRecord) -> None:
    """A bearing contact begins and latches its impact speed v of (6)."""
    state.contact[gear] = 1.0
    state.impact_speed[gear] = max(here.penetration_rate[gear], constants.minimum_impact_speed)
    state.closing_speed[gear] = here.penetration_rate[gear]
    state.impact_time[gear] = here.time
    state.contact_age[gear] = 0.0
    state.peak_force2[gear] = 0.0
    state.impacts += 1


@compiled
def end_contact(gear: int, state: KernelRecord, here: KernelRecord, impacts: ImpactList) -> None:
    """A bearing contact ends and enters the list, a row of IMPACTS."""
    state.contact[gear] = 0.0
    rows, at = impacts.rows, IMPACT_SIZE * impacts.call.listed
    rows[at + IMPACT_BEGIN] = state.impact_time[gear]
    rows[at + IMPACT_END] = here.time
    rows[at + IMPACT_BEARING] = gear
    rows[at + IMPACT_SPEED] = state.closing_speed[gear]
    rows[at + REBOUND_SPEED] = -here.penetration_rate[gear]
    rows[at + PEAK_FORCE] = math.sqrt(state.peak_force2[gear])
    impacts.call.listed += 1


@compiled
def settle_events(
    constants: KernelRecord, event: int, state: KernelRecord, here: KernelRecord, impacts: ImpactList
) -> None:
    """Flip ``event`` and, as events fall together, every other one that is past its surface."""
    flip_flag(constants, event, state, here, impacts)
    flipped = DECIDED_WITH[event]
    for _ in range(EVENT_COUNT):
        evaluate_again(constants, state, here)
        following = -1
        for other in range(EVENT_COUNT):
            value, change = here.value[other], here.rate[other]
            # What an earlier stop of this step flipped may still be short of its surface, on its way there.
            if value <= 0.0 and change < 0.0 and not (flipped >> other) & 1:
                following = other
                break
        if following < 0:
            return
        flip_flag(constants, following, state, here, impacts)
        flipped |= DECIDED_WITH[following]


@inlined
def note_contacts(state: KernelRecord, here: KernelRecord, h: float) -> None:
    """Keep the time on each flank, and age and greatest force of both bearings' contacts.

    After a step of ``h`` to ``here``, before flags are flipped there.
    """
    state.drive_time += 0.5 * h * (state.flank * state.flank + state.flank)
    state.back_time += 0.5 * h * (state.flank * state.flank - state.flank)
    force_x, force_y = load2(here.contact_x, 0), load2(here.contact_y, 0)
    store(state.peak_force2, 0, at_least(force_x * force_x + force_y * force_y, load2(state.peak_force2, 0)))
    store(state.contact_age, 0, load2(state.contact_age, 0) + h)
