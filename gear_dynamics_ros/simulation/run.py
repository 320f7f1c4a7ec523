"""The loop that the node and all tools share: take commands, compute a chunk, give it to the sinks.

No clock and no threads: the same parameters and the same calls give the same records at any pace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from gear_dynamics_ros.chunk import Chunk, Commands, Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import (
    CHANGE,
    END,
    PAUSE,
    RESET,
    RESTORE,
    RESUME,
    START,
    TIMEOUT,
)
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import OperationParameters, ParameterChange
from gear_dynamics_ros.parameters.decimals import exact_decimal
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run_state import Ending, RunState
from gear_dynamics_ros.simulation.sinks import Sink


def commands_of_timeout(operation: OperationParameters) -> Mapping[str, float]:
    """Commands that a time-out puts in force, by field of Commands; empty if it holds the last ones."""
    return {"drive_torque": 0.0, "load_torque": 0.0} if operation.on_timeout == "release" else {}


class Run:
    """One engine, its state, its messages, and the sinks that receive them.

    The commands in force are written before the first chunk, after every change, and to each sink that is
    attached later. Their stamp is the sample from which they act. ``duration`` is simulated time in s; 0
    means without end.
    """

    def __init__(
        self, engine: Engine, encoder: Encoder, sinks: Sequence[Sink] = (), *, duration: float = 0.0
    ) -> None:
        self.engine = engine
        self._encoder = encoder
        self._sinks = list(sinks)
        self._newcomers: list[Sink] = []
        self._begun = False
        self._applied: Commands | None = None  # commands last written; None if others are in force since
        self._end_sample = _sample_count(duration, engine.parameters.solver.sample_interval_ns)
        self._state = RunState()

    @property
    def state(self) -> RunState:
        """Whether the run is running, paused or ended, and why it ended. For any thread."""
        return self._state

    def step(self, commands: Commands | None = None, received: Sequence[tuple[str, bytes]] = ()) -> Chunk:
        """Compute the next chunk, with ``commands`` in force from its first sample; the last may be shorter.

        ``received`` are the messages (key in TOPICS, CDR) that set ``commands``. They are written unchanged,
        before the change that they caused. Raises GearboxError, and changes nothing, if the run has ended or
        the chunk would reach beyond the stamps of ROS.
        """
        self.require_not_ended()
        samples = self._chunk_samples()
        self._encoder.require_stampable(self.engine.sample + samples)
        if commands is not None:
            self.engine.command(commands)
        heading, for_newcomers = self._heading(received)
        chunk = self.engine.advance(samples)
        wanted = {topic for sink in self._sinks for topic in sink.wanted()}
        records = [*heading, *self._encoder.chunk(chunk, wanted)]
        newcomers, self._newcomers = self._newcomers, []
        _each(
            self._sinks,
            lambda sink: sink.write(chunk, [*for_newcomers, *records] if sink in newcomers else records),
        )
        if chunk.status is not Status.RUNNING:
            self._end(Ending.TRIPPED, chunk.message)
        elif self._end_sample is not None and self.engine.sample >= self._end_sample:
            self._end(Ending.COMPLETED, "pacing.duration reached")
        return chunk

    def pause(self) -> bool:
        """Stop simulated time; returns False if the run was paused already.

        Raises GearboxError if the run has ended.
        """
        return self._set_paused(paused=True)

    def unpause(self) -> bool:
        """Continue after a pause; returns False if the run was not paused.

        Raises GearboxError if the run has ended.
        """
        return self._set_paused(paused=False)

    def reset(self, message: str = "") -> None:
        """Return to the start state and to the commands of the parameters; simulated time continues."""
        self.engine.reset()
        self._start_again(RESET, message)

    def resume(self, checkpoint: Checkpoint, message: str = "") -> None:
        """Continue from the state of ``checkpoint``, as ``Engine.resume``; simulated time continues.

        Writes an event ``restore``, the name of the service, with the whole checkpoint. Raises GearboxError,
        and changes nothing, if the checkpoint is invalid or its run had ended.
        """
        self.engine.resume(checkpoint)
        self._start_again(RESTORE, message, checkpoint=checkpoint.to_tree())

    @property
    def timeout_changes_torques(self) -> bool:
        """Whether a time-out would change the torques in force."""
        in_force = self.engine.commands
        released = commands_of_timeout(self.engine.parameters.operation)
        return any(getattr(in_force, name) != value for name, value in released.items())

    def time_out(self) -> None:
        """Write an event ``timeout``; release the torques if ``operation.on_timeout`` is ``release``."""
        operation = self.engine.parameters.operation
        released = commands_of_timeout(operation)
        if released:
            self.engine.command(self.engine.commands._replace(**released))
            self._forget_applied()
        outcome = "torques released" if released else "commands held"
        details = {"commands": released} if released else {}
        self.write_event(TIMEOUT, f"no command for {operation.command_timeout:g} s: {outcome}", **details)

    def change(self, change: ParameterChange) -> None:
        """Put ``change`` in force from the next sample on, as ``Engine.change`` does.

        Writes an event with the values that differ, or none if all are equal. Raises GearboxError as
        ``Engine.change`` does.
        """
        if change.values:
            self.engine.change(change)
            self._forget_applied()
            self.write_event(CHANGE, parameters=change.values)

    def finish(self, reason: str) -> None:
        """End the run on request, unless it has ended. The sinks stay open for later messages."""
        self._end(Ending.STOPPED, reason)

    def fail(self, reason: str) -> None:
        """End the run because of an error. ``reason`` replaces that of an earlier end."""
        if self._state.ending is not Ending.FAILED:
            ended = self._state.ended
            self._state = self._state._replace(ending=Ending.FAILED, reason=reason)
            if not ended:
                self.write_event(END, reason)

    def require_not_ended(self) -> None:
        """Raise GearboxError if the run has ended."""
        if self._state.ended:
            raise GearboxError(f"the run has ended ({self._state.reason}): call ~/reset first")

    def write_event(self, kind: str, message: str = "", **details: Mapping[str, Any]) -> None:
        """Write an operator event before the next sample; ``details`` are entries of its kind."""
        engine = self.engine
        self.write_records([self._encoder.event(kind, engine.sample, message, engine.counters, **details)])

    def write_records(self, records: Sequence[Record]) -> None:
        """Write messages that belong to no chunk."""
        _each(self._sinks, lambda sink: sink.write(None, records))

    def attach(self, sink: Sink) -> None:
        """Give everything from the next chunk on to ``sink`` too."""
        self._sinks.append(sink)
        self._newcomers.append(sink)

    def detach(self, sink: Sink) -> None:
        """Give no more to ``sink``; the caller closes it."""
        self._sinks.remove(sink)
        if sink in self._newcomers:
            self._newcomers.remove(sink)

    def checkpoint(self) -> Checkpoint:
        """Checkpoint before the next sample."""
        return self.engine.checkpoint()

    def close(self) -> None:
        """Close all sinks, even if one of them fails. Raises the first failure."""
        sinks, self._sinks = self._sinks, []
        _each(reversed(sinks), lambda sink: sink.close())

    def _heading(self, received: Sequence[tuple[str, bytes]]) -> tuple[list[Record], list[Record]]:
        """Records to write before the next chunk, and further ones for sinks that have just been attached."""
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

    def _end(self, ending: Ending, reason: str) -> None:
        if not self._state.ended:
            self._state = self._state._replace(ending=ending, reason=reason)
            self.write_event(END, reason)

    def _set_paused(self, *, paused: bool) -> bool:
        self.require_not_ended()
        if paused == self._state.paused:
            return False
        self._state = self._state._replace(paused=paused)
        self.write_event(PAUSE if paused else RESUME)
        return True

    def _start_again(self, kind: str, message: str, **details: Mapping[str, Any]) -> None:
        """Continue from a new state of the engine, also if the run had ended."""
        self._state = RunState(paused=self._state.paused)
        self._forget_applied()
        self.write_event(kind, message, **details)

    def _forget_applied(self) -> None:
        """Something else than a command changed the commands in force: write them again at the next chunk."""
        if self._applied != self.engine.commands:
            self._applied = None

    def _chunk_samples(self) -> int:
        whole = self.engine.parameters.solver.samples_per_chunk
        if self._end_sample is None:
            return whole
        return min(whole, self._end_sample - self.engine.sample)


def _each(sinks: Iterable[Sink], act: Callable[[Sink], None]) -> None:
    """Call ``act`` for every sink, even if it fails for one. Raises the first failure."""
    failures: list[Exception] = []
    for sink in sinks:
        try:
            act(sink)
        except Exception as error:
            failures.append(error)
    if failures:
        raise failures[0]


def _sample_count(duration: float, interval_ns: int) -> int | None:
    """Samples in ``duration`` s, rounded up; None for a run without end."""
    if duration == 0.0:
        return None
    # The number of samples follows from the decimal that the user typed, not from its rounded binary value.
    return math.ceil(exact_decimal(duration) * 10**9 / interval_ns)
