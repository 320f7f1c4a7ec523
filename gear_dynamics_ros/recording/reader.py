"""Reads recordings, whole or broken off, without ever holding more than a piece of them."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.records import Message
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages import (
    TOPICS,
    applied_commands,
    deserialize,
    resolve,
    stamp_ns,
    waveform_samples,
)
from gear_dynamics_ros.parameters import Parameters, load
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import RunMetadata
from gear_dynamics_ros.recording.survey import Survey, read_attachments, read_chunk, read_metadata, survey
from gear_dynamics_ros.signals import Commands


class Event(NamedTuple):
    """Something that happened before ``sample`` was made."""

    sample: int
    time: float  # s, simulated
    kind: str  # one of those in run.py
    message: str
    counters: dict[str, int]  # signals.Counters then; empty in a recording that lacks them
    parameters: Mapping[str, Any] = MappingProxyType({})  # by dotted name, that changed
    checkpoint: Mapping[str, Any] = MappingProxyType({})  # of a restore


class TopicCount(NamedTuple):
    """A topic of a recording (full name) and how many messages it holds."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True)
class PartFile:
    """One MCAP file of a recording."""

    path: Path
    run: RunMetadata
    start: dict[str, Any]  # checkpoint from which the part starts
    size: int  # bytes
    found: Survey

    @property
    def complete(self) -> bool:
        """Whether the file was finished; False after a crash."""
        return self.found.complete


class Recording:
    """A recording, folder or single MCAP file; ``open`` makes it.

    Samples are counted from the start of the run; a part of a run begins at ``first_sample``.
    """

    def __init__(self, path: Path, parts: tuple[PartFile, ...], parameters: Parameters) -> None:
        self.path = path
        self.parts = parts
        self.parameters = parameters
        run = parts[0].run
        self.epoch_ns = run.epoch_ns
        self.node = run.node
        self.version = run.version
        self.kernel_hash = run.kernel_hash
        self.sample_interval_ns = run.sample_interval_ns
        self._names = {key: resolve(topic, run.node) for key, topic in TOPICS.items()}
        self._span: tuple[int, int] | None = None

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
        """All topics with their message counts."""
        counts: Counter[str] = Counter()
        for part in self.parts:
            counts.update(part.found.topic_counts())
        return [
            TopicCount(self._names[key], topic.type, counts[self._names[key]])
            for key, topic in TOPICS.items()
        ]

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
        return [
            (self._sample(stamp_ns(message.header.stamp)), applied_commands(message))
            for message in self._latched("applied_command")
        ]

    @property
    def events(self) -> list[Event]:
        """Events in their order."""
        return [_event(json.loads(message.data)) for message in self._latched("event")]

    def chunks(
        self, first: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Index of the first sample, and samples (n, channels), of each chunk in order; cut to [first, end).

        Raises GearboxError where samples are missing or doubled.
        """
        expected: int | None = None
        from_ns = None if first is None else self.epoch_ns + first * self.sample_interval_ns
        for message in self._messages("waveform", from_ns):
            names, samples = waveform_samples(deserialize(TOPICS["waveform"].type, message.data))
            if names != self.channel_names:
                raise GearboxError(
                    f"{self.path}: the waveform's channels differ from waveform_channels: {names}"
                )
            begin = self._sample(message.log_time) - len(samples) + 1
            if expected is not None and begin != expected:
                raise GearboxError(f"{self.path}: sample {expected} should follow, but sample {begin} does")
            expected = begin + len(samples)
            low = 0 if first is None else max(first - begin, 0)
            high = len(samples) if end is None else min(end - begin, len(samples))
            if low < high:
                yield begin + low, samples[low:high]
            if end is not None and expected >= end:
                return

    def waveform(self, first: int | None = None, last: int | None = None) -> NDArray[np.float64]:
        """Samples ``first`` to before ``last``, shape (n, channels), as far as the recording holds them.

        Raises GearboxError where samples are missing or doubled.
        """
        begin = self.first_sample if first is None else max(first, self.first_sample)
        end = self.end_sample if last is None else min(last, self.end_sample)
        rows = np.empty((max(end - begin, 0), len(self.channel_names)))
        if len(rows):
            for at, samples in self.chunks(begin, None if last is None else end):
                rows[at - begin : at - begin + len(samples)] = samples
        return rows

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time in ns and decoded message of each message of ``topic`` (key in TOPICS)."""
        for message in self._messages(topic):
            yield message.log_time, deserialize(TOPICS[topic].type, message.data)

    def _sample(self, time_ns: int) -> int:
        sample, rest = divmod(time_ns - self.epoch_ns, self.sample_interval_ns)
        if rest:
            raise GearboxError(f"{self.path}: the time {time_ns} ns is that of no sample")
        return sample

    def _messages(self, topic: str, from_ns: int | None = None) -> Iterator[Message]:
        for part in self.parts:
            yield from _part_messages(part, self._names[topic], from_ns)

    def _latched(self, topic: str) -> Iterator[Any]:
        """Decoded messages of a latched topic without the repetition at the start of each part."""
        previous = b""
        for part in self.parts:
            for number, message in enumerate(_part_messages(part, self._names[topic])):
                if number or message.data != previous:
                    yield deserialize(TOPICS[topic].type, message.data)
                previous = message.data

    def _sample_span(self) -> tuple[int, int]:
        if self._span is None:
            self._span = self._find_span()
        return self._span

    def _find_span(self) -> tuple[int, int]:
        earliest = next(self._messages("waveform"), None)
        if earliest is None:
            sample = int(self.start["sample"])
            return sample, sample
        rows = len(waveform_samples(deserialize(TOPICS["waveform"].type, earliest.data))[1])
        latest = earliest
        for part in reversed(self.parts):
            found = _last_message(part, self._names["waveform"])
            if found is not None:
                latest = found
                break
        return self._sample(earliest.log_time) - rows + 1, self._sample(latest.log_time) + 1


def open(path: str | Path) -> Recording:
    """The recording at ``path``: a rosbag2 folder or one MCAP file, finished or broken off.

    Raises UsageError if there is none, GearboxError if it wasn't written by this package or is spoilt.
    """
    path = Path(path)
    parts = _open_parts(_files(path))
    return Recording(path, parts, _parameters(parts[0].path))


def _event(entry: dict[str, Any]) -> Event:
    return Event(
        sample=entry["sample"],
        time=entry["time"],
        kind=entry["event"],
        message=entry["message"],
        counters=entry.get("counters", {}),
        parameters=entry.get("parameters", {}),
        checkpoint=entry.get("checkpoint", {}),
    )


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise UsageError(f"no recording at '{path}': give a rosbag2 folder or an .mcap file")
    files = sorted(path.glob("*.mcap"), key=layout.part_number)
    if not files:
        raise UsageError(f"no recording in '{path}': the folder holds no .mcap file")
    return files


def _open_parts(files: list[Path]) -> tuple[PartFile, ...]:
    parts = [_open_part(file) for file in files[:-1]]
    try:
        parts.append(_open_part(files[-1]))
    except GearboxError:
        # A crash right after a split leaves a last file without even its start, and no message in it.
        if not parts:
            raise
    return tuple(parts)


def _open_part(path: Path) -> PartFile:
    with _reading(path) as stream:
        found = survey(stream)
        attachments = read_attachments(stream, found)
        records = read_metadata(stream, found)
        try:
            run = RunMetadata.from_text(records[layout.RUN_METADATA])
            start = json.loads(attachments[layout.START_ATTACHMENT])
        except (KeyError, ValueError) as error:
            raise GearboxError(
                f"'{path}' is no recording of this package, or its start is lost: {error}"
            ) from error
        return PartFile(path, run, start, path.stat().st_size, found)


def _parameters(path: Path) -> Parameters:
    with _reading(path) as stream:
        attachments = read_attachments(stream, survey(stream))
    if layout.PARAMETERS_ATTACHMENT not in attachments:
        raise GearboxError(
            f"'{path}' is no recording of this package: it lacks {layout.PARAMETERS_ATTACHMENT}"
        )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / layout.PARAMETERS_ATTACHMENT
        file.write_bytes(attachments[layout.PARAMETERS_ATTACHMENT])
        return load(file)


@contextmanager
def _reading(path: Path) -> Iterator[BinaryIO]:
    try:
        stream = path.open("rb")
    except OSError as error:
        raise GearboxError(f"can't read '{path}': {error.strerror}") from error
    with stream:
        yield stream


def _part_messages(part: PartFile, topic: str, from_ns: int | None = None) -> Iterator[Message]:
    number = _channel(part, topic)
    with _reading(part.path) as stream:
        for index in part.found.chunks:
            if number not in index.message_index_offsets:
                continue
            if from_ns is not None and index.message_end_time < from_ns:
                continue
            for record in read_chunk(stream, index):
                if (
                    isinstance(record, Message)
                    and record.channel_id == number
                    and (from_ns is None or record.log_time >= from_ns)
                ):
                    yield record


def _last_message(part: PartFile, topic: str) -> Message | None:
    number = _channel(part, topic)
    with _reading(part.path) as stream:
        for index in reversed(part.found.chunks):
            if number in index.message_index_offsets:
                records = read_chunk(stream, index)
                messages = [r for r in records if isinstance(r, Message) and r.channel_id == number]
                return messages[-1]
    return None


def _channel(part: PartFile, topic: str) -> int | None:
    return next((number for number, channel in part.found.channels.items() if channel.topic == topic), None)
