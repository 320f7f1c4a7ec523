"""Scripts for a running gearbox from a recording: its commands alone, or all that was done to it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE, OperatorEvent
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.script import ChangeAction, LockstepScript, ResetAction, ScriptAction, ScriptStep

# Parameters that are commands too: a recording has their changes among its commands.
COMMAND_PARAMETERS = frozenset(f"operation.{name}" for name in Commands._fields)
# Parameters that decide when chunks are computed, not their content; in lockstep the client decides that.
PACING_PREFIXES = ("pacing.", "stepping.")


def command_script(recording: Recording) -> LockstepScript:
    """The commands of ``recording`` at their times, without its resets and changes of parameters.

    Raises UsageError if the recording has no samples.
    """
    return _script(recording, ())


def full_script(recording: Recording) -> LockstepScript:
    """The commands, resets and changes of parameters of ``recording`` at their times.

    Raises UsageError if the recording has no samples.
    """
    return _script(recording, recording.events)


def with_initial_reset(script: LockstepScript) -> LockstepScript:
    """``script`` with a reset as its first action."""
    first, *others = script.steps
    return replace(script, steps=(replace(first, actions=(ResetAction(), *first.actions)), *others))


def skipped_by_commands(recording: Recording) -> Counter[str]:
    """Number of events that ``command_script`` leaves out, by kind."""
    changes = [event for event in _events(recording, CHANGE) if event.parameters.keys() - COMMAND_PARAMETERS]
    return Counter(
        {
            "parameter changes": len(changes),
            "resets": len(_events(recording, RESET)),
            "restored checkpoints": len(_events(recording, RESTORE)),
        }
    )


def skipped_by_script(recording: Recording) -> Counter[str]:
    """Number of events that ``full_script`` leaves out, by kind."""
    paced = [event for event in _events(recording, CHANGE) if any(map(_sets_pacing, event.parameters))]
    return Counter(
        {
            "changes of pacing or stepping": len(paced),
            "restored checkpoints": len(_events(recording, RESTORE)),
        }
    )


def starts_at_start_state(recording: Recording) -> bool:
    """Whether the first sample of ``recording`` is the first after a start or a reset."""
    return bool(recording.start.state.get("steps") == 0)


def _script(recording: Recording, events: Sequence[OperatorEvent]) -> LockstepScript:
    first, end = recording.first_sample, recording.end_sample
    if first == end:
        raise UsageError(f"'{recording.path}' has no samples: nothing to play")
    interval_ns = recording.sample_interval_ns
    actions: defaultdict[int, list[ScriptAction]] = defaultdict(list)
    for event in events:
        if first <= event.sample < end:
            actions[event.sample].extend(_actions(event))
    commands = {max(sample, first): commands for sample, commands in recording.commands if sample < end}
    in_force = recording.start.commands
    steps: list[ScriptStep] = []
    for sample in sorted({first} | actions.keys() | commands.keys()):
        # A reset sets the commands to those of the gearbox's parameters: repeat the commands in force.
        new = commands.get(sample, in_force)
        if not steps or actions[sample] or new != in_force:
            steps.append(ScriptStep((sample - first) * interval_ns, tuple(actions[sample]), new))
        in_force = new
    return LockstepScript("the recording", (end - first) * interval_ns, tuple(steps))


def _actions(event: OperatorEvent) -> list[ScriptAction]:
    if event.kind == RESET:
        return [ResetAction()]
    if event.kind == CHANGE:
        parameters = {name: value for name, value in event.parameters.items() if not _sets_pacing(name)}
        return [ChangeAction(parameters)] if parameters else []
    return []


def _events(recording: Recording, kind: str) -> list[OperatorEvent]:
    first, end = recording.first_sample, recording.end_sample
    return [event for event in recording.events if event.kind == kind and first <= event.sample < end]


def _sets_pacing(name: str) -> bool:
    return name.startswith(PACING_PREFIXES)
