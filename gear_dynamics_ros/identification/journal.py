"""The trials of a fit on disk, batch by batch, so that a fit goes on where it was interrupted."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.system.files import output_file

REQUEST_FILE: Final = "fit.json"
BATCHES_FOLDER: Final = "evaluations"

Batch = Mapping[str, NDArray[Any]]


class FitJournal:
    """Batches of trials in the folder of a fit, in the order in which the search asked for them.

    A search without chance asks for the same batches again: each is then read instead of computed.
    """

    def __init__(self, folder: Path, known: int) -> None:
        """Use ``create`` or ``reopen``."""
        self.folder = folder
        self._known = known  # batches on disk
        self._next = 0

    @classmethod
    def create(cls, folder: Path, request: Mapping[str, Any]) -> FitJournal:
        """Journal in a new or empty ``folder``.

        Raises UsageError if it is neither, GearboxError if it can't be made.
        """
        require_unused(folder)
        try:
            (folder / BATCHES_FOLDER).mkdir(parents=True)
        except OSError as error:
            raise GearboxError(f"can't make '{folder}': {error.strerror}: choose a writable place") from error
        with output_file(folder / REQUEST_FILE) as stream:
            stream.write(_text(request).encode())
        return cls(folder, 0)

    @classmethod
    def reopen(cls, folder: Path, request: Mapping[str, Any]) -> FitJournal:
        """Journal of the same fit in ``folder``. Raises UsageError if it holds none, or another."""
        path = folder / REQUEST_FILE
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
        except OSError:
            raise UsageError(f"--resume: '{folder}' holds no fit: leave --resume out to begin one") from None
        except ValueError:
            raise UsageError(f"--resume: '{path}' is damaged: begin a new fit in another folder") from None
        for name, ours, theirs in _differences(json.loads(_text(request)), stored):
            raise UsageError(
                f"--resume: '{folder}' holds another fit: {name} is {theirs} there and {ours} here: "
                "ask for the same fit, or begin a new one in another folder"
            )
        known = 0
        while _batch_path(folder, known).exists():
            known += 1
        return cls(folder, known)

    @property
    def replaying(self) -> bool:
        """Whether the next batch is on disk already."""
        return self._next < self._known

    def recall(self, points: NDArray[np.float64]) -> Batch:
        """The next batch on disk. Raises GearboxError if it is damaged or not of ``points``."""
        path = _batch_path(self.folder, self._next)
        try:
            with np.load(path, allow_pickle=False) as content:
                batch = dict(content)
            same = batch["points"].tobytes() == points.tobytes()
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise GearboxError(
                f"'{path}' is damaged: remove it and all of a higher number, and resume again"
            ) from error
        if not same:
            raise GearboxError(
                f"'{path}' holds other trials than the search asks for here: remove it and all of a higher "
                "number, and resume again"
            )
        self._next += 1
        return batch

    def append(self, batch: Batch) -> None:
        """Store a batch, which has ``points``, behind the others. Raises GearboxError if that fails."""
        with output_file(_batch_path(self.folder, self._next)) as stream:
            np.savez(stream, allow_pickle=False, **batch)
        self._next += 1
        self._known = max(self._known, self._next)


def require_unused(folder: Path) -> None:
    """Raise UsageError unless ``folder`` is empty or does not exist."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(
            f"'{folder}' exists already: give --resume to go on with the fit in it, or choose another name"
        )


def _batch_path(folder: Path, number: int) -> Path:
    return folder / BATCHES_FOLDER / f"{number:06d}.npz"


def _text(request: Mapping[str, Any]) -> str:
    return json.dumps(request, indent=1, allow_nan=False) + "\n"


def _differences(ours: Any, theirs: Any, prefix: str = "") -> Sequence[tuple[str, Any, Any]]:
    """Dotted name and both values of each entry that differs."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        return [
            found
            for name in [*ours, *(name for name in theirs if name not in ours)]
            for found in _differences(
                ours.get(name, "missing"), theirs.get(name, "missing"), f"{prefix}{name}."
            )
        ]
    return [] if ours == theirs else [(prefix[:-1], _shown(ours), _shown(theirs))]


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:80]}..."
