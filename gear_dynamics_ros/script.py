"""Scripts: what to do to a gearbox before which of its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError


@dataclass(frozen=True, slots=True)
class ResetAction:
    """Reset to the start state."""


@dataclass(frozen=True, slots=True)
class ChangeAction:
    """Change parameters, by dotted name, all at once."""

    parameters: Mapping[str, Any]


ScriptAction: TypeAlias = ResetAction | ChangeAction


@dataclass(frozen=True, slots=True)
class ScriptStep:
    """Actions, then commands, before the sample at ``time_ns`` is computed."""

    time_ns: int  # since the start of the script
    actions: tuple[ScriptAction, ...]
    commands: Commands  # in force from then on; NaN for a command that stays as it is


@dataclass(frozen=True, slots=True)
class LockstepScript:
    """Steps to perform on a gearbox at exact samples. The first step is at time 0."""

    source: str  # where it comes from, for messages: "the recording" or "the profile"
    duration_ns: int
    steps: tuple[ScriptStep, ...]


def agree(wanted: Commands, in_force: Commands) -> bool:
    """Whether ``in_force`` are the ``wanted`` commands, of which NaN is any value."""
    return all(math.isnan(value) or value == other for value, other in zip(wanted, in_force, strict=True))


def require_chunk_edges(script: LockstepScript, chunk_ns: int) -> None:
    """Raise UsageError if a step is not at the start of a chunk of ``chunk_ns``."""
    times = [step.time_ns for step in script.steps]
    inside = next((time_ns for time_ns in times if time_ns % chunk_ns), None)
    if inside is not None:
        fitting = math.gcd(*times, chunk_ns) / 1e9
        raise UsageError(
            f"{script.source} has commands or events {inside / 1e9:.9g} s after its first sample, within "
            f"a chunk of the gearbox's solver.chunk = {chunk_ns / 1e9:.9g} s: start the gearbox with "
            f"solver.chunk = {fitting:.9g} s"
        )
