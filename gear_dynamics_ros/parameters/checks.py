"""What makes parameters valid: the type and the bounds of each value, and the values that must fit together.

Every function whose name begins with ``check`` raises UsageError with the name, the value, the limit and what
to do.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import zip_longest
from typing import Any, Final

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.decimals import exact_decimal, exact_text
from gear_dynamics_ros.parameters.groups import (
    NANOSECOND,
    BearingPairParameters,
    GearPairParameters,
    MeshParameters,
    OperationParameters,
    PacingParameters,
    RecordingParameters,
    RerunParameters,
    SolverParameters,
    SurfaceParameters,
)
from gear_dynamics_ros.parameters.hints import most_alike, shortened
from gear_dynamics_ros.parameters.rcl_yaml import SMALLEST_NORMAL, resolve_scalar, scalar_text
from gear_dynamics_ros.parameters.specification import Specification, Value, value_text

MOST_WAVES_PER_REVOLUTION: Final = 200_000  # of the surface profile on one gear
MOST_SAMPLES_PER_CHUNK: Final = 1_000_000
SMALLEST_SPLIT: Final = 1_000_000  # bytes

_TYPE_WORDS: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def converted_value(row: Specification, value: object) -> Value:
    """``value`` in the type of the parameter: an integer becomes a float, and any sequence a tuple.

    Raises UsageError if ``value`` has another type, whose conversion would change its meaning.
    """
    if row.type is not tuple:
        scalar: Value = _converted_scalar(row, value)
        return scalar
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise UsageError(
            f"{row.name} = {_any_text(value)} must be a list, each entry {_TYPE_WORDS[row.element]}"
        )
    return tuple(_converted_scalar(row, entry) for entry in value)


def check_value(row: Specification, value: Value) -> None:
    """Check the exact type, the number of entries, the bounds and the choices of one value."""
    entries = value if isinstance(value, tuple) else (value,)
    converted_value(row, value)
    if any(type(entry) is not row.element for entry in entries):
        raise UsageError(
            f"{row.name} = {_any_text(value)} must be {_TYPE_WORDS[row.element]} of type "
            f"{row.element.__name__}: convert it, or use Parameters.from_flat, which does"
        )
    fewest, most = row.length or (1, 1)
    if not fewest <= len(entries) <= most:
        raise UsageError(f"{row.name} has {len(entries)} entries: it must have {fewest} to {most}")
    for index, entry in enumerate(entries):
        _check_scalar(row, f"{row.name}[{index}]" if row.length else row.name, entry)


def _converted_scalar(row: Specification, value: object) -> Any:
    if row.element is float and isinstance(value, float):
        return float(value)
    if row.element in (int, float) and hasattr(value, "__index__") and not isinstance(value, bool):
        return _converted_integer(row, operator.index(value))
    if type(value) is not row.element:
        raise UsageError(
            f"{row.name} = {_any_text(value)} must be {_TYPE_WORDS[row.element]}{_type_hint(row, value)}"
        )
    return value


def _converted_integer(row: Specification, value: int) -> int | float:
    if row.element is int:
        return value
    try:
        return float(value)
    except OverflowError:
        raise UsageError(f"{row.name} is an integer of {value.bit_length()} bits: {_required(row)}") from None


def _type_hint(row: Specification, value: object) -> str:
    if isinstance(value, list | tuple):
        return ", not a list"
    if row.element is str:
        return ": put it in quotes"
    if row.element is int and isinstance(value, float) and value.is_integer():
        return f": write {int(value)}"
    if isinstance(value, str) and not isinstance(resolve_scalar(value), str):
        return ": remove the quotes"
    return ""


def _check_scalar(row: Specification, name: str, value: bool | int | float | str) -> None:
    if isinstance(value, str):
        _check_text(row, name, value)
        return
    if _is_out_of_bounds(row, value) or not math.isfinite(value):
        raise UsageError(f"{name} = {value_text(value)} is out of range: {_required(row)}")
    if 0.0 < abs(value) < SMALLEST_NORMAL:
        raise UsageError(
            f"{name} = {value_text(value)} is closer to 0 than {SMALLEST_NORMAL:.4g}, "
            "the smallest normal float: write 0.0"
        )


def _check_text(row: Specification, name: str, value: str) -> None:
    if row.choices and value not in row.choices:
        close = most_alike(value, row.choices)
        hint = f"did you mean {close}? " if close else ""
        raise UsageError(f"{name} = {shortened(value)!r}: {hint}it must be {row.limits}")
    if not value.isprintable():
        raise UsageError(
            f"{name} = {shortened(value)!r} contains characters that can't be printed: remove them"
        )


def _is_out_of_bounds(row: Specification, value: float) -> bool:
    low, high = row.minimum, row.maximum
    below = low is not None and (value <= low if row.exclusive_minimum else value < low)
    above = high is not None and (value >= high if row.exclusive_maximum else value > high)
    return below or above


def _required(row: Specification) -> str:
    return f"it must be {row.limits}{' ' + row.unit if row.unit else ''}"


def _any_text(value: object) -> str:
    """An object of any type for an error message; text in quotes, so that '1.0' and 1.0 differ."""
    if isinstance(value, str):
        return repr(value)
    return scalar_text(value) if isinstance(value, bool | float) else str(value)


def check_bearings(bearings: BearingPairParameters) -> None:
    """Check that shaft and sleeve touch before the oil film has no thickness left."""
    for side, bearing in (("driving", bearings.driving), ("driven", bearings.driven)):
        if bearing.oil_clearance <= bearing.clearance:
            raise UsageError(
                f"bearings.{side}.oil_clearance = {value_text(bearing.oil_clearance)} m must be > "
                f"bearings.{side}.clearance = {value_text(bearing.clearance)} m: increase the first or "
                "reduce the second"
            )


def check_mesh(mesh: MeshParameters) -> None:
    """Check that the mesh stiffness stays positive at all phases: the amplitudes add up to less than 1."""
    amplitude = sum(
        math.hypot(a, b) for a, b in zip_longest(mesh.stiffness_cos, mesh.stiffness_sin, fillvalue=0.0)
    )
    if amplitude >= 1.0:
        raise UsageError(
            f"the harmonics of mesh.stiffness_cos and mesh.stiffness_sin have a total amplitude of "
            f"{exact_text(amplitude)}: it must be < 1, so that the stiffness stays positive: reduce them"
        )


def check_surface(surface: SurfaceParameters, gears: GearPairParameters) -> None:
    """Check that the shortest wave of the surface profile is not too short to be resolved."""
    for side, gear in (("driving", gears.driving), ("driven", gears.driven)):
        waves = gear.teeth * surface.scale ** (surface.waves - 1)
        if waves > MOST_WAVES_PER_REVOLUTION:
            raise UsageError(
                f"surface.waves = {surface.waves}, surface.scale = {value_text(surface.scale)} and "
                f"gears.{side}.teeth = {gear.teeth} make {exact_text(waves)} waves per revolution; the "
                f"limit is {MOST_WAVES_PER_REVOLUTION}: reduce one of them"
            )


def check_operation(operation: OperationParameters, mesh_phase: str) -> None:
    """Check the speed set-point against its limit, and the start state against the mesh phase."""
    if abs(operation.speed) > operation.speed_limit:
        raise UsageError(
            f"operation.speed = {value_text(operation.speed)} rad/s is beyond operation.speed_limit = "
            f"{value_text(operation.speed_limit)} rad/s: reduce the speed or increase the limit"
        )
    if operation.initial == "rest" and mesh_phase == "nominal":
        raise UsageError(
            "operation.initial = 'rest' needs a mesh phase that starts at rest, but mesh_phase = 'nominal' "
            "runs at operation.speed: set operation.initial to touching, or mesh_phase to actual"
        )


def check_solver(solver: SolverParameters) -> None:
    """Check that samples are whole numbers of steps and of nanoseconds, and chunks of samples."""
    name = "solver.sample_interval"
    _check_multiple(name, solver.sample_interval, NANOSECOND, "nanoseconds")
    step, interval = exact_decimal(solver.step), exact_decimal(solver.sample_interval)
    _check_multiple(name, solver.sample_interval, step, f"steps of {value_text(solver.step)} s")
    _check_multiple(
        "solver.chunk", solver.chunk, interval, f"samples of {value_text(solver.sample_interval)} s"
    )
    if solver.samples_per_chunk > MOST_SAMPLES_PER_CHUNK:
        raise UsageError(
            f"solver.chunk = {value_text(solver.chunk)} s has {solver.samples_per_chunk} samples; the limit "
            f"is {MOST_SAMPLES_PER_CHUNK}: reduce it or increase solver.sample_interval"
        )


def check_pacing(pacing: PacingParameters) -> None:
    """Check that the processors are a list, and that a real-time thread has pauses in which others run."""
    try:
        numbers = pacing.processor_numbers
    except ValueError:
        numbers = frozenset()
    if pacing.processors and not numbers:
        raise UsageError(
            f"pacing.processors = {pacing.processors!r:.80} is not a list of processors: write numbers and "
            "ranges, such as '2' or '0,2-3'"
        )
    if pacing.priority and not pacing.real_time_factor:
        raise UsageError(
            f"pacing.priority = {pacing.priority} with pacing.real_time_factor = 0.0 would leave no other "
            "thread its processor: set one of them to another value"
        )


def check_clock(clock_rate: float, clock_period_ns: int, solver: SolverParameters) -> None:
    """Check that there are enough chunks for the rate of /clock, which comes at most once a chunk."""
    if 0 < clock_period_ns < solver.samples_per_chunk * solver.sample_interval_ns:
        raise UsageError(
            f"clock_rate = {value_text(clock_rate)} Hz is more than one /clock a chunk of solver.chunk = "
            f"{value_text(solver.chunk)} s: reduce it to {1.0 / solver.chunk:.9g} Hz, or shorten the chunk"
        )


def check_waveform_channels(channels: Sequence[str]) -> None:
    """Check that time comes first and no channel twice."""
    if channels[0] != "time":
        raise UsageError(f"waveform_channels starts with '{channels[0]}': it must start with time")
    for name in channels:
        if channels.count(name) > 1:
            raise UsageError(f"waveform_channels names '{name}' {channels.count(name)} times: name it once")


def check_recording(recording: RecordingParameters) -> None:
    """Check that the files of a split recording are not too small."""
    if 0 < recording.split_size < SMALLEST_SPLIT:
        raise UsageError(
            f"recording.split_size = {recording.split_size} B is too small: "
            f"it must be 0 (never split) or >= {SMALLEST_SPLIT} B"
        )


def check_rerun(rerun: RerunParameters) -> None:
    """Check that the destination of the Rerun stream is given."""
    if rerun.mode == "save" and not rerun.path:
        raise UsageError("rerun.path is empty, but rerun.mode = 'save' needs a file: set rerun.path")
    if rerun.mode == "connect" and not rerun.url.startswith("rerun"):
        raise UsageError(
            f"rerun.url = {rerun.url!r} must be a Rerun address, such as {RerunParameters().url}"
        )


def _check_multiple(name: str, value: float, unit: Fraction, units: str) -> None:
    ratio = exact_decimal(value) / unit
    if ratio.denominator != 1:
        below = max(1, math.floor(ratio))
        nearest = " or ".join(value_text(float(count * unit)) for count in (below, below + 1))
        raise UsageError(
            f"{name} = {value_text(value)} s is {exact_text(float(ratio))} {units}; it must be a whole "
            f"number: set {nearest} s"
        )
