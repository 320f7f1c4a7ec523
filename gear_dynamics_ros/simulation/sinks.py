"""Where the chunks and messages of a run go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record


class Sink(Protocol):
    """Takes what a run makes; owns what it keeps."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Messages in order of time, and the chunk they came from; no chunk for what happens between two."""

    def close(self) -> None:
        """Finish; nothing is written afterwards."""


class ChunkWriter(Protocol):
    """What ``ViewerSink`` needs of a viewer."""

    def write(self, chunk: Chunk) -> None: ...

    def close(self) -> None: ...


class ViewerSink:
    """Gives a viewer the chunks of a run."""

    def __init__(self, viewer: ChunkWriter) -> None:
        self._viewer = viewer

    def write(self, chunk: Chunk | None, _: Sequence[Record]) -> None:
        if chunk is not None:
            self._viewer.write(chunk)

    def close(self) -> None:
        self._viewer.close()
