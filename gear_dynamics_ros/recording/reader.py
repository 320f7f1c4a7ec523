"""Reads recordings, whole or broken off, without ever holding more than a piece of them."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages import RowReader, applied_commands, deserialize, stamp_ns
from gear_dynamics_ros.parameters import Parameters, parse
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.history import TOLD, History
from gear_dynamics_ros.recording.parts import PartFile, Stored, open_parts
from gear_dynamics_ros.samples import Samples
from gear_dynamics_ros.signals import IMPACTS, Commands
from gear_dynamics_ros.topics import COMMAND_TOPICS, OF_A_CHUNK, TOPICS, resolve

BLOCK_SAMPLES: Final = 20_000
T = TypeVar("T")


class Event(NamedTuple):
    """Something that happened before ``sample`` was made."""

    sample: int
    time: float  # s, simulated
    kind: str  # one of those in signals.py
    message: str
    counters: dict[str, int]  # signals.Counters then; empty in a recording that lacks them
    parameters: Mapping[str, Any] = MappingProxyType({})  # by dotted name, that changed
    checkpoint: Mapping[str, Any] = MappingProxyType({})  # of a restore


class TopicCount(NamedTuple):
    """A topic of a recording (full name) and how many messages it holds."""

    name: str
    type: str
    messages: int


class RecordedChunk(NamedTuple):
    """What a chunk made, as it was recorded."""

    first: int  # sample
    samples: int
    messages: Mapping[str, memoryview]  # CDR by key in TOPICS


class Recording:
    """A recording, folder or single MCAP file; ``open`` makes it.

    Samples are counted from the start of the run; a part of a run begins at ``first_sample``. Times are
    simulated, in s. Several threads may read at once.
    """

    def __init__(self, path: Path, parts: tuple[PartFile, ...], parameters: Parameters) -> None:
        self.path = path
        self.parts = parts
        self.parameters = parameters
        self.run = parts[0].run
        self._names = {key: resolve(topic, self.run.node) for key, topic in TOPICS.items()}
        self._span: tuple[int, int] | None = None

    @property
    def epoch_ns(self) -> int:
        """Stamp of simulated time 0."""
        return self.run.epoch_ns

    @property
    def node(self) -> str:
        """Full name of the node."""
        return self.run.node

    @property
    def version(self) -> str:
        """Version of the package that made the recording."""
        return self.run.provenance.version

    @property
    def kernel_hash(self) -> str:
        """SHA-256 of the source of the kernel that made the recording."""
        return self.run.provenance.kernel_hash

    @property
    def sample_interval_ns(self) -> int:
        """Simulated time between two samples."""
        return self.run.sample_interval_ns

    @property
    def start(self) -> dict[str, Any]:
        """Checkpoint from which the recording starts."""
        return self.parts[0].start

    @property
    def complete(self) -> bool:
        """Whether every file, and metadata.yaml beside them, was finished."""
        described = self.path.is_file() or (self.path / layout.METADATA_FILE).is_file()
        return described and all(part.complete for part in self.parts)

    @property
    def size(self) -> int:
        """Bytes of all parts."""
        return sum(part.size for part in self.parts)

    @property
    def topics(self) -> list[TopicCount]:
        """The topics recorded, with their message counts."""
        counts: Counter[str] = Counter()
        for part in self.parts:
            counts.update(part.found.topic_counts())
        return [
            TopicCount(name, TOPICS[key].type, counts[name])
            for key, name in self._names.items()
            if name in counts
        ]

    @property
    def recorded(self) -> frozenset[str]:
        """Keys in TOPICS of what was recorded."""
        names = {topic.name for topic in self.topics}
        return frozenset(key for key, name in self._names.items() if name in names)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the waveform's columns."""
        return tuple(self.parameters.waveform_channels)

    @property
    def first_sample(self) -> int:
        """Index of the first sample of the waveform."""
        return self._sample_span()[0]

    @property
    def end_sample(self) -> int:
        """One past the index of the last sample of the waveform."""
        return self._sample_span()[1]

    @property
    def duration_ns(self) -> int:
        """Simulated time that the waveform covers."""
        return (self.end_sample - self.first_sample) * self.sample_interval_ns

    @property
    def commands(self) -> list[tuple[int, Commands]]:
        """Commands in force, each from its sample on."""
        return [self._command(data) for data in self._latched("applied_command")]

    @property
    def events(self) -> list[Event]:
        """Events in their order."""
        return [_event(data) for data in self._latched("event")]

    def waveform(self, first: int | None = None, last: int | None = None) -> NDArray[np.float64]:
        """Samples ``first`` to before ``last``, shape (n, channels), as far as the recording holds them.

        Raises GearboxError where samples are missing or doubled.
        """
        begin = self.first_sample if first is None else max(first, self.first_sample)
        beyond = self.end_sample if last is None else min(last, self.end_sample)
        return self._gather(begin, beyond, slice(None), len(self.channel_names))

    def window(
        self,
        start: float | None = None,
        end: float | None = None,
        channels: Sequence[str] | None = None,
    ) -> Samples:
        """The samples at times in [start, end), columns in the order of ``channels`` (default: all).

        All of them in memory: 8 bytes a channel and sample; ``blocks`` comes piece by piece. What the
        recording does not cover is left out. Raises UsageError on a channel that is not there, GearboxError
        where samples are missing.
        """
        first, beyond = self.clip(start, end)
        names, columns = self.columns(channels)
        rows = self._gather(first, beyond, columns, len(names))
        return Samples(first, self.parameters.solver.sample_interval, names, rows)

    def blocks(
        self,
        start: float | None = None,
        end: float | None = None,
        channels: Sequence[str] | None = None,
        rows: int = BLOCK_SAMPLES,
    ) -> Iterator[Samples]:
        """The same in pieces of at least ``rows`` samples, and the rest."""
        return self.pieces(*self.clip(start, end), channels, rows)

    def pieces(
        self, first: int, beyond: int, channels: Sequence[str] | None = None, rows: int = BLOCK_SAMPLES
    ) -> Iterator[Samples]:
        """``blocks`` of the samples ``first`` to before ``beyond``, which the recording must cover."""
        names, columns = self.columns(channels)
        interval = self.parameters.solver.sample_interval
        waiting: list[NDArray[np.float64]] = []
        held = 0
        for _, samples in self.chunks(first, beyond) if first < beyond else ():
            waiting.append(samples[:, columns])
            held += len(samples)
            if held >= rows:
                yield Samples(first, interval, names, np.concatenate(waiting))
                first, waiting, held = first + held, [], 0
        if waiting:
            yield Samples(first, interval, names, np.concatenate(waiting))

    def impacts(self, start: float | None = None, end: float | None = None) -> NDArray[np.float64]:
        """Bearing contacts that ended at times in [start, end): shape (n, 6), columns signals.IMPACTS."""
        found = [np.empty((0, len(IMPACTS)))]
        for _, rows in self.rows("impacts"):
            ends = rows[:, 1]
            low, high = -math.inf if start is None else start, math.inf if end is None else end
            found.append(rows[(ends >= low) & (ends < high)])
        return np.concatenate(found)

    def chunks(
        self, first: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Index of the first sample, and samples (n, channels), of each chunk in order; cut to [first, end).

        Raises GearboxError where samples are missing or doubled.
        """
        expected: int | None = None
        from_ns = None if first is None else self.time_ns(first)
        for time_ns, samples in self._waveform(from_ns):
            begin = self.sample(time_ns) - len(samples) + 1
            if expected is not None and begin != expected:
                raise GearboxError(f"{self.path}: sample {expected} should follow, but sample {begin} does")
            expected = begin + len(samples)
            low = 0 if first is None else max(first - begin, 0)
            high = len(samples) if end is None else min(end - begin, len(samples))
            if low < high:
                yield begin + low, samples[low:high]
            if end is not None and end <= expected < self.end_sample:
                return

    def recorded_chunks(self, number: int, first: int, end: int | None) -> Iterator[RecordedChunk]:
        """The chunks of part ``number`` that begin at samples in [first, end).

        Raises GearboxError where messages are not together as a chunk makes them.
        """
        keys = {self._names[key]: key for key in OF_A_CHUNK}
        read = RowReader()
        gathered: dict[str, Stored] = {}
        from_ns = self.time_ns(first)
        for message in self.parts[number].messages(keys, from_ns):
            if keys[message.topic] in gathered:
                raise GearboxError(f"{self.path}: two messages of one chunk stand on {message.topic}")
            gathered[keys[message.topic]] = message
            if keys[message.topic] != "waveform":
                continue
            times = {stored.time_ns for stored in gathered.values()}
            if len(times) > 1:
                raise GearboxError(f"{self.path}: messages of one chunk bear the times {sorted(times)} ns")
            samples = len(read.read(message.data)[1])
            begin = self.sample(message.time_ns) - samples + 1
            if end is not None and begin >= end:
                return
            yield RecordedChunk(begin, samples, {key: stored.data for key, stored in gathered.items()})
            gathered = {}

    def rows(self, topic: str) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Time in ns and rows of each message of a topic of arrays (key in TOPICS)."""
        read = RowReader()
        for message in self._messages(topic):
            yield message.time_ns, read.read(message.data)[1]

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time in ns and decoded message of each message of ``topic`` (key in TOPICS)."""
        for message in self._messages(topic):
            yield message.time_ns, deserialize(TOPICS[topic].type, message.data)

    def sample(self, time_ns: int) -> int:
        """Index of the sample with the stamp ``time_ns``. Raises GearboxError if there can be none."""
        sample, rest = divmod(time_ns - self.epoch_ns, self.sample_interval_ns)
        if rest:
            raise GearboxError(f"{self.path}: the time {time_ns} ns is that of no sample")
        return sample

    def clip(self, start: float | None, end: float | None) -> tuple[int, int]:
        """The samples [first, beyond) at times in [start, end), as far as there are any.

        Raises UsageError on a time that is not finite.
        """
        first = self.first_sample if start is None else max(self.at(start), self.first_sample)
        beyond = self.end_sample if end is None else min(self.at(end), self.end_sample)
        return first, max(first, beyond)

    def at(self, time: float) -> int:
        """Index of the first sample at or after ``time`` s. Raises UsageError if it is not finite."""
        if not math.isfinite(time):
            raise UsageError(f"the time {time} s is not finite: give a number of seconds")
        # A sample's own time must give that sample, rounded as it is, days after the start too.
        return math.ceil(round(time * 1e9 / self.sample_interval_ns, 4))

    def columns(self, channels: Sequence[str] | None) -> tuple[tuple[str, ...], list[int] | slice]:
        """Names of the ``channels`` (default: all), and where they are in a row of the waveform.

        Raises UsageError on a channel that is not there.
        """
        known = self.channel_names
        if channels is None:
            return known, slice(None)
        for name in channels:
            if name not in known:
                raise UsageError(f"there is no channel '{name}' in {self.path}: it has {', '.join(known)}")
        return tuple(channels), [known.index(name) for name in channels]

    def actions(self, number: int, told: Sequence[Stored]) -> list[tuple[int, Event | Commands]]:
        """What acted on the model in part ``number``, of which all is ``told``, by sample and in order."""
        events = (_event(data) for data in self._unlike_before(number, "event", told))
        commands = (self._command(data) for data in self._unlike_before(number, "applied_command", told))
        # Commands act with the first sample of a chunk, after what happened before it.
        actions: list[tuple[int, Event | Commands]] = [
            *self._within(number, ((event.sample, event) for event in events)),
            *self._within(number, commands),
        ]
        return sorted(actions, key=lambda action: action[0])

    def unrepeated(self, number: int) -> str:
        """Key in TOPICS of what part ``number`` should repeat at its start, and does not; empty if none."""
        part, before = self.parts[number], self.parts[number - 1]
        for key, topic in TOPICS.items():
            last = before.last_message(self._names[key]) if topic.latched else None
            first = next(part.messages([self._names[key]]), None) if last is not None else None
            if last is not None and (first is None or first.data != last.data):
                return key
        return ""

    def lacking(self, number: int) -> list[str]:
        """Keys in TOPICS of what should be recorded in part ``number``, and has no channel there."""
        part = self.parts[number]
        names = {channel.topic for channel in part.found.channels.values()}
        wanted = layout.recorded_topics(parse(part.parameters), self.node)
        return [key for key, (name, _) in wanted.items() if name not in names]

    @property
    def lost_files(self) -> list[str]:
        """Names of the files that metadata.yaml lists and that are no part: missing, or without a start."""
        path = self.path / layout.METADATA_FILE
        if not path.is_file():
            return []
        try:
            listed = yaml.safe_load(path.read_text(encoding="utf-8"))[layout.INFORMATION][layout.FILES]
            return sorted({str(name) for name in listed} - {part.path.name for part in self.parts})
        except (KeyError, OSError, TypeError, ValueError, yaml.YAMLError) as error:
            raise GearboxError(f"{path} is spoilt: {' '.join(repr(error).split()):.200}") from error

    def told(self, number: int) -> list[Stored]:
        """What no chunk made of part ``number``, in the order of the file, in memory."""
        found = self.parts[number].messages([self._names[key] for key in TOLD])
        # Of their own, or each would keep the whole chunk that it stands in.
        return [message._replace(data=memoryview(bytes(message.data))) for message in found]

    def received(self, told: Iterable[Stored]) -> list[tuple[int, str, Any]]:
        """Commands as they came, among ``told``: sample from which they acted, key in TOPICS, message."""
        keys = {self._names[key]: key for key in COMMAND_TOPICS}
        return [
            (self.sample(stored.time_ns), keys[stored.topic], _decoded(keys[stored.topic], stored.data))
            for stored in told
            if stored.topic in keys
        ]

    def history(self, number: int, opening: Sequence[str], told: Iterable[Stored]) -> str:
        """Digest of ``told``, a stretch of part ``number``, which the state at its end must carry.

        ``opening`` names the attachments from which that stretch begins.
        """
        part = self.parts[number]
        contents = [part.attachment(name) for name in opening]
        found = History(*([part.run.to_lines()] if layout.START_ATTACHMENT in opening else []), *contents)
        for message in told:
            found.add(*message)
        return found.text()

    def count(self, topics: Iterable[str]) -> int:
        """Messages on topics (keys in TOPICS)."""
        names = {self._names[key] for key in topics}
        return sum(topic.messages for topic in self.topics if topic.name in names)

    def time_ns(self, sample: int) -> int:
        """Stamp of a sample."""
        return self.epoch_ns + sample * self.sample_interval_ns

    def _within(self, number: int, found: Iterable[tuple[int, T]]) -> Iterator[tuple[int, T]]:
        """What is of part ``number``: all but a message of before, with which it may begin."""
        first = self.parts[number].first_sample
        for position, (sample, action) in enumerate(found):
            if sample >= first:
                yield sample, action
            elif position:
                raise GearboxError(
                    f"{self.parts[number].path}: it starts at sample {first} but holds what acted at {sample}"
                )

    def _gather(self, first: int, beyond: int, columns: list[int] | slice, width: int) -> NDArray[np.float64]:
        rows = np.empty((max(beyond - first, 0), width))
        if len(rows):
            for at, samples in self.chunks(first, beyond):
                rows[at - first : at - first + len(samples)] = samples[:, columns]
        return rows

    def _waveform(self, from_ns: int | None) -> Iterator[tuple[int, NDArray[np.float64]]]:
        read = RowReader()
        for message in self._messages("waveform", from_ns):
            names, samples = read.read(message.data)
            if names != self.channel_names:
                raise GearboxError(
                    f"{self.path}: the waveform's channels differ from waveform_channels: {names}"
                )
            yield message.time_ns, samples

    def _messages(self, topic: str, from_ns: int | None = None) -> Iterator[Stored]:
        for part in self.parts:
            yield from part.messages([self._names[topic]], from_ns)

    def _latched(self, topic: str) -> Iterator[bytes]:
        for number, part in enumerate(self.parts):
            yield from self._unlike_before(number, topic, part.messages([self._names[topic]]))

    def _unlike_before(self, number: int, topic: str, messages: Iterable[Stored]) -> Iterator[bytes]:
        """Those of a latched topic in a part, without the last of the part before, which it repeats."""
        name = self._names[topic]
        before = self.parts[number - 1].last_message(name) if number else None
        own = (message for message in messages if message.topic == name)
        for position, message in enumerate(own):
            if position or before is None or message.data != before.data:
                yield bytes(message.data)

    def _command(self, data: bytes) -> tuple[int, Commands]:
        message = deserialize(TOPICS["applied_command"].type, data)
        return self.sample(stamp_ns(message.header.stamp)), applied_commands(message)

    def _sample_span(self) -> tuple[int, int]:
        if self._span is None:
            self._span = self._find_span()
        return self._span

    def _find_span(self) -> tuple[int, int]:
        earliest = next(self._waveform(None), None)
        if earliest is None:
            sample = int(self.start["sample"])
            return sample, sample
        time_ns, samples = earliest
        last_ns = time_ns
        for part in reversed(self.parts):
            found = part.last_message(self._names["waveform"])
            if found is not None:
                last_ns = found.time_ns
                break
        return self.sample(time_ns) - len(samples) + 1, self.sample(last_ns) + 1


def open(path: str | Path) -> Recording:
    """The recording at ``path``: a rosbag2 folder or one MCAP file, finished or broken off.

    Raises UsageError if there is none, GearboxError if it wasn't written by this package or is spoilt.
    """
    path = Path(path)
    parts = open_parts(path)
    try:
        return Recording(path, parts, parse(parts[0].parameters))
    except UsageError as error:
        raise GearboxError(f"{parts[0].path}: {layout.PARAMETERS_ATTACHMENT}: {error}") from error


def _decoded(topic: str, data: memoryview) -> Any:
    try:
        return deserialize(TOPICS[topic].type, data)
    except Exception as error:  # rosbags has no common class for what it finds wrong with bytes
        raise GearboxError(f"a message on {TOPICS[topic].name} is spoilt: {error!r}") from error


def _event(data: bytes) -> Event:
    try:
        entry = json.loads(deserialize(TOPICS["event"].type, data).data)
        return Event(
            sample=entry["sample"],
            time=entry["time"],
            kind=entry["event"],
            message=entry["message"],
            counters=entry.get("counters", {}),
            parameters=entry.get("parameters", {}),
            checkpoint=entry.get("checkpoint", {}),
        )
    except Exception as error:  # rosbags has no common class for what it finds wrong with bytes
        raise GearboxError(f"an event is spoilt: {error!r}") from error
