"""The recordings that one run of the node makes, one after another."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages import Record
from gear_dynamics_ros.recording.writer import Recorder
from gear_dynamics_ros.run import Run
from gear_dynamics_ros.signals import Chunk


class RecorderSink:
    """A recorder in a run that goes on without it: what it can't write it counts; ``error`` says why."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder

    def write(self, _: Chunk | None, records: Sequence[Record]) -> None:
        self.recorder.write(records)

    def close(self) -> None:
        self.recorder.close()


class Recordings:
    """Starts and ends recordings of ``run``; the first at ``path``, later ones beside it."""

    def __init__(self, path: str, run: Run, epoch_ns: int, node: str) -> None:
        self._path = Path(path).absolute() if path else None
        self._run = run
        self._epoch_ns = epoch_ns
        self._node = node
        self._sink: RecorderSink | None = None

    @property
    def wanted(self) -> bool:
        """Whether there is a path to record to."""
        return self._path is not None

    @property
    def current(self) -> Recorder | None:
        """The recorder at work, also after an error of its own."""
        return self._sink.recorder if self._sink is not None else None

    def begin(self, *, beside: bool) -> str:
        """Record from the next sample on; returns where.

        ``beside`` takes the first free of path, path_2, path_3, ... Raises UsageError if the path exists or
        can't be made, GearboxError if there is none or a recording runs.
        """
        if self._path is None:
            raise GearboxError("recording.path is empty: start the node with a path to record to")
        if self._sink is not None:
            raise GearboxError(f"already recording to {self._sink.recorder.path}: switch it off first")
        path = _free(self._path) if beside else self._path
        parameters = self._run.engine.parameters
        recorder = Recorder(path, parameters, self._run.checkpoint(), self._epoch_ns, self._node)
        self._sink = RecorderSink(recorder)
        self._run.attach(self._sink)
        return str(recorder.path)

    def split(self) -> None:
        """Go on in a new file. Raises GearboxError if nothing is recorded."""
        if self._sink is None:
            raise GearboxError("nothing is recorded: call ~/record first")
        self._sink.recorder.split(self._run.checkpoint(), self._run.engine.parameters)

    def end(self) -> Recorder | None:
        """Record no more; the caller closes what is returned."""
        if self._sink is None:
            return None
        sink, self._sink = self._sink, None
        self._run.detach(sink)
        return sink.recorder


def _free(path: Path) -> Path:
    numbered = (path.with_name(f"{path.name}_{number}") for number in itertools.count(2))
    return next(
        candidate for candidate in itertools.chain([path], numbered) if not os.path.lexists(candidate)
    )
