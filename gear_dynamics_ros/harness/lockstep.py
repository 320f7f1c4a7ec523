"""The script of a profile: each of its commands at exactly its sample."""

from __future__ import annotations

import math

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.harness.profile import Profile, require_sampling
from gear_dynamics_ros.script import (
    ChangeAction,
    LockstepScript,
    ResetAction,
    ScriptAction,
    ScriptStep,
    agree,
    require_chunk_edges,
)

_UNSET = Commands(math.nan, math.nan, math.nan)


def profile_script(profile: Profile, chunk_ns: int) -> LockstepScript:
    """The script of ``profile`` for a gearbox with chunks of ``chunk_ns``: new values at chunk edges only.

    Raises UsageError if an entry of the profile starts or ends within a chunk, and GearboxError if chunks are
    too long for a frequency in the profile.
    """
    require_sampling(profile, chunk_ns / 1e9)
    duration_ns = round(profile.duration * 1e9)
    knots = {0: _UNSET, **dict.fromkeys(sorted(profile.knots_ns), _UNSET)}
    outline = tuple(ScriptStep(time_ns, (), commands) for time_ns, commands in knots.items())
    require_chunk_edges(LockstepScript("the profile", duration_ns, outline), chunk_ns)
    steps = [ScriptStep(0, _actions(profile), _commands(profile, 0))]
    for time_ns in range(chunk_ns, duration_ns, chunk_ns):
        commands = _commands(profile, time_ns)
        last = steps[-1].commands
        if not (agree(commands, last) and agree(last, commands)):
            steps.append(ScriptStep(time_ns, (), commands))
    return LockstepScript("the profile", duration_ns, tuple(steps))


def _actions(profile: Profile) -> tuple[ScriptAction, ...]:
    change = [ChangeAction(profile.parameters)] if profile.parameters else []
    return (*change, *([ResetAction()] if profile.reset else []))


def _commands(profile: Profile, time_ns: int) -> Commands:
    values = {name: track.value(time_ns / 1e9) for name, track in profile.commands.items()}
    return _UNSET._replace(**{name: value for name, value in values.items() if value is not None})
