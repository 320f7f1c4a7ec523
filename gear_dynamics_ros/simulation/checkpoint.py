"""The state of a run between two samples, and its text in files and recordings.

To *restore* a checkpoint sets state and simulated time. To *resume* from one sets the state alone: simulated
time continues.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.chunk import Commands, Status
from gear_dynamics_ros.errors import GearboxError, UsageError, one_line
from gear_dynamics_ros.parameters import Parameters, differences, specifications, updated
from gear_dynamics_ros.simulation.provenance import Provenance, current_provenance
from gear_dynamics_ros.system.files import replace_text

FORMAT: Final = 3
# Groups of parameters that decide how a state develops, without the exceptions below.
_PHYSICS_GROUPS: Final = (
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
_NAMES: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
_EXCEPTIONS: Final = (
    "operation.command_timeout",  # depends on wall time, and so does the reaction
    "operation.on_timeout",
    "operation.initial",  # acts at a reset only
    "solver.chunk",
)


class Checkpoint(NamedTuple):
    """Everything that decides how a run continues, taken between two samples."""

    sample: int  # index of the next sample
    status: Status
    commands: Commands  # in force
    state: Mapping[str, Any]  # entries of the kernel's state by name: a number, or (nested) lists of numbers
    parameters: Parameters  # in force

    def to_tree(self) -> dict[str, Any]:
        """Content as mappings, lists and numbers, which JSON stores without loss."""
        return {
            "sample": self.sample,
            "status": int(self.status),
            "commands": self.commands._asdict(),
            "state": dict(self.state),
            "parameters": self.parameters.to_flat(),
        }

    @classmethod
    def from_tree(cls, tree: Mapping[str, Any]) -> Checkpoint:
        """Inverse of ``to_tree``. The entries of ``state`` are checked later, by the engine.

        Raises GearboxError if an entry is missing or has the wrong type, UsageError on an invalid parameter.
        """
        try:
            return cls(
                _sample_index(tree["sample"]),
                Status(tree["status"]),
                Commands(**{name: float(value) for name, value in _mapping(tree["commands"]).items()}),
                _mapping(tree["state"]),
                Parameters.from_flat(_mapping(tree["parameters"])),
            )
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise GearboxError(
                f"an entry of the checkpoint is missing or invalid: {one_line(f'{error!r:.200}')}"
            ) from error


class StoredCheckpoint(NamedTuple):
    """Content of a checkpoint file, or of an attachment of a recording."""

    checkpoint: Checkpoint
    provenance: Provenance  # of the program that wrote it
    digest: str = ""  # in a recording: SHA-256 of the messages before it, hexadecimal; else empty

    def to_text(self) -> str:
        """JSON text."""
        content = {
            "format": FORMAT,
            "checkpoint": {**self.checkpoint.to_tree(), "state": _named(self.checkpoint.state)},
            "provenance": self.provenance._asdict(),
            "digest": self.digest,
        }
        return json.dumps(content, indent=1, allow_nan=False)

    @classmethod
    def from_text(cls, text: str, name: str) -> StoredCheckpoint:
        """Inverse of ``to_text``; errors refer to the checkpoint by ``name``.

        Raises UsageError if ``text`` is not a checkpoint of this format.
        """
        try:
            content = _mapping(json.loads(text))
            _require_format(content)
            provenance = _mapping(content["provenance"])
            return cls(
                _checkpoint(_mapping(content["checkpoint"])),
                Provenance(**{field: str(provenance[field]) for field in Provenance._fields}),
                str(content["digest"]),
            )
        except GearboxError as error:
            raise UsageError(f"checkpoint '{name}': {error}") from None
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise UsageError(
                f"'{name}' is not a checkpoint, or it is damaged: {one_line(f'{error!r:.200}')}"
            ) from None


def require_place(path: Path) -> None:
    """Raise UsageError if ``path`` is a folder, or lies in a folder that does not exist."""
    if os.path.isdir(path):
        raise UsageError(f"checkpoint.path: '{path}' is a folder: name a file in it")
    if not os.path.isdir(path.parent):
        raise UsageError(
            f"checkpoint.path: the folder '{path.parent}' does not exist: make it or choose another path"
        )


def require_running(checkpoint: Checkpoint) -> None:
    """Raise GearboxError if the run had ended: such a state can't be continued."""
    if checkpoint.status is not Status.RUNNING:
        raise GearboxError("the checkpoint is of a run that had ended: take an earlier one")


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write ``checkpoint`` to ``path``. An earlier file is replaced at once, or stays if writing fails.

    Raises GearboxError if the run has ended or the file can't be written.
    """
    if checkpoint.status is not Status.RUNNING:
        raise GearboxError("no checkpoint can be saved: the run has ended; reset it first")
    try:
        replace_text(path, StoredCheckpoint(checkpoint, current_provenance()).to_text())
    except OSError as error:
        raise GearboxError(
            f"checkpoint '{path}' can't be written: {error.strerror}: free space or choose another path"
        ) from error


def load_checkpoint(path: Path) -> StoredCheckpoint:
    """Read the checkpoint file ``path``.

    Raises UsageError if it does not exist or is not a checkpoint file, GearboxError if it can't be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UsageError(f"there is no checkpoint '{path}': name a file that was saved") from None
    except UnicodeDecodeError:
        raise UsageError(f"'{path}' is not a checkpoint: it is not text") from None
    except OSError as error:
        raise GearboxError(f"checkpoint '{path}' can't be read: {error.strerror}") from error
    return StoredCheckpoint.from_text(text, str(path))


def require_fitting(stored: StoredCheckpoint, running: Parameters) -> None:
    """Raise UsageError unless a gearbox with the parameters ``running`` can continue from ``stored``.

    It can't if the model differs, or a parameter that decides the physics and is fixed at run time.
    """
    theirs, ours = stored.provenance, current_provenance()
    if theirs.model_hash != ours.model_hash:
        raise UsageError(
            f"the checkpoint is of model {theirs.model_hash[:12]} (version {theirs.version}), this is "
            f"{ours.model_hash[:12]} ({ours.version}): use the version that wrote it, or save a new one"
        )
    before = running.to_flat()
    for name, value in differences(running, stored.checkpoint.parameters).items():
        if decides_physics(name) and not specifications()[name].runtime:
            raise UsageError(
                f"{name} = {before[name]!r} is fixed, but the checkpoint has {value!r}: "
                f"start with {name} = {value!r}"
            )


def parameters_to_continue(stored: StoredCheckpoint, running: Parameters) -> Parameters:
    """Parameters for a gearbox with ``running`` that continues from ``stored``.

    Parameters that decide the physics are those of ``stored``; pacing, time-outs, outputs and files stay as
    in ``running``. Raises UsageError as ``require_fitting`` does.
    """
    require_fitting(stored, running)
    saved = stored.checkpoint.parameters.to_flat()
    return updated(running, {name: value for name, value in saved.items() if decides_physics(name)})


def decides_physics(name: str) -> bool:
    """Whether the parameter ``name`` (dotted) influences how a state develops."""
    return name.split(".")[0] in _PHYSICS_GROUPS and name not in _EXCEPTIONS


def _checkpoint(tree: Mapping[str, Any]) -> Checkpoint:
    return Checkpoint.from_tree({**tree, "state": _unnamed(_mapping(tree["state"]))})


def _named(value: Any) -> Any:
    """``value`` with names for the numbers that JSON does not have: a run may end with them."""
    if isinstance(value, Mapping):
        return {key: _named(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_named(entry) for entry in value]
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite else next(name for name, same in _NAMES.items() if repr(same) == repr(value))


def _unnamed(value: Any) -> Any:
    """Inverse of ``_named``."""
    if isinstance(value, Mapping):
        return {key: _unnamed(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_unnamed(entry) for entry in value]
    return _NAMES.get(value, value) if isinstance(value, str) else value


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"{value!r:.40} is not a mapping")
    return dict(value)


def _require_format(content: Mapping[str, Any]) -> None:
    form = content.get("format")
    if form != FORMAT:
        raise GearboxError(
            f"it has the format {form!r:.40}, this version reads {FORMAT}: use the version that wrote it"
        )


def _sample_index(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
        raise ValueError(f"{value!r:.40} is not an index of a sample")
    return value
