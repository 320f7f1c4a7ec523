"""What Python calls: start, evaluation, change at run time, and integration of a gearbox.

Records come as arrays of one: a lone record is slow to hand over from Python. ``points`` (3,) POINT, ``call``
(1,) CALL and, but for its orders, ``waves`` are scratch; see ``records`` and ``waves`` for all types.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from gear_dynamics_ros.physics.kernel.columns import (
    CENTRES_PRESSED,
    CHANNEL_COUNT,
    NON_FINITE,
    OVER_SPEED,
    RUNNING,
)
from gear_dynamics_ros.physics.kernel.compiling import compiled, entry_point
from gear_dynamics_ros.physics.kernel.dynamics import govern
from gear_dynamics_ros.physics.kernel.events import DRIVE_FLANK_EVENT, evaluate_again, evaluate_point
from gear_dynamics_ros.physics.kernel.lanes import copy_record, pointer, store
from gear_dynamics_ros.physics.kernel.output import is_finite, stored_energy, write_energies, write_sample
from gear_dynamics_ros.physics.kernel.records import (
    END,
    EVENT_COUNT,
    HERE,
    LOW,
    TURNS_PER_RADIAN,
    Floats,
    ImpactList,
    KernelRecord,
    Pointer,
    copy_motion,
)
from gear_dynamics_ros.physics.kernel.substeps import IMPACTS_PER_STEP, advance_step
from gear_dynamics_ros.physics.kernel.switches import flip_flag
from gear_dynamics_ros.physics.kernel.waves import COSINE, REFRESH_STEPS, SINE, refresh_waves, sum_waves


@compiled
def open_point(
    constants: KernelRecord, state: KernelRecord, here: KernelRecord, waves: Pointer, amplitudes: Pointer
) -> None:
    """Evaluate ``here`` afresh at the motion it holds, with the waves on the grid there."""
    here.part_turn = TURNS_PER_RADIAN * here.theta1
    speed = here.omega[0]
    if constants.nominal_phase:
        here.part_turn = state.nominal_turn
        speed = state.speed
    here.lead = 0.0
    refresh_waves(constants, state, here, waves, speed)
    store(here.excitation, 0, sum_waves(constants, waves, amplitudes, COSINE, SINE))
    evaluate_point(constants, state, here, 0.0)


@compiled
def open_state(
    constants: KernelRecord, state: KernelRecord, here: KernelRecord, waves: Pointer, amplitudes: Pointer
) -> None:
    """``open_point`` at the motion of ``state``."""
    copy_motion(state, here)
    open_point(constants, state, here, waves, amplitudes)


@entry_point
def start_touching(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> None:
    """Set u so that the drive flank just touches (q = b1), in contact if the gap is closing."""
    state[0].flank = 0.0
    state[0].u = 0.0
    open_state(constants[0], state[0], points[HERE], pointer(waves), pointer(amplitudes))
    here = points[HERE]
    state[0].u = here.half_backlash - here.q
    if here.rate[DRIVE_FLANK_EVENT] < 0.0:
        state[0].flank = 1.0


@entry_point
def evaluate_state(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> None:
    """Evaluate the state, flags frozen, into the point HERE."""
    open_state(constants[0], state[0], points[HERE], pointer(waves), pointer(amplitudes))


@entry_point
def evaluate_before_change(
    constants: NDArray[Any], state: NDArray[Any], points: NDArray[Any], waves: Floats, amplitudes: Floats
) -> float:
    """``evaluate_state`` at what is about to change under the same motion; returns the stored energy, N m."""
    open_state(constants[0], state[0], points[HERE], pointer(waves), pointer(amplitudes))
    return float(stored_energy(constants[0], state[0], points[HERE]))


@entry_point
def adapt_to_change(
    constants: NDArray[Any],
    state: NDArray[Any],
    points: NDArray[Any],
    waves: Floats,
    amplitudes: Floats,
    call: NDArray[Any],
    impact_rows: Floats,
    stored_before: float,
) -> None:
    """Bring the flags into line with a change of constants or excitations, after ``evaluate_before_change``.

    What the change brought past its surface is flipped and counted; the gaps of the bearings it can't move.
    What the springs gain by it, the excitations have put in.
    """
    here, before = points[HERE], points[LOW]
    copy_record(here, before)
    open_state(constants[0], state[0], points[HERE], pointer(waves), pointer(amplitudes))
    flipped = 0
    for _ in range(EVENT_COUNT):
        following = -1
        for event in range(EVENT_COUNT):
            value = here.value[event]
            # One that rounding left short of its surface, on its way there, is not the change's doing.
            if value < 0.0 and value < before.value[event] and not (flipped >> event) & 1:
                following = event
                break
        if following < 0:
            break
        flip_flag(constants[0], following, state[0], here, ImpactList(pointer(impact_rows), call[0]))
        flipped |= 1 << following
        evaluate_again(constants[0], state[0], here)
    state[0].excitation_work += stored_energy(constants[0], state[0], here) - stored_before


@entry_point
def integrate(
    all_constants: NDArray[Any],
    all_state: NDArray[Any],
    points: NDArray[Any],
    wave_rows: Floats,
    amplitude_rows: Floats,
    first_sample: int,
    interval_ns: int,
    samples: Floats,
    angles: Floats,
    energies: Floats,
    all_call: NDArray[Any],
    impact_rows: Floats,
) -> tuple[int, int]:
    """Integrate and sample: row k of ``samples`` (n, 28) and ``angles`` (n, 2) is the state before its steps.

    ``samples`` of 37 columns take ENERGIES too; ``energies`` (1, 9) takes them at the end. ``impact_rows``
    take the bearing contacts that end, ``call.listed`` of them; the call ends early where they might not
    suffice for another sample with IMPACTS_PER_STEP. Changes the state in place; returns (rows written,
    status). On OVER_SPEED and CENTRES_PRESSED the last row is the state that broke the limit; a NON_FINITE
    state is not written.
    """
    # numba counts references to arrays at every call, and none to records and pointers.
    constants, state, call = all_constants[0], all_state[0], all_call[0]
    here, end, low_end = points[HERE], points[END], points[LOW]
    waves, amplitudes = pointer(wave_rows), pointer(amplitude_rows)
    impacts = ImpactList(pointer(impact_rows), call)
    n = samples.shape[0]
    limit, step = constants.speed_limit, constants.step
    interval = step * constants.steps_per_sample
    most_impacts = IMPACTS_PER_STEP * constants.steps_per_sample
    written, status = n, RUNNING
    copy_motion(state, here)
    call.listed = 0
    for row in range(n):
        if call.listed + most_impacts > impact_rows.shape[0]:
            written = row
            break
        if constants.governed:
            govern(constants, state, here, interval)
        time = (first_sample + row) * interval_ns / 1e9
        here.time = time
        open_point(constants, state, here, waves, amplitudes)
        speed = state.speed if constants.nominal_phase else here.omega[0]
        if not is_finite(here):
            written, status = row, NON_FINITE
            break
        write_sample(constants, state, here, row, samples, angles)
        if samples.shape[1] > CHANNEL_COUNT:
            write_energies(constants, state, here, samples, row, CHANNEL_COUNT)
        if abs(here.omega[0]) > limit or abs(here.omega[1]) > limit:
            written, status = row + 1, OVER_SPEED
            break
        if here.half_backlash <= 0.0 or state.pressed == 1:
            written, status = row + 1, CENTRES_PRESSED
            break
        for k in range(constants.steps_per_sample):
            here.time = time + k * step
            if k > 0 and k % REFRESH_STEPS == 0:
                speed = state.speed if constants.nominal_phase else here.omega[0]
                refresh_waves(constants, state, here, waves, speed)
            detour = advance_step(constants, state, here, end, low_end, waves, amplitudes, impacts, speed)
            if not detour:
                here, end = end, here
    write_energies(constants, state, here, energies, 0, 0)
    copy_motion(here, state)
    return written, status
