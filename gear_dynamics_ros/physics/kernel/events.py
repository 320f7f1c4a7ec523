"""Switching surfaces: the table of events, their values and rates.

See "Integration", Switching surfaces, in docs/model.md.
"""

from __future__ import annotations

from typing import NamedTuple

from gear_dynamics_ros.physics.kernel.bearing import bearing_clamp_rate
from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.dynamics import right_hand_side
from gear_dynamics_ros.physics.kernel.lanes import any_negative, load2, store
from gear_dynamics_ros.physics.kernel.mesh import MeshForces, push_rate
from gear_dynamics_ros.physics.kernel.records import (
    EVENT_COUNT,
    KernelRecord,
    Pair,
    Rates,
    motion_at,
    store_rates,
)

# Kinds of switching surfaces. A surface's value is positive on the side its flag stands for.
DRIVE_FLANK, BACK_FLANK, BEARING_GAP, MESH_CLAMP, BEARING_CLAMP, FILM_LIMIT = range(6)
FLANKS = (DRIVE_FLANK, BACK_FLANK)
BOTH_GEARS = -1

# Of the change of a value over its step. A gap may open onto a jump of the damping force; a clamp is a mere
# kink, where an error in time counts by its square.
GAP_TOLERANCE = 1e-8
CLAMP_TOLERANCE = 1e-6


class SwitchingSurface(NamedTuple):
    """One row of the table of events."""

    kind: int
    gear: int  # 0 driving, 1 driven, BOTH_GEARS
    tolerance: float  # how close to zero it is located, relative to the change of its value over the step


# An event is a row's index. The two gears' rows of a kind follow each other, as their values are lanes.
EVENT_TABLE = (
    SwitchingSurface(DRIVE_FLANK, BOTH_GEARS, GAP_TOLERANCE),
    SwitchingSurface(BACK_FLANK, BOTH_GEARS, GAP_TOLERANCE),
    SwitchingSurface(BEARING_GAP, 0, GAP_TOLERANCE),
    SwitchingSurface(BEARING_GAP, 1, GAP_TOLERANCE),
    SwitchingSurface(MESH_CLAMP, BOTH_GEARS, CLAMP_TOLERANCE),
    SwitchingSurface(BEARING_CLAMP, 0, CLAMP_TOLERANCE),
    SwitchingSurface(BEARING_CLAMP, 1, CLAMP_TOLERANCE),
    SwitchingSurface(FILM_LIMIT, 0, GAP_TOLERANCE),
    SwitchingSurface(FILM_LIMIT, 1, GAP_TOLERANCE),
)


def _first_of(kind: int) -> int:
    """Event of ``kind`` that comes first in the table."""
    return [surface.kind for surface in EVENT_TABLE].index(kind)


def _decided_with(event: int) -> int:
    """Bits of the events that one stop decides together with ``event``: itself, and of a gap its clamp.

    Where a contact begins or ends without damping, gap and clamp are the same surface, and rounding alone
    would say on which side of the clamp the state lies.
    """
    clamp_of = {DRIVE_FLANK: MESH_CLAMP, BACK_FLANK: MESH_CLAMP, BEARING_GAP: BEARING_CLAMP}
    kind, gear, _ = EVENT_TABLE[event]
    clamp = (clamp_of.get(kind), gear)
    return sum(1 << n for n, other in enumerate(EVENT_TABLE) if n == event or other[:2] == clamp)


# The table by columns, as compiled functions read it.
KIND = tuple(surface.kind for surface in EVENT_TABLE)
GEAR = tuple(surface.gear for surface in EVENT_TABLE)
TOLERANCE = tuple(surface.tolerance for surface in EVENT_TABLE)
DECIDED_WITH = tuple(_decided_with(event) for event in range(EVENT_COUNT))

DRIVE_FLANK_EVENT = _first_of(DRIVE_FLANK)
BACK_FLANK_EVENT = _first_of(BACK_FLANK)
MESH_CLAMP_EVENT = _first_of(MESH_CLAMP)
BEARING_GAP_EVENTS = _first_of(BEARING_GAP)  # and the next, as below
BEARING_CLAMP_EVENTS = _first_of(BEARING_CLAMP)
FILM_LIMIT_EVENTS = _first_of(FILM_LIMIT)


@inlined
def store_events(point: KernelRecord, event: int, value: Pair, rate: Pair, before: float) -> bool:
    """Store both bearings' ``event``; whether a value is negative, or was ``before`` s ago by its rate."""
    store(point.value, event, value)
    store(point.rate, event, rate)
    return bool(any_negative(value) | any_negative(value - before * rate))


@inlined
def store_mesh_events(
    constants: KernelRecord,
    state: KernelRecord,
    point: KernelRecord,
    teeth: MeshForces,
    rates: Rates,
    before: float,
) -> bool:
    """The flanks' gaps, and what would make the mesh pull, as ``store_events`` does."""
    b1, b1_rate, flank = teeth.half_backlash, teeth.half_backlash_rate, state.flank
    drive, drive_rate = b1 - teeth.q, b1_rate - teeth.q_rate
    back, back_rate = teeth.q + b1, teeth.q_rate + b1_rate
    clamp, clamp_rate = 1.0, 0.0
    if flank > 0.0:
        drive, drive_rate, back, back_rate = -drive, -drive_rate, 1.0, 0.0
    elif flank < 0.0:
        drive, drive_rate, back, back_rate = 1.0, 0.0, -back, -back_rate
    if constants.contact_damping and flank != 0.0:
        sign = flank * (1.0 - 2.0 * state.mesh_clamped)
        clamp = sign * (teeth.stiffness * teeth.deflection + constants.damping * teeth.deflection_rate)
        clamp_rate = sign * push_rate(constants, state, point, teeth, rates)
    point.value[DRIVE_FLANK_EVENT], point.rate[DRIVE_FLANK_EVENT] = drive, drive_rate
    point.value[BACK_FLANK_EVENT], point.rate[BACK_FLANK_EVENT] = back, back_rate
    point.value[MESH_CLAMP_EVENT], point.rate[MESH_CLAMP_EVENT] = clamp, clamp_rate
    earlier_gaps = min(drive - before * drive_rate, back - before * back_rate)
    least = min(min(drive, back), min(clamp, clamp - before * clamp_rate))
    return bool((least < 0.0) | (earlier_gaps < 0.0))


@inlined
def evaluate_point(constants: KernelRecord, state: KernelRecord, point: KernelRecord, before: float) -> bool:
    """``right_hand_side`` at ``point``, kept there with the events' values and rates.

    Returns whether an event's value is negative, or was ``before`` s ago by its rate.
    """
    motion = motion_at(point)
    rates, teeth, contacts, oil, load = right_hand_side(
        constants, state, motion, point.excitation, point.lead
    )
    store_rates(point, rates)
    point.q, point.q_rate = teeth.q, teeth.q_rate
    point.cos_alpha, point.sin_alpha = teeth.cos_alpha, teeth.sin_alpha
    point.half_backlash, point.load = teeth.half_backlash, load
    point.surface, point.surface_rate = teeth.surface, teeth.surface_rate
    point.deflection, point.deflection_rate = teeth.deflection, teeth.deflection_rate
    point.stiffness, point.stiffness_rate = teeth.stiffness, teeth.stiffness_rate
    point.mesh_energy = 0.5 * teeth.stiffness * teeth.deflection * teeth.deflection
    store(point.penetration, 0, contacts.penetration)
    store(point.penetration_rate, 0, contacts.penetration_rate)
    store(point.contact_x, 0, contacts.force_x)
    store(point.contact_y, 0, contacts.force_y)
    store(point.damping, 0, contacts.damping)
    store(point.film_x, 0, oil.force_x)
    store(point.film_y, 0, oil.force_y)
    crossed = store_mesh_events(constants, state, point, teeth, rates, before)
    side = 2.0 * load2(state.contact, 0) - 1.0
    crossed |= store_events(
        point, BEARING_GAP_EVENTS, side * contacts.penetration, side * contacts.penetration_rate, before
    )
    clamp_rate = bearing_clamp_rate(constants, state, motion, rates, contacts)
    crossed |= store_events(point, BEARING_CLAMP_EVENTS, contacts.clamp, clamp_rate, before)
    crossed |= store_events(point, FILM_LIMIT_EVENTS, oil.margin, oil.margin_rate, before)
    return crossed


@compiled
def evaluate_again(constants: KernelRecord, state: KernelRecord, here: KernelRecord) -> None:
    """``evaluate_point``, kept apart so that a rare call does not swell its caller."""
    evaluate_point(constants, state, here, 0.0)
