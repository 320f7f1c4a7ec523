"""Computes a recorded run again and compares it chunk by chunk."""

from __future__ import annotations

from collections import deque
from typing import Final

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE, TIMEOUT, OperatorEvent
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import change_values
from gear_dynamics_ros.replay.mismatch import Mismatch, compare_event, compare_message, compare_state
from gear_dynamics_ros.replay.part_reader import Action, RecordedChunk, RequestedCommands
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.topics import CHUNK_TOPICS

# The waveform first: a difference in it says more than one in a value derived from it.
_COMPARED: Final = ("waveform", *(topic for topic in CHUNK_TOPICS if topic != "waveform"))


class Resimulation:
    """An engine that repeats a recorded run from the checkpoint ``start`` on.

    Compares the messages of chunks on the topics ``recorded`` (keys in TOPICS); ``epoch_ns`` is the stamp of
    simulated time 0.
    """

    def __init__(self, start: Checkpoint, epoch_ns: int, recorded: frozenset[str]) -> None:
        """Raises GearboxError if the state of ``start`` is invalid."""
        self._engine = Engine(start.parameters)
        self._engine.restore(start)
        # The commands are part of the state too: set from ``commands``, they must equal those in the state.
        self._engine.command(start.commands)
        self._encoder = Encoder(start.parameters, epoch_ns)
        self._recorded = recorded

    @property
    def sample(self) -> int:
        """Index of the next sample."""
        return self._engine.sample

    def compare_state(self, stored: Checkpoint) -> Mismatch | None:
        """Compare the present state with a stored checkpoint."""
        return compare_state(self._engine, stored)

    def compare_chunk(self, recorded: RecordedChunk) -> Mismatch | None:
        """Compute the chunk, and compare its messages."""
        try:
            chunk = self._engine.advance(recorded.samples)
        except GearboxError as error:
            return Mismatch(recorded.first, "waveform", f"{recorded.samples} samples", f"none: {error}")
        made = {record.topic: record.data for record in self._encoder.chunk(chunk)}
        for topic in _COMPARED:
            simulated = made.get(topic) if topic in self._recorded else None
            difference = compare_message(recorded, topic, simulated)
            if difference is not None:
                return difference
        return None

    def act_before(self, actions: deque[Action], sample: int) -> Mismatch | None:
        """Perform the actions before ``sample``, which must be the next sample."""
        if self.sample != sample:
            return Mismatch(self.sample, "waveform", f"nothing before sample {sample}", "samples")
        due: deque[Action] = deque()
        while actions and actions[0][0] <= sample:
            due.append(actions.popleft())
        return self.act(due)

    def act(self, actions: deque[Action]) -> Mismatch | None:
        """Perform all ``actions``, which must be due at the present sample.

        The last requested value of each command must then be in force.
        """
        requested: dict[str, tuple[str, float]] = {}  # topic and value by field of Commands
        for sample, action in actions:
            if sample != self.sample:
                return self.misplaced(sample, action)
            if isinstance(action, Commands):
                self._engine.command(action)
            elif isinstance(action, RequestedCommands):
                requested |= {name: (action.topic, value) for name, value in action.changes.items()}
            else:
                difference = self._repeat(action)
                if difference is not None:
                    return difference
        return self._compare_requested(requested)

    def misplaced(self, sample: int, action: OperatorEvent | Commands | RequestedCommands) -> Mismatch:
        """Mismatch for an action at a sample where no chunk begins."""
        what = f"event {action.kind}" if isinstance(action, OperatorEvent) else "commands"
        return Mismatch(self.sample, what, f"at sample {sample}", "no edge of a chunk there")

    def _compare_requested(self, requested: dict[str, tuple[str, float]]) -> Mismatch | None:
        for name, (topic, value) in requested.items():
            in_force = getattr(self._engine.commands, name)
            if value != in_force:
                return Mismatch(self.sample, f"{topic}: {name}", value, in_force)
        return None

    def _repeat(self, event: OperatorEvent) -> Mismatch | None:
        engine = self._engine
        if event.kind == RESET:
            engine.reset()
        elif event.kind == CHANGE:
            try:
                engine.change(change_values(engine.parameters, event.parameters))
            except UsageError as error:
                raise GearboxError(
                    f"the change of parameters at sample {event.sample} is invalid: {error}"
                ) from error
        elif event.kind == RESTORE:
            try:
                engine.resume(Checkpoint.from_tree(event.checkpoint))
            except GearboxError as error:
                raise GearboxError(f"the restore at sample {event.sample} is invalid: {error}") from error
        difference = compare_event(engine, event)
        if difference is None and event.kind == TIMEOUT:
            engine.command(engine.commands._replace(**event.commands))
        return difference
