"""The recordings that one run of the node makes, one after another."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.ring import Excerpt, Ring
from gear_dynamics_ros.recording.sink import RecorderSink
from gear_dynamics_ros.simulation.run import Run

T = TypeVar("T")


class Recordings:
    """Starts and ends recordings of ``run``; the first at ``recording.path``, later ones beside it."""

    def __init__(self, run: Run, epoch_ns: int, node: str) -> None:
        wanted = run.engine.parameters.recording
        self._path = Path(wanted.path).absolute() if wanted.path else None
        self._run = run
        self._epoch_ns = epoch_ns
        self._node = node
        self._sink: RecorderSink | None = None
        self._ring: Ring | None = None
        self.refusal = ""  # why a recording that was wanted did not begin

    @property
    def wanted(self) -> bool:
        """Whether there is a path to record to."""
        return self._path is not None

    @property
    def current(self) -> Recorder | None:
        """The recorder at work, also after an error of its own."""
        return self._sink.recorder if self._sink is not None else None

    @property
    def ring(self) -> Ring | None:
        """The ring, where there is one."""
        return self._ring

    def arm(self) -> None:
        """Keep the last ``recording.ring_duration`` in memory from the next sample on."""
        self._ring = Ring(self._run.engine)
        self._run.attach(self._ring)

    def begin(self, *, beside: bool) -> str:
        """Record from the next sample on; returns where.

        ``beside`` takes the first free of path, path_2, path_3, ... Raises UsageError if the path exists or
        can't be made, GearboxError if there is none or a recording runs; ``refusal`` keeps why.
        """
        path = self._require_path()
        if self._sink is not None:
            raise GearboxError(f"already recording to {self._sink.recorder.path}: switch it off first")
        engine = self._run.engine

        def make(there: Path) -> Recorder:
            return Recorder(there, engine.parameters, self._run.checkpoint(), self._epoch_ns, self._node)

        try:
            recorder = _make_beside(path, make) if beside else make(path)
        except GearboxError as error:
            self.refusal = str(error)
            raise
        self.refusal = ""
        self._sink = RecorderSink(recorder, engine)
        self._run.attach(self._sink)
        return str(recorder.path)

    def split(self) -> None:
        """Go on in a new file. Raises GearboxError if nothing is recorded."""
        if self._sink is None:
            raise GearboxError("nothing is recorded: call ~/record first")
        if self._sink.recorder.error is not None:
            raise GearboxError(self._sink.recorder.error)
        self._sink.split()

    def end(self) -> Recorder | None:
        """Record no more; the caller closes what is returned."""
        if self._sink is None:
            return None
        sink, self._sink = self._sink, None
        self._run.detach(sink)
        sink.conclude()
        return sink.recorder

    def cut(self) -> Excerpt:
        """What the ring holds now. Raises GearboxError if there is none."""
        if self._ring is None:
            raise GearboxError(
                "there is no ring to take a snapshot of: start the node with recording.mode = 'ring' and a "
                "recording.path"
            )
        return self._ring.cut()

    def write(self, excerpt: Excerpt) -> Path:
        """Make a recording of an excerpt, the first free of path, path_2, ...; returns where.

        Takes as long as the disk does. Raises GearboxError if it can't be written.
        """
        return _make_beside(
            self._require_path(), lambda path: excerpt.write(path, self._epoch_ns, self._node)
        )

    def _require_path(self) -> Path:
        if self._path is None:
            raise GearboxError("recording.path is empty: start the node with a path to record to")
        return self._path


def _make_beside(path: Path, make: Callable[[Path], T]) -> T:
    """What ``make`` makes at the first free of path, path_2, ...; another thread may be faster at a name."""
    while True:
        free = _free(path)
        try:
            return make(free)
        except UsageError:
            if not os.path.lexists(free):
                raise


def _free(path: Path) -> Path:
    numbered = (path.with_name(f"{path.name}_{number}") for number in itertools.count(2))
    return next(
        candidate for candidate in itertools.chain([path], numbered) if not os.path.lexists(candidate)
    )
