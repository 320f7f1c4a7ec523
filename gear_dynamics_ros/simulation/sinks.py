"""Sinks: receivers of the chunks and messages of a run."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record


class Sink(Protocol):
    """Receives the output of a run; owns what it keeps."""

    def wanted(self) -> Collection[str]:
        """Which of CHUNK_TOPICS ``write`` must get of the next chunk; it may get others too."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Take messages in order of time, and their chunk; None for messages between two chunks."""

    def close(self) -> None:
        """Finish. No ``write`` follows."""


class ChunkWriter(Protocol):
    """The methods of a viewer that ``ViewerSink`` calls."""

    def write(self, chunk: Chunk) -> None: ...

    def close(self) -> None: ...


class ViewerSink:
    """Gives the chunks of a run to a viewer."""

    def __init__(self, viewer: ChunkWriter) -> None:
        self._viewer = viewer

    def wanted(self) -> Collection[str]:
        return ()

    def write(self, chunk: Chunk | None, _: Sequence[Record]) -> None:
        if chunk is not None:
            self._viewer.write(chunk)

    def close(self) -> None:
        self._viewer.close()
