"""Integration by periods of the mesh: Poincaré section, and extremes over all steps."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from gear_dynamics_ros.physics.kernel.columns import CENTRES_PRESSED, NON_FINITE, OVER_SPEED, RUNNING
from gear_dynamics_ros.physics.kernel.compiling import compiled, entry_point
from gear_dynamics_ros.physics.kernel.dynamics import govern
from gear_dynamics_ros.physics.kernel.entry import open_point
from gear_dynamics_ros.physics.kernel.lanes import pointer
from gear_dynamics_ros.physics.kernel.output import is_finite, write_sample
from gear_dynamics_ros.physics.kernel.records import (
    END,
    HERE,
    LOW,
    TWO_PI,
    Floats,
    ImpactList,
    KernelRecord,
    copy_motion,
)
from gear_dynamics_ros.physics.kernel.substeps import advance_step
from gear_dynamics_ros.physics.kernel.waves import REFRESH_STEPS

# Columns of the section: DTE (m) and its rate (m/s) at mesh phase 0, and how far the phase is from 0 (rad).
SECTION_COLUMNS = 3
# Rows of the extremes; those of a gear stand side by side.
DTE, MESH_FORCE, PENETRATION, CONTACT_FORCE, BEARING_FORCE = 0, 1, 2, 4, 6
EXTREME_COUNT = 8
MINIMUM, MAXIMUM, SUM = range(3)  # columns


@compiled
def note_extreme(extremes: Floats, row: int, value: float) -> None:
    """Take ``value`` into one row of the extremes."""
    extremes[row, MINIMUM] = min(extremes[row, MINIMUM], value)
    extremes[row, MAXIMUM] = max(extremes[row, MAXIMUM], value)
    extremes[row, SUM] += value


@compiled
def note_extremes(here: KernelRecord, extremes: Floats) -> None:
    """Take a point of the trajectory into all rows of the extremes, m and N."""
    note_extreme(extremes, DTE, here.q)
    note_extreme(extremes, MESH_FORCE, here.mesh_force)
    for gear in range(2):
        note_extreme(extremes, PENETRATION + gear, here.penetration[gear])
        x, y = here.contact_x[gear], here.contact_y[gear]
        note_extreme(extremes, CONTACT_FORCE + gear, math.sqrt(x * x + y * y))
        x, y = x + here.film_x[gear], y + here.film_y[gear]
        note_extreme(extremes, BEARING_FORCE + gear, math.sqrt(x * x + y * y))


@compiled
def note_phase_zero(sections: Floats, row: int, here: KernelRecord, mesh_turn: float) -> int:
    """The point itself into ``row`` of the section; returns the next row."""
    sections[row, 0], sections[row, 1] = here.q, here.q_rate
    sections[row, 2] = TWO_PI * (mesh_turn - math.floor(mesh_turn + 0.5))
    return row + 1


@compiled
def note_crossing(
    sections: Floats,
    row: int,
    here: KernelRecord,
    mesh_turn: float,
    before: tuple[float, float, float, float],
    per_turn: float,
    step: float,
) -> int:
    """Where the step to ``here`` passed mesh phase 0, if it did, into ``row``; returns the next row.

    ``before`` are DTE, its rate, mesh turns and speed where the step began. The phase is taken as linear over
    the step, which the third column tells the error of; the DTE as the cubic through its values and rates.
    """
    q0, rate0, turn0, omega0 = before
    ahead = mesh_turn - turn0
    ahead -= per_turn * math.floor(ahead / per_turn + 0.5)
    level = math.floor(turn0) + 1.0 if ahead >= 0.0 else math.ceil(turn0) - 1.0
    share = (level - turn0) / ahead if ahead != 0.0 else 2.0
    if share > 1.0:
        return row
    rest = 1.0 - share
    value, slope = here.q - q0, share * rest
    bend0, bend1 = step * rate0 - value, value - step * here.q_rate
    sections[row, 0] = q0 + share * value + slope * (rest * bend0 + share * bend1)
    sections[row, 1] = (
        value + (rest - share) * (rest * bend0 + share * bend1) + slope * (bend1 - bend0)
    ) / step
    sections[row, 2] = 0.125 * per_turn * step * abs(here.omega[0] - omega0)
    return row + 1


@entry_point
def integrate_periods(
    all_constants: NDArray[Any],
    all_state: NDArray[Any],
    points: NDArray[Any],
    wave_rows: Floats,
    amplitude_rows: Floats,
    first_sample: int,
    samples_per_period: int,
    samples: Floats,
    angles: Floats,
    sections: Floats,
    extremes: Floats,
    all_call: NDArray[Any],
    impact_rows: Floats,
) -> tuple[int, int, int]:
    """Integrate and sample like ``integrate``, from a multiple of ``samples_per_period`` on.

    ``sections`` (m, 3) take the points at mesh phase 0, m more than the periods; ``extremes`` (8, 3) take in
    every step. The impacts are not kept. Returns (rows of samples, points of the section, status).
    """
    constants, state, call = all_constants[0], all_state[0], all_call[0]
    here, end, low_end = points[HERE], points[END], points[LOW]
    waves, amplitudes = pointer(wave_rows), pointer(amplitude_rows)
    impacts = ImpactList(pointer(impact_rows), call)
    n, most_points = samples.shape[0], sections.shape[0]
    limit, step, teeth = constants.speed_limit, constants.step, constants.teeth1
    interval = step * constants.steps_per_sample
    written, found, status, unrefreshed = n, 0, RUNNING, 0
    speed = state.speed
    copy_motion(state, here)
    for row in range(n):
        if constants.governed:
            govern(constants, state, here, interval)
        here.time = (first_sample + row) * interval
        unrefreshed += constants.steps_per_sample
        # The waves turn at the speed of their last refresh.
        if constants.governed or row % samples_per_period == 0 or unrefreshed >= REFRESH_STEPS:
            speed = state.speed if constants.nominal_phase else here.omega[0]
            open_point(constants, state, here, waves, amplitudes)
            unrefreshed = 0
        if not is_finite(here):
            written, status = row, NON_FINITE
            break
        write_sample(constants, state, here, row, samples, angles)
        if abs(here.omega[0]) > limit or abs(here.omega[1]) > limit:
            written, status = row + 1, OVER_SPEED
            break
        if here.half_backlash <= 0.0 or state.pressed == 1:
            written, status = row + 1, CENTRES_PRESSED
            break
        if constants.nominal_phase and row % samples_per_period == 0:
            found = note_phase_zero(sections, found, here, teeth * here.part_turn)
        for _ in range(constants.steps_per_sample):
            call.listed = 0
            before = (here.q, here.q_rate, teeth * here.part_turn, here.omega[0])
            detour = advance_step(constants, state, here, end, low_end, waves, amplitudes, impacts, speed)
            if not detour:
                here, end = end, here
            note_extremes(here, extremes)
            if not constants.nominal_phase and found < most_points:
                found = note_crossing(sections, found, here, teeth * here.part_turn, before, teeth, step)
    copy_motion(here, state)
    return written, found, status
