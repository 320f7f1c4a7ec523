"""Where in a step the first event falls: roots of cubic Hermite polynomials.

See "Integration", A step, in docs/model.md.
"""

from __future__ import annotations

from gear_dynamics_ros.physics.kernel.compiling import compiled
from gear_dynamics_ros.physics.kernel.events import TOLERANCE
from gear_dynamics_ros.physics.kernel.lanes import copy_record
from gear_dynamics_ros.physics.kernel.records import EVENT_COUNT, KernelRecord, Pointer
from gear_dynamics_ros.physics.kernel.step import trial_off_grid

SEARCH_LIMIT = 30  # trials; the last half of them bisect


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
def first_crossed(here: KernelRecord, end: KernelRecord, h: float) -> int:
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
def grazing_fraction(here: KernelRecord, end: KernelRecord, h: float) -> float:
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
def locate_event(
    constants: KernelRecord,
    state: KernelRecord,
    here: KernelRecord,
    end: KernelRecord,
    low_end: KernelRecord,
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
    copy_record(here, low_end)
    low, high = 0.0, h
    v_high, r_high = end.value[event], end.rate[event]
    tolerance = TOLERANCE[event] * (low_end.value[event] - v_high)
    at = h
    for trial in range(SEARCH_LIMIT):
        width = high - low
        v_low, r_low = low_end.value[event], low_end.rate[event]
        fraction = hermite_root(v_low, width * r_low, v_high, width * r_high)
        at = low + fraction * width
        if not (low < at < high) or trial >= SEARCH_LIMIT // 2:
            at = 0.5 * (low + high)
        trial_off_grid(constants, state, here, end, waves, amplitudes, at)
        earlier = -1
        for other in range(EVENT_COUNT):
            v0, v1 = low_end.value[other], end.value[other]
            if other != event and v0 > 0.0 and v1 < -TOLERANCE[other] * (v0 - v1):
                earlier = other
        if earlier >= 0:
            event, high = earlier, at
            v_high, r_high = end.value[event], end.rate[event]
            tolerance = TOLERANCE[event] * (low_end.value[event] - v_high)
            continue
        value = end.value[event]
        if abs(value) <= tolerance or width <= 1e-12 * h:
            return at, event, 0
        if value < 0.0:
            high, v_high, r_high = at, value, end.rate[event]
        else:
            low = at
            copy_record(end, low_end)
    return at, event, 1
