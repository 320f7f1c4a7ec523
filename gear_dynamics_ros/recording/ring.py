"""Keeps the last seconds of a run in memory, to record them on request."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.topics import DEFAULT_NAMES, TOPICS, NodeNames

# The ring drops whole segments: it holds at most an eighth more than it must.
SEGMENTS: Final = 8
# Messages given to the recorder at once; it checks the disk in between.
BATCH: Final = 100
# Bytes of memory for a chunk beside its waveform: the other messages, and the objects that hold all of them.
CHUNK_SIZE: Final = 2500
# Bytes of memory for the checkpoint of a segment.
CHECKPOINT_SIZE: Final = 10_000


@dataclass(slots=True)
class _Segment:
    """Messages after a checkpoint; ``latched`` are the last ones before it, by key of the latched topic."""

    start: Checkpoint
    latched: Mapping[str, bytes]
    records: list[Record] = field(default_factory=list)
    size: int = 0  # bytes


class Excerpt(NamedTuple):
    """A section of a run that can become a recording."""

    segments: tuple[_Segment, ...]
    end: Checkpoint

    def write(self, path: Path, epoch_ns: int, names: NodeNames) -> Path:
        """Make a recording of it in the new folder ``path``; returns its absolute path.

        Raises UsageError if ``path`` exists or can't be created, GearboxError if writing fails.
        """
        first = self.segments[0]
        recorder = Recorder(path, first.start, epoch_ns, names)
        time_ns = epoch_ns + first.start.sample * first.start.parameters.solver.sample_interval_ns
        recorder.write([Record(key, time_ns, data) for key, data in first.latched.items()])
        for segment in self.segments:
            if segment is not first:
                recorder.checkpoint(segment.start)
            for begin in range(0, len(segment.records), BATCH):
                recorder.write(segment.records[begin : begin + BATCH])
        recorder.conclude(self.end)
        recorder.close()
        if recorder.error is not None:
            raise GearboxError(recorder.error)
        return recorder.path


def ring_size(parameters: Parameters) -> int:
    """Most memory that a ring with these parameters takes, bytes."""
    solver, recording = parameters.solver, parameters.recording
    seconds = (1.0 + 1.0 / SEGMENTS) * recording.ring_duration + solver.chunk
    waveform = 8 * len(parameters.waveform_channels) if "waveform" in recording.topics else 0
    messages = seconds * (waveform / solver.sample_interval + CHUNK_SIZE / solver.chunk)
    return round(messages) + (SEGMENTS + 2) * CHECKPOINT_SIZE


def require_memory(parameters: Parameters, available: int) -> None:
    """Raise UsageError if the ring would need more than ``available`` bytes of memory."""
    size = ring_size(parameters)
    if size > available:
        duration = parameters.recording.ring_duration
        fitting = math.floor(0.5 * duration * available / size)
        raise UsageError(
            f"recording.ring_duration = {exact_text(duration)} s needs up to {size / 1e9:.2f} GB of memory, "
            f"{available / 1e9:.2f} GB are available: reduce it to {fitting} s, or record fewer "
            "waveform_channels or recording.topics"
        )


class Ring:
    """A sink that keeps at least the last ``recording.ring_duration`` of simulated time."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        solver = engine.parameters.solver
        self._samples = round(engine.parameters.recording.ring_duration * 1e9 / solver.sample_interval_ns)
        self._topics = layout.recorded_topics(engine.parameters, DEFAULT_NAMES).keys()
        self._latched: dict[str, bytes] = {}
        self._segments: deque[_Segment] = deque()
        self._begin_segment()

    @property
    def samples(self) -> int:
        """Number of samples that the ring holds."""
        return self._samples_since(self._segments[0])

    @property
    def size(self) -> int:
        """Size of its messages, bytes."""
        return sum(segment.size for segment in self._segments)

    def wanted(self) -> Collection[str]:
        return self._topics

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Keep the messages, and drop those that are too old."""
        segment = self._segments[-1]
        kept = [record for record in records if record.topic in self._topics]
        segment.records.extend(kept)
        segment.size += sum(len(record.data) for record in kept)
        for record in kept:
            if TOPICS[record.topic].latched:
                self._latched[record.topic] = record.data
        if chunk is not None and (self._engine.sample - segment.start.sample) * SEGMENTS >= self._samples:
            self._begin_segment()
        while (
            len(self._segments) > 1 and self._engine.sample - self._segments[1].start.sample >= self._samples
        ):
            self._segments.popleft()

    def close(self) -> None:
        """Drop everything."""
        self._segments.clear()

    def cut(self) -> Excerpt:
        """Everything that the ring holds now. The ring continues."""
        *earlier, last = self._segments
        return Excerpt(
            (*earlier, _Segment(last.start, last.latched, list(last.records))), self._engine.checkpoint()
        )

    def _begin_segment(self) -> None:
        self._segments.append(_Segment(self._engine.checkpoint(), dict(self._latched)))

    def _samples_since(self, segment: _Segment) -> int:
        return self._engine.sample - segment.start.sample
