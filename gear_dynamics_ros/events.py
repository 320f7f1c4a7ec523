"""Operator events: what happens to a run between two samples."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from gear_dynamics_ros.chunk import Counters

# Kinds of events.
START = "start"
RESET = "reset"
PAUSE = "pause"
RESUME = "resume"  # after a pause
CHANGE = "parameters"
RESTORE = "restore"  # ~/restore_checkpoint: the state is that of a checkpoint, while time goes on
TIMEOUT = "timeout"  # no command came within operation.command_timeout
END = "end"
# All kinds of events.
EVENTS = frozenset({START, RESET, PAUSE, RESUME, CHANGE, RESTORE, TIMEOUT, END})

_NOTHING: Mapping[str, Any] = MappingProxyType({})


class OperatorEvent(NamedTuple):
    """What happened to a run before ``sample`` was made."""

    sample: int
    time: float  # s, simulated
    kind: str  # one of EVENTS
    message: str
    counters: Counters  # then
    parameters: Mapping[str, Any] = _NOTHING  # by dotted name, that changed
    checkpoint: Mapping[str, Any] = _NOTHING  # of a restore, as ``Checkpoint.to_tree`` makes it
    commands: Mapping[str, float] = _NOTHING  # fields of Commands that a time-out put in force
