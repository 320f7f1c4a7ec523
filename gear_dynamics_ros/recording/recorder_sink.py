"""A sink that records."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.engine import Engine


class RecorderSink:
    """Gives the messages of a run to a recorder. The run continues if the recorder stops with an error.

    Stores checkpoints and begins new parts at the ends of chunks, as the parameters in force require.
    """

    def __init__(self, recorder: Recorder, engine: Engine) -> None:
        self.recorder = recorder
        self._engine = engine
        self._part_began = self._last_checkpoint = engine.sample

    def wanted(self) -> Collection[str]:
        return self.recorder.topics

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        self.recorder.write(records)
        if chunk is not None:
            self._split_or_checkpoint()

    def split(self) -> None:
        """Begin a new part."""
        self._part_began = self._last_checkpoint = self._engine.sample
        self.recorder.split(self._engine.checkpoint())

    def conclude(self) -> None:
        """Store the present checkpoint as the end of the recording."""
        self.recorder.conclude(self._engine.checkpoint())

    def close(self) -> None:
        self.conclude()
        self.recorder.close()

    def _split_or_checkpoint(self) -> None:
        """Begin a new part, or store a checkpoint, if it is time."""
        recording = self._engine.parameters.recording
        too_large = 0 < recording.split_size <= self.recorder.part_bytes
        too_long = 0.0 < recording.split_duration <= self._seconds(self._part_began)
        if too_large or too_long:
            self.split()
        elif 0.0 < recording.checkpoint_interval <= self._seconds(self._last_checkpoint):
            self._last_checkpoint = self._engine.sample
            self.recorder.checkpoint(self._engine.checkpoint())

    def _seconds(self, since: int) -> float:
        """Simulated time since the sample ``since``, s."""
        return (self._engine.sample - since) * self._engine.parameters.solver.sample_interval_ns / 1e9
