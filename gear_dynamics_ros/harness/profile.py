"""Profile files: parameters and commands for the gearbox, and expectations on its outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness import fields
from gear_dynamics_ros.harness.expectations import Expectation, parse_expectations
from gear_dynamics_ros.harness.tracks import CommandTrack, RampPiece, parse_track
from gear_dynamics_ros.parameters import Parameters, specifications
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.mappings import require_mapping
from gear_dynamics_ros.parameters.rcl_yaml import parse_yaml

ParameterSetting: TypeAlias = bool | int | float | str | list[float] | list[str]

_KEYS = ("description", "duration", "parameters", "reset", "commands", "expectations")


@dataclass(frozen=True, slots=True)
class Profile:
    """Parameters by dotted name, commands over time, and expectations on the outputs."""

    description: str
    duration: float  # s
    parameters: Mapping[str, ParameterSetting]
    reset: bool  # the gearbox before time 0 to its start state, with these parameters
    commands: Mapping[str, CommandTrack]
    expectations: tuple[Expectation, ...]

    @property
    def knots_ns(self) -> frozenset[int]:
        """Times in ns at which an entry of a command starts or ends."""
        pieces = [piece for track in self.commands.values() for piece in track.pieces]
        return frozenset(round(time * 1e9) for piece in pieces for time in (piece.start, piece.end))


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
    """Profile from ``data``, the content of a YAML file in ``folder``.

    Raises UsageError in one line naming entry, value and limit.
    """
    tree = require_mapping(data, "the profile", _KEYS)
    commands = require_mapping(tree.get("commands", {}), "commands", Commands._fields)
    tracks = {name: parse_track(name, entries, folder) for name, entries in commands.items()}
    expectations = parse_expectations(tree.get("expectations", []))
    ends = [track.end for track in tracks.values()] + [expectation.end for expectation in expectations]
    last = max(ends, default=0.0)
    duration = fields.require_number(tree, "duration", "the profile") if "duration" in tree else last
    if duration < last:
        raise UsageError(
            f"duration is {exact_text(duration)} s, but an entry ends at {exact_text(last)} s: "
            "make it at least that long"
        )
    if duration <= 0.0:
        raise UsageError(f"duration is {exact_text(duration)} s, must be > 0")
    description = fields.optional_text(tree, "description", "the profile", "")
    return Profile(
        description,
        duration,
        _parameters(tree.get("parameters", {})),
        fields.optional_flag(tree, "reset", "the profile", False),
        tracks,
        expectations,
    )


def require_sampling(profile: Profile, chunk: float) -> None:
    """Raise GearboxError if a command in each chunk of ``chunk`` s can't carry a frequency of ``profile``."""
    limit = 0.5 / chunk
    for name, track in profile.commands.items():
        if track.highest_frequency > limit:
            raise GearboxError(
                f"commands.{name} asks for {exact_text(track.highest_frequency)} Hz, but one command in "
                f"each chunk of {exact_text(chunk)} s carries at most {exact_text(limit)} Hz: lower it "
                "or shorten solver.chunk"
            )


def step_profile(description: str, duration: float, commands: Sequence[tuple[float, Commands]]) -> Profile:
    """Profile of ``duration`` s that sets commands in steps: ``commands`` are times in s, ascending from 0.

    A command whose value stays the same has no step.
    """
    return Profile(
        description=description,
        duration=duration,
        parameters={},
        reset=False,
        commands={name: _step_track(commands, name) for name in Commands._fields},
        expectations=(),
    )


def _step_track(commands: Sequence[tuple[float, Commands]], name: str) -> CommandTrack:
    pieces: list[RampPiece] = []
    for time, values in commands:
        value = float(getattr(values, name))
        if not pieces or value != pieces[-1].final:
            pieces.append(RampPiece(time, time, value, value))
    return CommandTrack(tuple(pieces))


def _parameters(tree: object) -> Mapping[str, ParameterSetting]:
    """Checks names and types; the gearbox checks whether a value may be set."""
    if not isinstance(tree, Mapping):
        raise UsageError(f"parameters is {tree!r}, must be a mapping of dotted names to values")
    settings = {str(name): _setting(f"parameters.{name}", value) for name, value in tree.items()}
    try:
        # To suggest the right name, which the gearbox does not.
        Parameters.from_flat(
            {name: value for name, value in settings.items() if name not in specifications()}
        )
    except UsageError as error:
        raise UsageError(f"parameters: {error}") from error
    return settings


def _setting(where: str, value: object) -> ParameterSetting:
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
