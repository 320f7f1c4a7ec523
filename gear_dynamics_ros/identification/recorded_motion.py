"""A recording as data of a fit: what its channels show in a window, and how the run came there."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, COLUMN, ENERGIES
from gear_dynamics_ros.chunk import Commands, Samples, Status
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE
from gear_dynamics_ros.identification.unknowns import Unknown
from gear_dynamics_ros.parameters import ParameterChange, Parameters, updated
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.recording import Recording
from gear_dynamics_ros.simulation.checkpoint import Checkpoint, require_running
from gear_dynamics_ros.simulation.engine import Engine

# Two chaotic runs whose parameters differ a little part after about as many periods of the mesh.
DEFAULT_PERIODS: Final = 40
MOST_SAMPLES: Final = 20_000
SKIPPED_SAMPLES: Final = 20_000  # computed at once before the window
# Channels that jump, or that no parameter of the gearbox decides.
NOT_FITTED: Final = ("time", "meshing_state", "driving_angle", "mesh_phase")
# A trajectory is smooth in the parameters on a small scale only, and computed with 15 digits.
DIFFERENCE: Final = 1e-6
STAGES: Final = (0.25, 0.5, 0.75, 1.0)  # parts of the window
_UNITS: Final = {channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)}
_NOT_REPEATED: Final = {RESET: "a reset", RESTORE: "a restored checkpoint", CHANGE: "a change of parameters"}
_STARTED_BY: Final = (
    "operation.speed",
    "operation.drive_torque",
    "operation.load_torque",
    "operation.initial",
)
_SAMPLED_BY: Final = ("solver.sample_interval", "solver.chunk", "waveform_channels")


class RecordedMotion(NamedTuple):
    """Samples of a window, and all that acted on the run from its start to the end of the window."""

    start: Checkpoint  # stored at or before the window
    fresh: bool  # whether the run begins there, in the state that operation.initial describes
    commands: tuple[tuple[int, Commands], ...]  # from the sample on, after those of the start
    measured: Samples  # the fitted channels


def read_motion(
    recording: Recording, channels: Sequence[str], start: float | None = None, end: float | None = None
) -> RecordedMotion:
    """The channels in [start, end) s; by default the first DEFAULT_PERIODS periods of the mesh.

    Raises UsageError on a channel that was not recorded or can't be fitted, and on a window that is empty,
    too long, or behind an event that a fit can't repeat; GearboxError if the recording is damaged.
    """
    recording.require_topic("waveform")
    _require_channels(recording, channels)
    first, end_sample = _window(recording, start, end)
    checkpoint = _last_checkpoint(recording, first)
    require_running(checkpoint)
    _require_repeatable(recording, checkpoint.sample, end_sample)
    interval = recording.parameters.solver.sample_interval
    _, columns = recording.columns(channels)
    values = recording.waveform(first, end_sample)[:, columns]
    beginning = Engine(checkpoint.parameters).checkpoint()
    return RecordedMotion(
        start=checkpoint,
        fresh=dict(beginning.state) == dict(checkpoint.state),
        commands=tuple(entry for entry in recording.commands if checkpoint.sample <= entry[0] < end_sample),
        measured=Samples(first, interval, tuple(channels), values),
    )


def parameters_as_recorded(parameters: Parameters, motion: RecordedMotion) -> Parameters:
    """``parameters`` with the start, the commands at the start and the samples of the recording.

    Raises UsageError if they don't fit.
    """
    recorded = motion.start.parameters.to_flat()
    return updated(parameters, {name: recorded[name] for name in (*_STARTED_BY, *_SAMPLED_BY)})


def require_not_recorded(unknowns: Sequence[Unknown]) -> None:
    """Raise UsageError if an unknown is what the recording gives."""
    for entry in (entry for unknown in unknowns for entry in unknown.entries):
        if entry.name in (*_STARTED_BY, *_SAMPLED_BY):
            raise UsageError(f"--vary {entry}: the recording gives it: vary other parameters")


class MotionObjective:
    """Recorded minus simulated channels, each divided by the rms of its deviation from its mean."""

    difference = DIFFERENCE

    def __init__(self, motion: RecordedMotion, base: Parameters) -> None:
        """``base`` as from ``parameters_as_recorded``.

        Raises UsageError if a channel is constant in the window, GearboxError if the stored state is invalid.
        """
        self._motion = motion
        self._columns = [COLUMN[name] for name in motion.measured.names]
        self._scales = motion.measured.values.std(axis=0)
        for name, scale in zip(motion.measured.names, self._scales, strict=True):
            if not scale > 0.0:
                raise UsageError(
                    f"--channels {name}: it is constant in the window: take another channel or window"
                )
        solver = {name: value for name, value in base.to_flat().items() if name.startswith("solver.")}
        # The engine that takes over the state has the grid of the trial, so that only physics changes then.
        before = updated(motion.start.parameters, solver)
        self._start = motion.start._replace(parameters=before)
        self._engine(base)

    @property
    def count(self) -> int:
        """Number of samples times channels."""
        return int(self._motion.measured.values.size)

    @property
    def stages(self) -> tuple[int, ...]:
        """The first part of the window, then more of it: the longer it is, the more valleys has the cost."""
        samples, channels = self._motion.measured.values.shape
        return tuple(math.ceil(samples * part) * channels for part in STAGES)

    def residuals(self, parameters: Parameters) -> NDArray[np.float64]:
        """Residuals sample by sample, shape (count,). Raises GearboxError if the run ends in the window."""
        measured = self._motion.measured
        simulated = self._simulated(parameters)
        return np.asarray((measured.values - simulated) / self._scales, dtype=np.float64).ravel()

    def identity(self) -> dict[str, Any]:
        """The window, its channels, and a digest of what was measured and what acted."""
        measured, start = self._motion.measured, self._start
        acted = repr((start.to_tree(), self._motion.commands)).encode()
        content = measured.values.tobytes() + acted
        return {
            "channels": list(measured.names),
            "first_sample": measured.first,
            "samples": len(measured),
            "sample_interval": measured.interval,
            "sha256": hashlib.sha256(content).hexdigest(),
        }

    def summary(self, residuals: NDArray[np.float64]) -> dict[str, Any]:
        """Of each channel: its rms about its mean, and rms and greatest residual, in its unit."""
        measured = self._motion.measured
        rows = residuals.reshape(measured.values.shape) * self._scales
        channels = {
            name: {
                "unit": _UNITS[name],
                "channel_rms": float(scale),
                "residual_rms": float(np.sqrt(np.mean(rows[:, column] ** 2))),
                "neighbour_correlation": _neighbour_correlation(rows[:, column]),
                "residual_greatest": float(np.abs(rows[:, column]).max()),
                "time_of_greatest": float(measured.time[np.abs(rows[:, column]).argmax()]),
            }
            for column, (name, scale) in enumerate(zip(measured.names, self._scales, strict=True))
        }
        begin, end = float(measured.time[0]), float(measured.time[0]) + len(measured) * measured.interval
        return {"from": begin, "to": end, "channels": channels}

    def table(self, residuals: NDArray[np.float64]) -> tuple[list[str], list[list[object]]]:
        """Time, and of each channel what was recorded and what the fit gives, in SI units."""
        measured = self._motion.measured
        rows = residuals.reshape(measured.values.shape) * self._scales
        header = ["time", *(f"{name}_{kind}" for name in measured.names for kind in ("recorded", "fitted"))]
        both = np.stack([measured.values, measured.values - rows], axis=2).reshape(len(measured), -1)
        return header, np.column_stack([measured.time, both]).tolist()

    def _simulated(self, parameters: Parameters) -> NDArray[np.float64]:
        measured = self._motion.measured
        engine = self._engine(parameters)
        end = measured.first + len(measured)
        turns = [sample for sample, _ in self._motion.commands if sample > engine.sample]
        pending = dict(self._motion.commands)
        rows = []
        for stop in sorted({*turns, measured.first, end}):
            while engine.sample < stop:
                if engine.sample in pending:
                    engine.command(pending.pop(engine.sample))
                chunk = engine.advance(min(stop - engine.sample, SKIPPED_SAMPLES))
                if chunk.status is not Status.RUNNING:
                    raise GearboxError(chunk.message)
                if chunk.first_sample >= measured.first:
                    rows.append(chunk.samples[:, self._columns])
        return np.concatenate(rows)

    def _engine(self, parameters: Parameters) -> Engine:
        """An engine with ``parameters`` in the recorded start."""
        if self._motion.fresh:
            engine = Engine(parameters)
            engine.sample = self._start.sample
        else:
            engine = Engine(self._start.parameters)
            engine.restore(self._start)
            # Not by change_to: a trial differs in parameters that are fixed while a gearbox runs.
            engine.change(ParameterChange(engine.parameters, parameters, {}))
        engine.command(self._start.commands)
        return engine


def _neighbour_correlation(column: NDArray[np.float64]) -> float:
    """Correlation of each residual with the next one: near 0 for noise, near 1 where the model is wrong."""
    power = float(column @ column)
    return float(column[1:] @ column[:-1]) / power if power > 0.0 else 0.0


def _require_channels(recording: Recording, channels: Sequence[str]) -> None:
    if not channels or not all(channels):
        raise UsageError("--channels names no channel: give some, such as --channels dte,driving_x")
    recording.columns(channels)
    for name in channels:
        if name in NOT_FITTED:
            raise UsageError(f"--channels {name}: it jumps or only counts time: take others, such as dte")
        if channels.count(name) > 1:
            raise UsageError(f"--channels names {name} twice: name it once")


def _window(recording: Recording, start: float | None, end: float | None) -> tuple[int, int]:
    first, end_sample = recording.require_window(start, end)
    if end is None:
        end_sample = min(end_sample, first + _default_samples(recording, first))
    if first == end_sample:
        raise UsageError(f"{recording.path} holds no samples: there is nothing to fit to")
    if end_sample - first > MOST_SAMPLES:
        raise UsageError(
            f"the window has {end_sample - first} samples, the limit is {MOST_SAMPLES}: let --to come sooner"
        )
    return first, end_sample


def _default_samples(recording: Recording, first: int) -> int:
    in_force = [commands for sample, commands in recording.commands if sample <= first]
    speed = abs((in_force[-1] if in_force else recording.start.commands).speed)
    if speed == 0.0:
        raise UsageError(
            "the window has no default length, as the commanded speed is 0 rad/s there: give --to S"
        )
    period = 2.0 * math.pi / (speed * recording.parameters.gears.driving.teeth)
    return math.ceil(DEFAULT_PERIODS * period / recording.parameters.solver.sample_interval)


def _last_checkpoint(recording: Recording, first: int) -> Checkpoint:
    """The last one stored at or before the sample ``first``."""
    part = [part for part in recording.parts if part.first_sample <= first][-1]
    inside = [name for sample, name in part.checkpoints.items() if sample <= first]
    return (part.stored(inside[-1]) if inside else part.start).checkpoint


def _require_repeatable(recording: Recording, first: int, end: int) -> None:
    interval = recording.parameters.solver.sample_interval
    for event in recording.events:
        if first <= event.sample < end and event.kind in _NOT_REPEATED:
            at, low, high = (exact_text(sample * interval) for sample in (event.sample, first, end))
            raise UsageError(
                f"{recording.path} has {_NOT_REPEATED[event.kind]} at {at} s, which a fit can't repeat; it "
                f"would start at {low} s, the last stored state before the window, and end at {high} s: "
                "choose --from and --to before it, or --from behind the next stored state"
            )
