"""Operator events: what an operator, or a time-out, does to a run between two samples."""

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
RESTORE = "restore"  # ~/restore_checkpoint: the state of a checkpoint; simulated time continues
TIMEOUT = "timeout"  # no command came within operation.command_timeout
END = "end"
# All kinds of events.
EVENTS = frozenset({START, RESET, PAUSE, RESUME, CHANGE, RESTORE, TIMEOUT, END})

_EMPTY: Mapping[str, Any] = MappingProxyType({})


class OperatorEvent(NamedTuple):
    """One event, after the sample before ``sample`` and before ``sample`` is computed."""

    sample: int
    time: float  # s, simulated
    kind: str  # one of EVENTS
    message: str
    counters: Counters  # at that moment
    parameters: Mapping[str, Any] = _EMPTY  # the changed values, by dotted name
    checkpoint: Mapping[str, Any] = _EMPTY  # the restored one, as from ``Checkpoint.to_tree``
    commands: Mapping[str, float] = _EMPTY  # that a time-out put in force, by field of Commands
