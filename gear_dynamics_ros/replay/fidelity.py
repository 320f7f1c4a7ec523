"""What of a re-simulation must be as it was recorded: messages, events and states, compared bit by bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.events import (
    CHANGE,
    END,
    EVENTS,
    RESTORE,
)
from gear_dynamics_ros.messages.decoder import RowReader
from gear_dynamics_ros.parameters import Parameters, differences
from gear_dynamics_ros.recording.reader import Event, RecordedChunk
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.topics import is_rows


class Difference(NamedTuple):
    """The first value that came out otherwise; None where there is none on that side."""

    sample: int
    what: str  # channel, topic and entry, or entry of a state
    recorded: object
    simulated: object

    def __str__(self) -> str:
        return f"sample {self.sample}, {self.what}: recorded {self.recorded!r}, now {self.simulated!r}"


class State(NamedTuple):
    """A stored state, the parameters in force there, and the digest of what led to it, empty at a start."""

    checkpoint: Mapping[str, Any]
    parameters: Parameters
    history: str = ""


def compare_message(recorded: RecordedChunk, topic: str, simulated: bytes | None) -> Difference | None:
    """Compare a chunk's message on ``topic`` with the one that was made now."""
    stored = recorded.messages.get(topic)
    if stored is None and simulated is None:
        return None
    if stored is None or simulated is None:
        there, missing = "a message", "no message"
        return Difference(
            recorded.first, topic, there if stored else missing, there if simulated else missing
        )
    theirs = bytes(stored)  # memory views compare byte by byte
    return None if theirs == simulated else _locate(recorded.first, topic, theirs, simulated)


def _locate(first: int, topic: str, recorded: bytes, simulated: bytes) -> Difference:
    """Where two messages differ."""
    if is_rows(topic):
        names, theirs = RowReader().read(recorded)
        names_now, ours = RowReader().read(simulated)
        if names != names_now:
            return Difference(first, topic, names, names_now)
        common = min(len(theirs), len(ours))
        unlike = _bits(theirs[:common]) != _bits(ours[:common])
        if unlike.any():
            row, column = divmod(int(unlike.argmax()), unlike.shape[1])
            what = names[column] if topic == "waveform" else f"{topic}: {names[column]}"
            sample = first + row if topic == "waveform" else first
            return Difference(sample, what, float(theirs[row, column]), float(ours[row, column]))
        return Difference(first + common, topic, f"{len(theirs)} rows", f"{len(ours)} rows")
    common = min(len(recorded), len(simulated))
    byte = next((i for i in range(common) if recorded[i] != simulated[i]), common)
    return Difference(first, f"{topic}: byte {byte}", recorded[byte:].hex()[:16], simulated[byte:].hex()[:16])


def _bits(rows: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.ascontiguousarray(rows).view(np.int64)


def compare_state(engine: Engine, goal: State) -> Difference | None:
    """Compare where the engine has come with what was stored there."""
    if goal.checkpoint.get("status") != Status.RUNNING and engine.status is Status.RUNNING:
        # It ended without a sample, in a chunk of which nothing was recorded.
        engine.advance(1)
    for name, value in differences(engine.parameters, goal.parameters).items():
        return Difference(engine.sample, f"parameter {name}", value, engine.parameters.to_flat()[name])
    stored, reached = _entries(goal.checkpoint), _entries(engine.checkpoint())
    for name in sorted(stored.keys() | reached.keys()):
        # The text of a double that JSON keeps is that of no other.
        if json.dumps(stored.get(name)) != json.dumps(reached.get(name)):
            return Difference(engine.sample, f"state {name}", stored.get(name), reached.get(name))
    return None


def _entries(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Entries of a mapping of mappings by dotted name."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= _entries(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return found


def compare_event(engine: Engine, event: Event) -> Difference | None:
    """Compare what an event tells besides."""
    what = f"event {event.kind}"
    details = {CHANGE: bool(event.parameters), RESTORE: bool(event.checkpoint)}
    if event.kind not in EVENTS or any(there != (kind == event.kind) for kind, there in details.items()):
        return Difference(event.sample, what, "details of another kind", "its own")
    now = event.sample * engine.parameters.solver.sample_interval_ns / 1e9
    if event.time != now:
        return Difference(event.sample, f"{what}: time", event.time, now)
    counters = engine.counters._asdict()
    # A run that ended within a chunk without a sample has counted there what is made again only later.
    if event.kind != END and event.counters and event.counters != counters:
        return Difference(event.sample, f"{what}: counters", event.counters, counters)
    return None
