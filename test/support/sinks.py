"""Sinks of a run."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.topics import CHUNK_TOPICS


class Keeper:
    """Keeps everything."""

    def __init__(self) -> None:
        self.chunks: list[Chunk] = []
        self.records: list[Record] = []
        self.closed = False

    def wanted(self) -> Collection[str]:
        return CHUNK_TOPICS

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        if chunk is not None:
            self.chunks.append(chunk)
        self.records.extend(records)

    def close(self) -> None:
        self.closed = True
