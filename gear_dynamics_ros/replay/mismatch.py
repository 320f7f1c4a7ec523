"""What of a re-simulation must be as it was recorded: messages, events and states, compared bit by bit."""

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
    """The first value that came out otherwise; None where there is none on that side."""

    sample: int
    what: str  # channel, topic and entry, or entry of a state
    recorded: object
    simulated: object

    def __str__(self) -> str:
        return f"sample {self.sample}, {self.what}: recorded {self.recorded!r}, now {self.simulated!r}"


def compare_message(recorded: RecordedChunk, topic: str, simulated: bytes | None) -> Mismatch | None:
    """Compare a chunk's message on ``topic`` with the one that was made now."""
    stored = recorded.messages.get(topic)
    if stored is None and simulated is None:
        return None
    if stored is None or simulated is None:
        there, missing = "a message", "no message"
        return Mismatch(recorded.first, topic, there if stored else missing, there if simulated else missing)
    theirs = bytes(stored)  # memory views compare byte by byte
    if theirs == simulated:
        return None
    if is_rows(topic):
        return _unlike_rows(recorded, topic, theirs, simulated)
    return _unlike_bytes(recorded.first, topic, theirs, simulated)


def _unlike_rows(recorded: RecordedChunk, topic: str, theirs: bytes, ours: bytes) -> Mismatch:
    """Where two messages of rows differ. Raises GearboxError if the recorded one is spoilt."""
    then, now = (recorded.decoder.rows(topic, recorded.time_ns, data) for data in (theirs, ours))
    names = recorded.channels if topic == "waveform" else ROW_NAMES[topic]
    common = min(len(then), len(now))
    unlike = _bits(then[:common]) != _bits(now[:common])
    if not unlike.any():
        return Mismatch(recorded.first + common, topic, f"{len(then)} rows", f"{len(now)} rows")
    row, column = divmod(int(unlike.argmax()), unlike.shape[1])
    what = names[column] if topic == "waveform" else f"{topic}: {names[column]}"
    sample = recorded.first + row if topic == "waveform" else recorded.first
    return Mismatch(sample, what, float(then[row, column]), float(now[row, column]))


def _unlike_bytes(first: int, topic: str, theirs: bytes, ours: bytes) -> Mismatch:
    common = min(len(theirs), len(ours))
    byte = next((i for i in range(common) if theirs[i] != ours[i]), common)
    return Mismatch(first, f"{topic}: byte {byte}", theirs[byte:].hex()[:16], ours[byte:].hex()[:16])


def _bits(rows: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.ascontiguousarray(rows).view(np.int64)


def compare_state(engine: Engine, stored: Checkpoint) -> Mismatch | None:
    """Compare where the engine has come with the checkpoint that was stored there."""
    if stored.status is not Status.RUNNING and engine.status is Status.RUNNING:
        # It ended without a sample, in a chunk of which nothing was recorded.
        engine.advance(1)
    for name, value in differences(engine.parameters, stored.parameters).items():
        return Mismatch(engine.sample, f"parameter {name}", value, engine.parameters.to_flat()[name])
    theirs, ours = _entries(stored), _entries(engine.checkpoint())
    for name in sorted(theirs.keys() | ours.keys()):
        # The text of a double that JSON keeps is that of no other.
        if json.dumps(theirs.get(name)) != json.dumps(ours.get(name)):
            return Mismatch(engine.sample, f"state {name}", theirs.get(name), ours.get(name))
    return None


def _entries(checkpoint: Checkpoint) -> dict[str, Any]:
    """Entries by dotted name, but for the parameters."""
    return {
        "sample": checkpoint.sample,
        "status": int(checkpoint.status),
        **{f"commands.{name}": value for name, value in checkpoint.commands._asdict().items()},
        **{f"state.{name}": value for name, value in checkpoint.state.items()},
    }


def compare_event(engine: Engine, event: OperatorEvent) -> Mismatch | None:
    """Compare what an event tells besides."""
    what = f"event {event.kind}"
    details = {
        CHANGE: bool(event.parameters),
        RESTORE: bool(event.checkpoint),
        TIMEOUT: bool(event.commands) or event.kind == TIMEOUT,  # one that holds commands has none
    }
    if event.kind not in EVENTS or any(there != (kind == event.kind) for kind, there in details.items()):
        return Mismatch(event.sample, what, "details of another kind", "its own")
    now = event.sample * engine.parameters.solver.sample_interval_ns / 1e9
    if event.time != now:
        return Mismatch(event.sample, f"{what}: time", event.time, now)
    # A run that ended within a chunk without a sample has counted there what is made again only later.
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
