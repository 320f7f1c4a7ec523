"""Compares messages, events and states of a re-simulation with the recorded ones, bit by bit."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np

from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.events import CHANGE, END, EVENTS, RESTORE, TIMEOUT, OperatorEvent
from gear_dynamics_ros.messages.decoder import ROW_NAMES
from gear_dynamics_ros.parameters import differences
from gear_dynamics_ros.replay.part_reader import RecordedChunk
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import commands_of_timeout
from gear_dynamics_ros.topics import is_rows


class Mismatch(NamedTuple):
    """The first value that differs; a side that has no value is None."""

    sample: int
    what: str  # channel, topic with entry, or entry of a state
    recorded: object
    simulated: object

    def __str__(self) -> str:
        return f"sample {self.sample}, {self.what}: recorded {self.recorded!r}, now {self.simulated!r}"


def compare_message(recorded: RecordedChunk, topic: str, simulated: bytes | None) -> Mismatch | None:
    """Compare the recorded message of a chunk on ``topic`` with the simulated one.

    Raises GearboxError if they differ and the recorded one is damaged.
    """
    stored = recorded.messages.get(topic)
    if stored is None and simulated is None:
        return None
    if stored is None or simulated is None:
        there, missing = "a message", "no message"
        return Mismatch(recorded.first, topic, there if stored else missing, there if simulated else missing)
    theirs = bytes(stored)  # much faster to compare than a memory view
    if theirs == simulated:
        return None
    if is_rows(topic):
        return _row_mismatch(recorded, topic, theirs, simulated)
    return _byte_mismatch(recorded.first, topic, theirs, simulated)


def _row_mismatch(recorded: RecordedChunk, topic: str, theirs: bytes, ours: bytes) -> Mismatch:
    """First difference between two messages of rows."""
    then, now = (recorded.decoder.rows(topic, recorded.time_ns, data) for data in (theirs, ours))
    names = recorded.channels if topic == "waveform" else ROW_NAMES[topic]
    common = min(len(then), len(now))
    differs = _bits(then[:common]) != _bits(now[:common])
    if not differs.any():
        return Mismatch(recorded.first + common, topic, f"{len(then)} rows", f"{len(now)} rows")
    row, column = divmod(int(differs.argmax()), differs.shape[1])
    what = names[column] if topic == "waveform" else f"{topic}: {names[column]}"
    sample = recorded.first + row if topic == "waveform" else recorded.first
    return Mismatch(sample, what, float(then[row, column]), float(now[row, column]))


def _byte_mismatch(first: int, topic: str, theirs: bytes, ours: bytes) -> Mismatch:
    common = min(len(theirs), len(ours))
    byte = next((i for i in range(common) if theirs[i] != ours[i]), common)
    return Mismatch(first, f"{topic}: byte {byte}", theirs[byte:].hex()[:16], ours[byte:].hex()[:16])


def _bits(rows: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.ascontiguousarray(rows).view(np.int64)


def compare_state(engine: Engine, stored: Checkpoint) -> Mismatch | None:
    """Compare parameters, commands and state of ``engine`` with a stored checkpoint."""
    if stored.status is not Status.RUNNING and engine.status is Status.RUNNING:
        # The run ended in a chunk without samples, which was not recorded.
        engine.advance(1)
    for name, value in differences(engine.parameters, stored.parameters).items():
        return Mismatch(engine.sample, f"parameter {name}", value, engine.parameters.to_flat()[name])
    theirs, ours = _entries(stored), _entries(engine.checkpoint())
    for name in sorted(theirs.keys() | ours.keys()):
        # As JSON text: different doubles, also -0.0 and 0.0, have different texts.
        if json.dumps(theirs.get(name)) != json.dumps(ours.get(name)):
            return Mismatch(engine.sample, f"state {name}", theirs.get(name), ours.get(name))
    return None


def _entries(checkpoint: Checkpoint) -> dict[str, Any]:
    """Entries of a checkpoint by dotted name, without the parameters."""
    return {
        "sample": checkpoint.sample,
        "status": int(checkpoint.status),
        **{f"commands.{name}": value for name, value in checkpoint.commands._asdict().items()},
        **{f"state.{name}": value for name, value in checkpoint.state.items()},
    }


def compare_event(engine: Engine, event: OperatorEvent) -> Mismatch | None:
    """Compare time, counters and details of a recorded event with the present state of ``engine``."""
    what = f"event {event.kind}"
    details = {
        CHANGE: bool(event.parameters),
        RESTORE: bool(event.checkpoint),
        TIMEOUT: bool(event.commands)
        or event.kind == TIMEOUT,  # a time-out that holds commands has no details
    }
    if event.kind not in EVENTS or any(there != (kind == event.kind) for kind, there in details.items()):
        return Mismatch(event.sample, what, "details of another kind", "its own")
    now = event.sample * engine.parameters.solver.sample_interval_ns / 1e9
    if event.time != now:
        return Mismatch(event.sample, f"{what}: time", event.time, now)
    # If the run ended in a chunk without samples, its counters include steps that are repeated only later.
    if event.kind != END and event.counters != engine.counters:
        return Mismatch(event.sample, f"{what}: counters", event.counters, engine.counters)
    if event.kind == TIMEOUT:
        return _compare_timeout(engine, event)
    return None


def _compare_timeout(engine: Engine, event: OperatorEvent) -> Mismatch | None:
    operation = engine.parameters.operation
    if operation.command_timeout == 0.0:
        return Mismatch(event.sample, f"event {event.kind}", "a time-out", "operation.command_timeout is 0")
    expected = dict(commands_of_timeout(operation))
    if dict(event.commands) != expected:
        return Mismatch(event.sample, f"event {event.kind}: commands", dict(event.commands), expected)
    return None
