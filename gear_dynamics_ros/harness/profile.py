"""The profile file: parameters and commands for the gearbox, expectations on its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness import fields
from gear_dynamics_ros.harness.expectations import Expectation, parse_expectations
from gear_dynamics_ros.harness.tracks import Track, parse_track
from gear_dynamics_ros.parameters import Parameters, specifications
from gear_dynamics_ros.parameters.rcl_yaml import parse_yaml

Setting: TypeAlias = bool | int | float | str | list[float] | list[str]

_KEYS = ("description", "duration", "parameters", "reset", "commands", "expectations")


@dataclass(frozen=True, slots=True)
class Profile:
    """Parameters by dotted name, commands over time, and what the outputs are expected to show."""

    description: str
    duration: float  # s
    parameters: Mapping[str, Setting]
    reset: bool  # back to the start state before time 0, with these parameters
    commands: Mapping[str, Track]
    expectations: tuple[Expectation, ...]


def load_profile(path: Path) -> Profile:
    """Read a profile file. Raises UsageError in one line naming file, entry, value and limit."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"profile {path}: {reason}; name a readable YAML file") from error
    try:
        return parse_profile(parse_yaml(text), path.parent)
    except UsageError as error:
        raise UsageError(f"profile {path}: {error}") from error


def parse_profile(data: object, folder: Path) -> Profile:
    """Profile from the tree of its YAML file, which lies in ``folder``.

    Raises UsageError on anything not understood.
    """
    tree = fields.mapping(data, "the profile", _KEYS)
    commands = fields.mapping(tree.get("commands", {}), "commands", Commands._fields)
    tracks = {name: parse_track(name, entries, folder) for name, entries in commands.items()}
    expectations = parse_expectations(tree.get("expectations", []))
    ends = [track.end for track in tracks.values()] + [expectation.end for expectation in expectations]
    last = max(ends, default=0.0)
    duration = fields.number(tree, "duration", "the profile") if "duration" in tree else last
    if duration < last:
        raise UsageError(
            f"duration is {duration:g} s, but an entry ends at {last:g} s: make it at least that long"
        )
    if duration <= 0.0:
        raise UsageError(f"duration is {duration:g} s, must be > 0: nothing to play")
    description = fields.text(tree, "description", "the profile", "")
    return Profile(
        description,
        duration,
        _parameters(tree.get("parameters", {})),
        fields.switch(tree, "reset", "the profile", False),
        tracks,
        expectations,
    )


def _parameters(tree: object) -> Mapping[str, Setting]:
    """Only names and form are checked here: what may be set, and to what, is for the gearbox to say."""
    if not isinstance(tree, Mapping):
        raise UsageError(f"parameters is {tree!r}, must be a mapping of dotted names to values")
    settings = {str(name): _setting(f"parameters.{name}", value) for name, value in tree.items()}
    try:
        # The gearbox would only say that something unknown was set.
        Parameters.from_flat(
            {name: value for name, value in settings.items() if name not in specifications()}
        )
    except UsageError as error:
        raise UsageError(f"parameters: {error}") from error
    return settings


def _setting(where: str, value: object) -> Setting:
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list) and value:
        if all(isinstance(entry, str) for entry in value):
            return [str(entry) for entry in value]
        if all(isinstance(entry, int | float) and not isinstance(entry, bool) for entry in value):
            return [float(entry) for entry in value]
    raise UsageError(
        f"{where} is {value!r}, must be one value or a list of numbers or of texts: write nested "
        "names with dots, as in operation.control"
    )
