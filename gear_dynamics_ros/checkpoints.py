"""Checkpoint files: the state of a gearbox between two samples with all that it depends on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from gear_dynamics_ros import __version__
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.files import replace_text
from gear_dynamics_ros.origin import model_hash
from gear_dynamics_ros.parameters import Parameters, differences, specifications, updated
from gear_dynamics_ros.signals import Status

# What decides the future of a state: whole groups but for some of their members.
_PHYSICS: Final = (
    "model",
    "mesh_geometry",
    "mesh_damping",
    "restitution_law",
    "mesh_phase",
    "gears",
    "mesh",
    "surface",
    "bearings",
    "oil",
    "operation",
    "solver",
)
_NO_PHYSICS: Final = (
    "operation.command_timeout",  # in wall time, as what follows it
    "operation.on_timeout",
    "operation.initial",  # what comes after a reset
    "solver.chunk",
)


class Saved(NamedTuple):
    """What a checkpoint file holds."""

    parameters: Parameters  # in force
    checkpoint: dict[str, Any]  # as ``Engine.resume`` takes it
    version: str  # of the package that wrote it
    model_hash: str  # of its source, see ``Provenance``
    history: str = ""  # in a recording: SHA-256 of what led to it; empty elsewhere


def require_place(path: Path) -> None:
    """Raise UsageError unless a checkpoint can stand at ``path``."""
    if os.path.isdir(path):
        raise UsageError(f"checkpoint.path: '{path}' is a folder: name a file in it")
    if not os.path.isdir(path.parent):
        raise UsageError(
            f"checkpoint.path: the folder '{path.parent}' does not exist: make it or choose another path"
        )


def take(engine: Engine) -> Saved:
    """The state of this moment. Raises GearboxError if the run has ended: nothing could go on from it."""
    if engine.status is not Status.RUNNING:
        raise GearboxError("no checkpoint can be taken: the run has ended; reset it first")
    return of_this_version(engine.parameters, engine.checkpoint())


def of_this_version(parameters: Parameters, checkpoint: dict[str, Any], history: str = "") -> Saved:
    """A state of this process's own."""
    return Saved(parameters, checkpoint, __version__, model_hash(), history)


def to_text(saved: Saved) -> str:
    """Text of a checkpoint file."""
    return json.dumps(saved._asdict() | {"parameters": saved.parameters.to_flat()}, indent=1)


def from_text(text: str, name: str) -> Saved:
    """Inverse of ``to_text``; ``name`` is what errors call it. Raises UsageError if it is no checkpoint."""
    try:
        content = json.loads(text)
        return Saved(
            Parameters.from_flat(_mapping(content["parameters"])),
            _mapping(content["checkpoint"]),
            str(content["version"]),
            str(content["model_hash"]),
            str(content.get("history", "")),
        )
    except UsageError as error:
        raise UsageError(f"checkpoint '{name}': {error}") from None
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        reason = " ".join(f"{error!r}".split())
        raise UsageError(f"'{name}' is no checkpoint, or it is spoilt: {reason}") from None


def save(path: Path, saved: Saved) -> None:
    """Write ``saved`` to ``path``; an earlier file there is replaced in one moment or stays.

    Raises GearboxError if it can't be written.
    """
    try:
        replace_text(path, to_text(saved))
    except OSError as error:
        raise GearboxError(
            f"checkpoint '{path}' can't be written: {error.strerror}: free space or choose another path"
        ) from error


def load(path: Path) -> Saved:
    """What the checkpoint file ``path`` holds.

    Raises UsageError if there is none or if it is no checkpoint file, GearboxError if it can't be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UsageError(f"there is no checkpoint '{path}': name a file that was saved") from None
    except UnicodeDecodeError:
        raise UsageError(f"'{path}' is no checkpoint: it is no text") from None
    except OSError as error:
        raise GearboxError(f"checkpoint '{path}' can't be read: {error.strerror}") from error
    return from_text(text, str(path))


def require_fitting(saved: Saved, running: Parameters) -> None:
    """Raise UsageError unless a gearbox with the parameters ``running`` can go on from ``saved``.

    It can't under another model, nor where parameters differ that decide the physics and are fixed.
    """
    if saved.model_hash != model_hash():
        raise UsageError(
            f"the checkpoint is of model {saved.model_hash[:12]} (version {saved.version}), this is "
            f"{model_hash()[:12]} ({__version__}): use the version that wrote it, or save a new one"
        )
    before = running.to_flat()
    for name, value in differences(running, saved.parameters).items():
        if decides_physics(name) and not specifications()[name].runtime:
            raise UsageError(
                f"{name} = {before[name]!r} is fixed, but the checkpoint has {value!r}: "
                f"start with {name} = {value!r}"
            )


def continued(saved: Saved, running: Parameters) -> Parameters:
    """Parameters with which a gearbox that has ``running`` goes on from ``saved``.

    Whatever decides the physics is as it was saved; pacing, timeouts, outputs and files stay. Raises
    UsageError as ``require_fitting`` does.
    """
    require_fitting(saved, running)
    physics = {name: value for name, value in saved.parameters.to_flat().items() if decides_physics(name)}
    return updated(running, physics)


def decides_physics(name: str) -> bool:
    """Whether the parameter ``name`` (dotted) has a part in what follows from a state."""
    return name.split(".")[0] in _PHYSICS and name not in _NO_PHYSICS


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"{value!r:.40} is no mapping")
    return dict(value)
