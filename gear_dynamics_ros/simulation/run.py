"""The loop that node and tools share: commands in, a chunk out, and every chunk to the same sinks.

No clock and no threads: the same parameters and the same calls give the same records, whoever sets the pace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from gear_dynamics_ros.chunk import Chunk, Commands, Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import (
    CHANGE,
    END,
    RESET,
    RESTORE,
    START,
    TIMEOUT,
)
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import OperationParameters, Parameters, differences
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.sinks import Sink


def commands_of_timeout(operation: OperationParameters) -> Mapping[str, float]:
    """Fields of Commands, with their values, that a time-out puts in force: none where it holds them."""
    return {"drive_torque": 0.0, "load_torque": 0.0} if operation.on_timeout == "release" else {}


class Run:
    """One engine, its messages and the sinks they go to.

    The commands in force are written before the first chunk, whenever they change, and to each sink attached
    later, stamped at the sample where they take effect. ``duration`` is simulated time in s, 0 for no end.
    """

    def __init__(
        self, engine: Engine, encoder: Encoder, sinks: Sequence[Sink] = (), *, duration: float = 0.0
    ) -> None:
        self.engine = engine
        self._encoder = encoder
        self._sinks = list(sinks)
        self._newcomers: list[Sink] = []
        self._begun = False
        self._applied: Commands | None = None  # commands last written, unless others came in force since
        self._last_sample = _samples(duration, engine.parameters.solver.sample_interval_ns)
        self._end = ""

    @property
    def end(self) -> str:
        """Why the run ended; empty while it can go on."""
        return self._end

    @property
    def completed(self) -> bool:
        """Whether ``pacing.duration`` has been simulated."""
        return self._last_sample is not None and self.engine.sample >= self._last_sample

    @property
    def tripped(self) -> bool:
        """Whether the engine itself ended the run; a reset recovers."""
        return self.engine.status is not Status.RUNNING

    def step(self, commands: Commands | None = None, received: Sequence[tuple[str, bytes]] = ()) -> Chunk:
        """The next chunk, with ``commands`` in force from its first sample on; at the end a shorter one.

        ``received`` are the messages (key in TOPICS, CDR) behind ``commands``; they are written as they came,
        before the change they caused. Raises GearboxError if the run has ended.
        """
        if self._end:
            raise GearboxError(f"the run has ended ({self._end}); reset it to go on")
        if commands is not None:
            self.engine.command(commands)
        heading, welcome = self._heading(received)
        chunk = self.engine.advance(self._chunk_samples())
        records = [*heading, *self._encoder.chunk(chunk)]
        newcomers, self._newcomers = self._newcomers, []
        _each(
            self._sinks,
            lambda sink: sink.write(chunk, [*welcome, *records] if sink in newcomers else records),
        )
        if chunk.status is not Status.RUNNING:
            self.finish(chunk.message)
        elif self.completed:
            self.finish("pacing.duration reached")
        return chunk

    def reset(self, message: str = "") -> None:
        """Back to the start state and the commands of the parameters; simulated time goes on."""
        self.engine.reset()
        self._end = ""
        self._note_commands()
        self.note(RESET, message)

    def change(self, parameters: Parameters) -> None:
        """Put ``parameters`` in force from the next sample on, as ``Engine.change`` does.

        Writes an event with the values that differ, and none if nothing does. Raises UsageError, changing
        nothing, where something differs that is fixed while the gearbox runs.
        """
        changed = differences(self.engine.parameters, parameters)
        if changed:
            self.engine.change(parameters)
            self._note_commands()
            self.note(CHANGE, parameters=changed)

    def resume(self, checkpoint: Checkpoint, message: str = "") -> None:
        """Go on from the state of ``checkpoint`` while simulated time goes on, as ``Engine.resume`` does.

        Writes an event ``restore``, as operators know it, with the whole checkpoint.

        Raises GearboxError, changing nothing, if it can't be one, or is of a run that had ended.
        """
        self.engine.resume(checkpoint)
        self._end = ""
        self._note_commands()
        self.note(RESTORE, message, checkpoint=checkpoint.to_tree())

    @property
    def unreleased(self) -> bool:
        """Whether torques are in force that a time-out would release."""
        in_force = self.engine.commands
        released = commands_of_timeout(self.engine.parameters.operation)
        return any(getattr(in_force, name) != value for name, value in released.items())

    def time_out(self) -> None:
        """Tell that no command came in time, and release the torques where operation.on_timeout says so."""
        operation = self.engine.parameters.operation
        released = commands_of_timeout(operation)
        if released:
            self.engine.command(self.engine.commands._replace(**released))
            self._note_commands()
        outcome = "torques released" if released else "commands held"
        details = {"commands": released} if released else {}
        self.note(TIMEOUT, f"no command for {operation.command_timeout:g} s: {outcome}", **details)

    def note(self, kind: str, message: str = "", **details: Mapping[str, Any]) -> None:
        """Write an event that happens before the next sample, with entries of its own."""
        engine = self.engine
        self.emit([self._encoder.event(kind, engine.sample, message, engine.counters, **details)])

    def emit(self, records: Sequence[Record]) -> None:
        """Write messages that belong to no chunk."""
        _each(self._sinks, lambda sink: sink.write(None, records))

    def finish(self, reason: str) -> None:
        """End the run with a reason, once; sinks stay open for what is still to come."""
        if not self._end:
            self._end = reason
            self.note(END, reason)

    def attach(self, sink: Sink) -> None:
        """Let ``sink`` have everything from the next chunk on."""
        self._sinks.append(sink)
        self._newcomers.append(sink)

    def detach(self, sink: Sink) -> None:
        """Let ``sink`` have no more; the caller closes it."""
        self._sinks.remove(sink)
        if sink in self._newcomers:
            self._newcomers.remove(sink)

    def checkpoint(self) -> Checkpoint:
        """State before the next sample."""
        return self.engine.checkpoint()

    def close(self) -> None:
        """Close all sinks, even if one of them fails; raises the first failure."""
        sinks, self._sinks = self._sinks, []
        _each(reversed(sinks), lambda sink: sink.close())

    def _heading(self, received: Sequence[tuple[str, bytes]]) -> tuple[list[Record], list[Record]]:
        """What is written before the next chunk, and what newcomers need besides."""
        heading: list[Record] = []
        if not self._begun:
            self._begun = True
            heading.append(self._encoder.event(START, self.engine.sample, "", self.engine.counters))
        changed = self._applied != self.engine.commands
        if not (received or changed or self._newcomers):
            return heading, []
        applied = self._encoder.applied(self.engine.commands, self.engine.sample)
        heading.extend(Record(topic, applied.time_ns, data) for topic, data in received)
        if not changed:
            return heading, [applied]
        self._applied = self.engine.commands
        return [*heading, applied], []

    def _note_commands(self) -> None:
        """What else than a command put commands in force: a command of the old values is a change again."""
        if self._applied != self.engine.commands:
            self._applied = None

    def _chunk_samples(self) -> int:
        whole = self.engine.parameters.solver.samples_per_chunk
        if self._last_sample is None:
            return whole
        return min(whole, self._last_sample - self.engine.sample)


def _each(sinks: Iterable[Sink], act: Callable[[Sink], None]) -> None:
    """Let every sink have its due, even if one of them fails; raises the first failure."""
    failures: list[Exception] = []
    for sink in sinks:
        try:
            act(sink)
        except Exception as error:
            failures.append(error)
    if failures:
        raise failures[0]


def _samples(duration: float, interval_ns: int) -> int | None:
    """Samples in ``duration``, the last one begun included; None for a run without end."""
    if duration == 0.0:
        return None
    # The decimal that the user typed, not the binary fraction beside it, decides how many samples fit.
    return math.ceil(Fraction(repr(duration)) * 10**9 / interval_ns)
