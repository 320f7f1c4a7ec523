"""One part of a recording as a re-simulation needs it: its chunks, its actions, and its inputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeAlias, TypeVar

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.messages.decoder import MessageDecoder
from gear_dynamics_ros.parameters import differences, parse_parameters
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.digest import INPUT_TOPICS, RunningDigest
from gear_dynamics_ros.recording.parts import StoredMessage
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.topics import CHUNK_TOPICS, COMMAND_TOPICS, TOPICS

T = TypeVar("T")


class RecordedChunk(NamedTuple):
    """The recorded messages of one chunk."""

    first: int  # sample
    samples: int
    time_ns: int  # stamp
    channels: tuple[str, ...]  # of the waveform
    messages: Mapping[str, memoryview]  # CDR by key in TOPICS
    decoder: MessageDecoder


class RequestedCommands(NamedTuple):
    """The request of a message on a command topic."""

    topic: str  # key in TOPICS
    changes: Mapping[str, float]  # by field of Commands


# A sample, and what acted on the run, or was requested of it, before that sample.
Action: TypeAlias = tuple[int, OperatorEvent | Commands | RequestedCommands]


class PartReader:
    """Reads part ``number`` of a recording."""

    def __init__(self, recording: Recording, number: int) -> None:
        self.number = number
        self.part = recording.parts[number]
        self._recording = recording
        self._decoder = recording.decoder()

    @cached_property
    def inputs(self) -> Sequence[StoredMessage]:
        """The messages that no chunk made, in the order of the file, in memory.

        Raises GearboxError at a damaged chunk of the file.
        """
        names = self._recording.topic_names
        messages = self.part.messages([names[key] for key in INPUT_TOPICS])
        # Copies: a view would keep the whole chunk of the file in memory.
        return [message._replace(data=memoryview(bytes(message.data))) for message in messages]

    def actions(self) -> list[Action]:
        """All actions in the part, by sample; requested commands follow what acted at their sample.

        Raises GearboxError at an invalid message.
        """
        # Commands in force act from the first sample of a chunk, after the events before it.
        acted: list[Action] = [*self._within(self._events()), *self._within(self._applied())]
        return sorted([*acted, *self._requested()], key=lambda action: action[0])

    def require_order(self) -> None:
        """Raise GearboxError if the part has a checkpoint twice or goes back in time."""
        path = self.part.path
        names = Counter(entry.name for entry in self.part.index.attachments)
        names[layout.checkpoint_name(self.part.first_sample)] += 1
        for name, count in names.items():
            if count > 1:
                raise GearboxError(
                    f"{path} has {name} twice, or in addition to the start: one of them is wrong"
                )
        for earlier, later in pairwise(self.inputs):
            if later.time_ns < earlier.time_ns:
                raise GearboxError(f"{path} goes back in time with a message on {later.topic}")

    def first_unrepeated_topic(self) -> str:
        """The first latched topic (key in TOPICS) whose last message the part does not repeat at its start.

        Empty if there is none.
        """
        before = self._recording.parts[self.number - 1]
        for key, topic in TOPICS.items():
            name = self._recording.topic_names[key]
            last = before.last_message(name) if topic.latched else None
            first = next(self.part.messages([name]), None) if last is not None else None
            if last is not None and (first is None or first.data != last.data):
                return key
        return ""

    def missing_topics(self) -> list[str]:
        """Topics (keys in TOPICS) that the parameters record and that have no channel in the part."""
        names = {channel.topic for channel in self.part.index.channels.values()}
        expected = layout.recorded_topics(self.part.start.checkpoint.parameters, self._recording.run.names)
        return [key for key, (name, _) in expected.items() if name not in names]

    def inconsistent_parameters(self) -> list[str]:
        """Names of parameters that differ between parameters.yaml and start.json."""
        return list(
            differences(self.part.start.checkpoint.parameters, parse_parameters(self.part.parameters))
        )

    def digest(self, opening: Sequence[str], inputs: Iterable[StoredMessage]) -> str:
        """Digest that the next checkpoint must have.

        ``opening`` names the attachments of the checkpoint before; ``inputs`` are the messages in between.
        """
        contents = [self.part.attachment(name) for name in opening]
        run = [self.part.run.to_lines()] if layout.START_ATTACHMENT in opening else []
        digest = RunningDigest(*run, *contents)
        for message in inputs:
            digest.add(*message)
        return digest.text()

    def chunks(self, first: int, end: int | None) -> Iterator[RecordedChunk]:
        """The chunks that begin at samples in [first, end).

        Raises GearboxError if the messages of a chunk are not together or not of the same time.
        """
        path = self._recording.path
        keys = {self._recording.topic_names[key]: key for key in CHUNK_TOPICS}
        decoder = self._recording.decoder()
        gathered: dict[str, StoredMessage] = {}
        for message in self.part.messages(keys, self._recording.stamp_of(first)):
            key = keys[message.topic]
            if key in gathered:
                raise GearboxError(f"{path}: one chunk has two messages on {message.topic}")
            gathered[key] = message
            if key != "waveform":
                continue
            times = {stored.time_ns for stored in gathered.values()}
            if len(times) > 1:
                raise GearboxError(f"{path}: messages of one chunk have the times {sorted(times)} ns")
            samples = len(decoder.rows(key, message.time_ns, message.data))
            begin = self._recording.sample_of(message.time_ns) - samples + 1
            if end is not None and begin >= end:
                return
            messages = {key: stored.data for key, stored in gathered.items()}
            channels = self._recording.channel_names
            yield RecordedChunk(begin, samples, message.time_ns, channels, messages, decoder)
            gathered = {}

    def _events(self) -> Iterator[tuple[int, OperatorEvent]]:
        for _, time_ns, data in self._recording.without_repeated(self.number, "event", self.inputs):
            event = self._decoder.event(time_ns, data)
            yield event.sample, event

    def _applied(self) -> Iterator[tuple[int, Commands]]:
        for _, time_ns, data in self._recording.without_repeated(self.number, "applied_command", self.inputs):
            applied = self._decoder.applied(time_ns, data)
            yield self._recording.sample_of(applied.time_ns), applied.commands

    def _requested(self) -> Iterator[tuple[int, RequestedCommands]]:
        """Received commands, at the samples from which they acted."""
        keys = {self._recording.topic_names[key]: key for key in COMMAND_TOPICS}
        for topic, time_ns, data in self.inputs:
            if topic in keys:
                changes = self._decoder.changes(keys[topic], time_ns, data)
                yield self._recording.sample_of(time_ns), RequestedCommands(keys[topic], changes)

    def _within(self, actions: Iterable[tuple[int, T]]) -> Iterator[tuple[int, T]]:
        """Those of ``actions`` in this part: it may begin with one message of an earlier part."""
        first = self.part.first_sample
        for position, (sample, action) in enumerate(actions):
            if sample >= first:
                yield sample, action
            elif position:
                raise GearboxError(
                    f"{self.part.path}: it starts at sample {first} but has an action at {sample}"
                )
