"""One run: commands in, engine, messages, sinks. The node and ``simulate`` differ only in who sets the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.messages import Encoder, Record
from gear_dynamics_ros.signals import Chunk, Commands, Status


class Sink(Protocol):
    """Where chunks go: recorder, publisher, viewer. A sink keeps what it needs; the caller keeps nothing."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Take a chunk with its messages, or messages alone."""

    def close(self) -> None:
        """Finish; called once."""


class Run:
    """Steps an engine in chunks and hands every chunk to the same sinks; no clock and no threads of its own."""

    def __init__(self, engine: Engine, encoder: Encoder, sinks: Sequence[Sink]) -> None:
        self.engine = engine
        self.sinks = list(sinks)
        self._encoder = encoder
        self._announce = True

    def step(self, commands: Commands | None = None) -> Chunk:
        """The next chunk, with ``commands`` in force from its first sample; what changed is told before it."""
        engine = self.engine
        if commands is not None and commands != engine.commands:
            engine.command(commands)
            self._announce = True
        if self._announce:
            self._send(None, [self._encoder.applied(engine.commands, engine.sample)])
            self._announce = False
        chunk = engine.advance()
        self._send(chunk, self._encoder.chunk(chunk))
        if chunk.status is not Status.RUNNING:
            self.note("end", chunk.message)
        return chunk

    def reset(self) -> None:
        """Back to the start state; simulated time goes on."""
        self.engine.reset()
        self.note("reset", "")
        self._announce = True

    def note(self, kind: str, message: str) -> None:
        """Tell the sinks of an event before the next sample."""
        self._send(None, [self._encoder.event(kind, self.engine.sample, message)])

    def close(self) -> None:
        """Close every sink."""
        for sink in self.sinks:
            sink.close()

    def _send(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        for sink in self.sinks:
            sink.write(chunk, records)
