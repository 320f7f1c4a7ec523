"""One file of a recording as a re-simulation needs it: its chunks, what acted, and what was told."""

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
from gear_dynamics_ros.recording.digest import TOLD, RunningDigest
from gear_dynamics_ros.recording.parts import StoredMessage
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.topics import COMMAND_TOPICS, OF_A_CHUNK, TOPICS

T = TypeVar("T")


class RecordedChunk(NamedTuple):
    """What a chunk made, as it was recorded."""

    first: int  # sample
    samples: int
    time_ns: int  # stamp
    channels: tuple[str, ...]  # of the waveform
    messages: Mapping[str, memoryview]  # CDR by key in TOPICS
    decoder: MessageDecoder


class AskedCommands(NamedTuple):
    """What a message on a command topic asked for."""

    topic: str  # key in TOPICS
    changes: Mapping[str, float]  # by field of Commands


# What acts on a run, or was asked of it, before a sample is made.
Action: TypeAlias = tuple[int, OperatorEvent | Commands | AskedCommands]


class PartReader:
    """Part ``number`` of a recording."""

    def __init__(self, recording: Recording, number: int) -> None:
        self.number = number
        self.part = recording.parts[number]
        self._recording = recording
        self._decoder = recording.decoder()

    @cached_property
    def told(self) -> Sequence[StoredMessage]:
        """The messages that no chunk made, in the order of the file, in memory."""
        names = self._recording.topic_names
        found = self.part.messages([names[key] for key in TOLD])
        # Of their own, or each would keep the whole chunk that it stands in.
        return [message._replace(data=memoryview(bytes(message.data))) for message in found]

    def actions(self) -> list[Action]:
        """What acted in the part, by sample; what was asked for stands behind what acted at its sample."""
        # Commands act with the first sample of a chunk, after what happened before it.
        acted: list[Action] = [*self._within(self._events()), *self._within(self._applied())]
        return sorted([*acted, *self._asked()], key=lambda action: action[0])

    def require_order(self) -> None:
        """Raise GearboxError where the part is of another run, holds a state twice or goes back in time."""
        path, first = self.part.path, self._recording.parts[0]
        if self.part.run != self._recording.run:
            raise GearboxError(f"{path} is of another run than {first.path.name}")
        names = Counter(entry.name for entry in self.part.index.attachments)
        names[layout.checkpoint_name(self.part.first_sample)] += 1
        for name, count in names.items():
            if count > 1:
                raise GearboxError(f"{path} holds {name} twice, or beside the start: one of them is wrong")
        for earlier, later in pairwise(self.told):
            if later.time_ns < earlier.time_ns:
                raise GearboxError(f"{path} goes back in time with a message on {later.topic}")

    def unrepeated(self) -> str:
        """Key in TOPICS of what the part should repeat at its start, and does not; empty if none."""
        before = self._recording.parts[self.number - 1]
        for key, topic in TOPICS.items():
            name = self._recording.topic_names[key]
            last = before.last_message(name) if topic.latched else None
            first = next(self.part.messages([name]), None) if last is not None else None
            if last is not None and (first is None or first.data != last.data):
                return key
        return ""

    def lacking(self) -> list[str]:
        """Keys in TOPICS of what should be recorded in the part, and has no channel there."""
        names = {channel.topic for channel in self.part.index.channels.values()}
        wanted = layout.recorded_topics(parse_parameters(self.part.parameters), self._recording.node)
        return [key for key, (name, _) in wanted.items() if name not in names]

    def unlike_parameters(self) -> list[str]:
        """Names of parameters that are not the same in parameters.yaml and start.json."""
        return list(
            differences(self.part.start.checkpoint.parameters, parse_parameters(self.part.parameters))
        )

    def digest(self, opening: Sequence[str], told: Iterable[StoredMessage]) -> str:
        """Digest of the messages ``told``, which the checkpoint behind them must carry.

        ``opening`` names the attachments from which they lead there.
        """
        contents = [self.part.attachment(name) for name in opening]
        run = [self.part.run.to_lines()] if layout.START_ATTACHMENT in opening else []
        found = RunningDigest(*run, *contents)
        for message in told:
            found.add(*message)
        return found.text()

    def chunks(self, first: int, end: int | None) -> Iterator[RecordedChunk]:
        """The chunks that begin at samples in [first, end).

        Raises GearboxError where messages are not together as a chunk makes them.
        """
        path = self._recording.path
        keys = {self._recording.topic_names[key]: key for key in OF_A_CHUNK}
        decoder = self._recording.decoder()
        gathered: dict[str, StoredMessage] = {}
        for message in self.part.messages(keys, self._recording.stamp_of(first)):
            key = keys[message.topic]
            if key in gathered:
                raise GearboxError(f"{path}: two messages of one chunk stand on {message.topic}")
            gathered[key] = message
            if key != "waveform":
                continue
            times = {stored.time_ns for stored in gathered.values()}
            if len(times) > 1:
                raise GearboxError(f"{path}: messages of one chunk bear the times {sorted(times)} ns")
            samples = len(decoder.rows(key, message.time_ns, message.data))
            begin = self._recording.sample_of(message.time_ns) - samples + 1
            if end is not None and begin >= end:
                return
            messages = {key: stored.data for key, stored in gathered.items()}
            channels = self._recording.channel_names
            yield RecordedChunk(begin, samples, message.time_ns, channels, messages, decoder)
            gathered = {}

    def _events(self) -> Iterator[tuple[int, OperatorEvent]]:
        for _, time_ns, data in self._recording.without_repeated(self.number, "event", self.told):
            event = self._decoder.event(time_ns, data)
            yield event.sample, event

    def _applied(self) -> Iterator[tuple[int, Commands]]:
        for _, time_ns, data in self._recording.without_repeated(self.number, "applied_command", self.told):
            applied = self._decoder.applied(time_ns, data)
            yield self._recording.sample_of(applied.time_ns), applied.commands

    def _asked(self) -> Iterator[tuple[int, AskedCommands]]:
        """Commands as they came, at the samples from which they acted."""
        keys = {self._recording.topic_names[key]: key for key in COMMAND_TOPICS}
        for topic, time_ns, data in self.told:
            if topic in keys:
                changes = self._decoder.changes(keys[topic], time_ns, data)
                yield self._recording.sample_of(time_ns), AskedCommands(keys[topic], changes)

    def _within(self, found: Iterable[tuple[int, T]]) -> Iterator[tuple[int, T]]:
        """What is of this part: all but a message of before, with which it may begin."""
        first = self.part.first_sample
        for position, (sample, action) in enumerate(found):
            if sample >= first:
                yield sample, action
            elif position:
                raise GearboxError(
                    f"{self.part.path}: it starts at sample {first} but holds what acted at {sample}"
                )
