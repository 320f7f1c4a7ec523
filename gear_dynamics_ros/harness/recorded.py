"""What is to be played to a live gearbox of a recording: a profile to follow, or a script for lockstep."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE, OperatorEvent
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.tracks import Segment, Track
from gear_dynamics_ros.recording.reader import Recording

# Parameters that are commands as well: a recording holds what they changed among its commands.
COMMANDED = frozenset(f"operation.{name}" for name in Commands._fields)
# They say when chunks are made, never what is in them; in lockstep the player decides when.
TEMPO = ("pacing.", "stepping.")


@dataclass(frozen=True, slots=True)
class Reset:
    """Back to the start state."""


@dataclass(frozen=True, slots=True)
class Change:
    """Parameters by dotted name, changed all together."""

    parameters: Mapping[str, Any]


Act: TypeAlias = Reset | Change


@dataclass(frozen=True, slots=True)
class Moment:
    """What is done, in this order, before the sample at ``time_ns`` is made."""

    time_ns: int  # since the recording's first sample
    acts: tuple[Act, ...]
    commands: Commands  # in force from then on


@dataclass(frozen=True, slots=True)
class Script:
    """What a recording asks of a gearbox, to the sample. The first moment is at time 0."""

    duration_ns: int
    moments: tuple[Moment, ...]


def profile(recording: Recording) -> Profile:
    """The recording's commands as steps of a profile, its first sample at time 0.

    Raises UsageError if it holds no sample.
    """
    script = _script(recording, ())
    tracks = {name: _track(script, name) for name in Commands._fields}
    return Profile(
        description=f"commands of {recording.path}",
        duration=script.duration_ns / 1e9,
        parameters={},
        reset=False,
        commands=tracks,
        expectations=(),
    )


def script(recording: Recording) -> Script:
    """The recording's commands, resets and changes of parameters at their times.

    Raises UsageError if it holds no sample.
    """
    return _script(recording, recording.events)


def from_start_state(script: Script) -> Script:
    """``script`` with a reset before everything else."""
    first, *others = script.moments
    return replace(script, moments=(replace(first, acts=(Reset(), *first.acts)), *others))


def require_edges(script: Script, chunk_ns: int) -> None:
    """Raise UsageError where something is done within a chunk, chunks being of ``chunk_ns``."""
    times = [moment.time_ns for moment in script.moments]
    inside = next((time_ns for time_ns in times if time_ns % chunk_ns), None)
    if inside is not None:
        fitting = math.gcd(*times, chunk_ns) / 1e9
        raise UsageError(
            f"the recording has commands or events {inside / 1e9:.9g} s after its first sample, within a "
            f"chunk of the gearbox's solver.chunk = {chunk_ns / 1e9:.9g} s: start the gearbox with "
            f"solver.chunk = {fitting:.9g} s"
        )


def left_out_of_profile(recording: Recording) -> Counter[str]:
    """How many of which kind of event ``profile`` does without."""
    changes = [event for event in _events(recording, CHANGE) if event.parameters.keys() - COMMANDED]
    return Counter(
        {
            "parameter changes": len(changes),
            "resets": len(_events(recording, RESET)),
            "restored checkpoints": len(_events(recording, RESTORE)),
        }
    )


def left_out_of_script(recording: Recording) -> Counter[str]:
    """How many of which kind of event ``script`` does without."""
    paced = [event for event in _events(recording, CHANGE) if any(map(_sets_tempo, event.parameters))]
    return Counter(
        {
            "changes of pacing or stepping": len(paced),
            "restored checkpoints": len(_events(recording, RESTORE)),
        }
    )


def starts_from_start_state(recording: Recording) -> bool:
    """Whether the recording's first sample is the first after a start or a reset."""
    return bool(recording.start.state.get("steps") == 0)


def _script(recording: Recording, events: Sequence[OperatorEvent]) -> Script:
    first, end = recording.first_sample, recording.end_sample
    if first == end:
        raise UsageError(f"'{recording.path}' holds no sample: nothing to play")
    interval_ns = recording.sample_interval_ns
    acts: defaultdict[int, list[Act]] = defaultdict(list)
    for event in events:
        if first <= event.sample < end:
            acts[event.sample].extend(_acts(event))
    commands = {max(sample, first): commands for sample, commands in recording.commands if sample < end}
    in_force = recording.start.commands
    moments: list[Moment] = []
    for sample in sorted({first} | acts.keys() | commands.keys()):
        # After a reset the gearbox has commands of its own parameters: those in force are said again.
        new = commands.get(sample, in_force)
        if not moments or acts[sample] or new != in_force:
            moments.append(Moment((sample - first) * interval_ns, tuple(acts[sample]), new))
        in_force = new
    return Script((end - first) * interval_ns, tuple(moments))


def _acts(event: OperatorEvent) -> list[Act]:
    if event.kind == RESET:
        return [Reset()]
    if event.kind == CHANGE:
        parameters = {name: value for name, value in event.parameters.items() if not _sets_tempo(name)}
        return [Change(parameters)] if parameters else []
    return []


def _events(recording: Recording, kind: str) -> list[OperatorEvent]:
    first, end = recording.first_sample, recording.end_sample
    return [event for event in recording.events if event.kind == kind and first <= event.sample < end]


def _sets_tempo(name: str) -> bool:
    return name.startswith(TEMPO)


def _track(script: Script, name: str) -> Track:
    pieces: list[Segment] = []
    for moment in script.moments:
        value = float(getattr(moment.commands, name))
        if not pieces or value != pieces[-1].final:
            time = moment.time_ns / 1e9
            pieces.append(Segment(time, time, value, value))
    return Track(tuple(pieces))
