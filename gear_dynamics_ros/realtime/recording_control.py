"""Controls the recordings of one run of the node."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.recording.ring import Excerpt, Ring
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import NodeNames

T = TypeVar("T")


class RecordingControl:
    """Begins and ends the recordings of ``run``; the first at ``recording.path``, later ones beside it.

    ``errors`` has all errors of all recordings. ``begin``, ``split``, ``end`` and ``cut`` must be called
    between two chunks, on the engine's thread; ``close`` and ``write`` wait for the disk and may be called on
    any other thread.
    """

    def __init__(self, run: Run, epoch_ns: int, names: NodeNames) -> None:
        wanted = run.engine.parameters.recording
        self._path = Path(wanted.path).absolute() if wanted.path else None
        self._run = run
        self._epoch_ns = epoch_ns
        self._names = names
        self._sink: RecorderSink | None = None
        self._ring: Ring | None = None
        self._errors: dict[str, None] = {}  # an ordered set; several threads add to it
        self.refusal = ""  # why the last requested recording did not begin; empty if it did
        self.snapshot_path = ""  # of the last snapshot written

    @property
    def errors(self) -> Sequence[str]:
        """All errors of recordings of this run, each text once, in order.

        They are of recordings that could not begin, recorders that stopped, and snapshots that could not be
        written.
        """
        return tuple(self._errors)

    @property
    def wanted(self) -> bool:
        """Whether there is a path to record to."""
        return self._path is not None

    @property
    def current(self) -> Recorder | None:
        """The present recorder, also after it stopped with an error; None if nothing is recorded."""
        return self._sink.recorder if self._sink is not None else None

    @property
    def ring(self) -> Ring | None:
        """The ring, None if there is none."""
        return self._ring

    def arm(self) -> None:
        """Keep the last ``recording.ring_duration`` in memory from the next sample on."""
        self._ring = Ring(self._run.engine)
        self._run.attach(self._ring)

    def begin(self, *, beside: bool) -> str:
        """Record from the next sample on; returns the path of the recording.

        ``beside`` takes the first free of path, path_2, path_3, ... A recorder that stopped with an error
        is replaced. Raises UsageError if the path exists or can't be created, GearboxError if it can't be
        written; ``errors`` and ``refusal`` then have the reason. Raises GearboxError too if there is no path
        or a recording is in progress.
        """
        path = self._require_path()
        self._drop_stopped()
        if self._sink is not None:
            raise GearboxError(f"already recording to {self._sink.recorder.path}: switch it off first")
        try:
            recorder = _make_beside(path, self._recorder) if beside else self._recorder(path)
        except GearboxError as error:
            self.refusal = str(error)
            self._note(self.refusal)
            raise
        self.refusal = ""
        self._sink = RecorderSink(recorder, self._run.engine)
        self._run.attach(self._sink)
        return str(recorder.path)

    def split(self) -> None:
        """Begin a new part. Raises GearboxError if nothing is recorded."""
        if self._sink is None:
            raise GearboxError("nothing is recorded: call ~/record first")
        if self._sink.recorder.error is not None:
            raise GearboxError(self._sink.recorder.error)
        self._sink.split()

    def end(self) -> Recorder | None:
        """Stop recording; ``close`` must finish the returned recorder. None if nothing was recorded."""
        if self._sink is None:
            return None
        sink, self._sink = self._sink, None
        self._run.detach(sink)
        sink.conclude()
        return sink.recorder

    def close(self, recorder: Recorder) -> Path:
        """Finish a recording that was ended; returns its path. Raises GearboxError if it is incomplete."""
        recorder.close()
        if recorder.error is not None:
            raise GearboxError(recorder.error)
        return recorder.path

    def cut(self) -> Excerpt:
        """The present content of the ring. Raises GearboxError if there is no ring."""
        if self._ring is None:
            raise GearboxError(
                "there is no ring to take a snapshot of: start the node with recording.mode = 'ring' and a "
                "recording.path"
            )
        return self._ring.cut()

    def write(self, excerpt: Excerpt) -> Path:
        """Make a recording of an excerpt at the first free of path, path_2, ...; returns its path.

        Raises GearboxError if it can't be written; ``errors`` then has the reason.
        """
        try:
            path = _make_beside(
                self._require_path(), lambda path: excerpt.write(path, self._epoch_ns, self._names)
            )
        except GearboxError as error:
            self._note(str(error))
            raise
        self.snapshot_path = str(path)
        return path

    def _recorder(self, path: Path) -> Recorder:
        return Recorder(path, self._run.checkpoint(), self._epoch_ns, self._names, report=self._note)

    def _drop_stopped(self) -> None:
        if self._sink is not None and self._sink.recorder.error is not None:
            recorder = self.end()
            if recorder is not None:
                recorder.close()

    def _note(self, error: str) -> None:
        self._errors.setdefault(error)

    def _require_path(self) -> Path:
        if self._path is None:
            raise GearboxError("recording.path is empty: start the node with a path to record to")
        return self._path


def _make_beside(path: Path, make: Callable[[Path], T]) -> T:
    """Result of ``make`` at the first free of path, path_2, ... Repeats if another thread took the name."""
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
