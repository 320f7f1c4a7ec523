"""A recorder as a sink of a run."""

from __future__ import annotations

from collections.abc import Sequence

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.engine import Engine


class RecorderSink:
    """A recorder in a run that goes on without it: what it can't write it counts; ``error`` says why.

    Keeps checkpoints and begins new files at the ends of chunks, as the parameters in force say.
    """

    def __init__(self, recorder: Recorder, engine: Engine) -> None:
        self.recorder = recorder
        self._engine = engine
        self._part_began = self._marked = engine.sample

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        self.recorder.write(records)
        if chunk is not None:
            self._mark()

    def split(self) -> None:
        """Go on in a new file."""
        self._part_began = self._marked = self._engine.sample
        self.recorder.split(self._engine.checkpoint())

    def conclude(self) -> None:
        """Let the recording end with the state of this moment."""
        self.recorder.conclude(self._engine.checkpoint())

    def close(self) -> None:
        self.conclude()
        self.recorder.close()

    def _mark(self) -> None:
        wanted = self._engine.parameters.recording
        if 0 < wanted.split_size <= self.recorder.part_bytes or 0.0 < wanted.split_duration <= self._seconds(
            self._part_began
        ):
            self.split()
        elif 0.0 < wanted.checkpoint_interval <= self._seconds(self._marked):
            self._marked = self._engine.sample
            self.recorder.checkpoint(self._engine.checkpoint())

    def _seconds(self, since: int) -> float:
        """Simulated time since a sample."""
        return (self._engine.sample - since) * self._engine.parameters.solver.sample_interval_ns / 1e9
