"""Sinks: receivers of the chunks and messages of a run."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from gear_dynamics_ros.channels import PACE
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.messages.decoder import MessageDecoder
from gear_dynamics_ros.messages.encoder import Record

_TIME, _REAL_TIME_FACTOR = (
    [entry.name for entry in PACE].index(name) for name in ("time", "real_time_factor")
)


class Sink(Protocol):
    """Receives the output of a run; owns what it keeps."""

    def wanted(self) -> Collection[str]:
        """Which of CHUNK_TOPICS ``write`` must get of the next chunk; it may get others too."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Take messages in order of time, and their chunk; None for messages between two chunks."""

    def close(self) -> None:
        """Finish. No ``write`` follows."""


class RunWatcher(Protocol):
    """The methods of a viewer that ``ViewerSink`` calls."""

    def write(self, chunk: Chunk) -> None: ...

    def write_event(self, event: OperatorEvent) -> None: ...

    def write_pace(self, time: float, real_time_factor: float) -> None: ...

    def close(self) -> None: ...


class ViewerSink:
    """Gives the chunks, operator events and pacing of a run to a viewer."""

    def __init__(self, viewer: RunWatcher) -> None:
        self._viewer = viewer
        self._decoder = MessageDecoder((), "", "the viewer")

    def wanted(self) -> Collection[str]:
        return ()

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        for record in records:
            if record.topic == "event":
                self._viewer.write_event(self._decoder.event(record.time_ns, record.data))
            elif record.topic == "pacing":
                for row in self._decoder.rows("pacing", record.time_ns, record.data).tolist():
                    self._viewer.write_pace(row[_TIME], row[_REAL_TIME_FACTOR])
        if chunk is not None:
            self._viewer.write(chunk)

    def close(self) -> None:
        self._viewer.close()
