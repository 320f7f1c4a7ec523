"""Makes a whole recording of a broken one: what stands whole in its files, in new files with indexes.

The broken one is only read.
"""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros import __version__
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.cdr import TYPESTORE
from gear_dynamics_ros.messages.decoder import row_count
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import Definitions, PartSummary, RunMetadata
from gear_dynamics_ros.recording.mcap.index import read_summary
from gear_dynamics_ros.recording.mcap.records import ChunkContent, FoundRecord, first_bytes, walk
from gear_dynamics_ros.recording.mcap.writer import McapWriter
from gear_dynamics_ros.recording.parts import part_files, reading
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.system.files import new_folder, replace_text, require_new
from gear_dynamics_ros.topics import TOPICS, Topic, resolve

_LIBRARY: Final = f"{layout.RUN_METADATA} {__version__}"


class SampleRange(NamedTuple):
    """The samples from ``first`` to before ``end``."""

    first: int
    end: int


class RecoveredPart(NamedTuple):
    """What became of one file."""

    name: str  # of the broken file
    size: int  # its bytes
    finished: bool  # it ends with an intact index
    ended: bool  # its data are there up to their end, be the index behind them intact or not
    break_at: int  # byte behind its last whole record
    messages: int  # kept, on all topics
    samples: int  # kept
    span: SampleRange | None  # from the first to the last sample kept
    spoilt_chunks: int
    spoilt_attachments: int
    spoilt_metadata: int

    @property
    def tail(self) -> int:
        """Bytes at the end that hold no whole record of data."""
        return 0 if self.ended else self.size - self.break_at

    @property
    def whole(self) -> bool:
        """Whether nothing in it was lost."""
        return self.ended and not (self.spoilt_chunks or self.spoilt_attachments or self.spoilt_metadata)


class Recovery(NamedTuple):
    """What a recovery kept and what is lost."""

    source: Path
    target: Path
    parts: tuple[RecoveredPart, ...]
    left_out: Mapping[str, str]  # why, by name of the file
    gaps: tuple[SampleRange, ...]  # samples missing between those kept
    sample_interval_ns: int | None  # None where no file tells
    described: bool  # metadata.yaml was there, or was not due

    @property
    def size(self) -> int:
        """Bytes read."""
        return sum(part.size for part in self.parts)

    @property
    def messages(self) -> int:
        """Messages kept."""
        return sum(part.messages for part in self.parts)

    @property
    def samples(self) -> int:
        """Samples kept."""
        return sum(part.samples for part in self.parts)

    @property
    def span(self) -> SampleRange | None:
        """From the first to the last sample kept; None if there is none."""
        spans = [part.span for part in self.parts if part.span is not None]
        return (
            SampleRange(min(span.first for span in spans), max(span.end for span in spans)) if spans else None
        )

    @property
    def whole(self) -> bool:
        """Whether nothing was lost."""
        return all(part.whole for part in self.parts) and not (self.left_out or self.gaps)


def default_target(source: Path) -> Path:
    """Where the recording ``source`` is recovered to unless told otherwise: beside it."""
    path = Path(os.path.abspath(source))
    name = path.stem if path.is_file() else path.name
    return path.with_name(f"{name}_recovered")


def recover(source: Path, target: Path, progress: Callable[[float], None] = lambda share: None) -> Recovery:
    """Make the new folder ``target`` of all that is whole in ``source``, a rosbag2 folder or one MCAP file.

    ``progress`` is called with the share of the work that is done, 0 to 1. Holds one record in memory at a
    time. ``target`` appears when it is complete, or not at all.

    Raises UsageError if there is no recording of this package, or ``target`` exists, lies in it or can't be
    made; GearboxError if no file is MCAP, a file holds topics that this package doesn't know, or reading or
    writing fails.
    """
    source, target = Path(os.path.abspath(source)), Path(os.path.abspath(target))
    files = part_files(source)
    _require_place(source, target)
    found, left_out = _inspect_all(source, files, lambda share: progress(share / 2))
    track = _Track(next((part.run for part in found if part.run is not None), None))
    with new_folder(target) as draft:
        rebuilt = _rebuild_all(
            found, draft, _names(found, target), track, lambda share: progress((1 + share) / 2)
        )
    progress(1.0)
    return Recovery(
        source,
        target,
        tuple(part.report for part in rebuilt),
        left_out,
        tuple(track.gaps),
        None if track.run is None else track.run.sample_interval_ns,
        source.is_file() or (source / layout.METADATA_FILE).is_file(),
    )


@dataclass
class _Source:
    """One file of the broken recording, as far as it has been looked through."""

    path: Path
    size: int
    end: int  # byte behind the last whole record
    finished: bool
    ended: bool = False
    definitions: Definitions = field(default_factory=lambda: Definitions({}, {}))
    library: str = ""  # that wrote it
    run: RunMetadata | None = None
    first_sample: int | None = None  # that its start tells
    chunks: int = 0  # spoilt ones too

    @property
    def unbegun(self) -> bool:
        """Whether it broke off before it told from which state it starts."""
        return self.first_sample is None and not self.chunks and not self.ended

    def note(self, record: FoundRecord) -> None:
        """Take in the next record. Raises GearboxError on a topic that this package doesn't know."""
        content = record.content
        self.ended = self.ended or record.opcode == Opcode.DATA_END
        self.chunks += record.opcode == Opcode.CHUNK
        if not record.fault:  # what is spoilt at the very end belongs to what broke off there
            self.end = record.offset + record.length
        if isinstance(content, ChunkContent):
            _require_known(self.path, content)
            _add(self.definitions, content.schemas, content.channels)
        elif isinstance(content, Header):
            self.library = content.library
        elif isinstance(content, Metadata) and content.name == layout.RUN_METADATA:
            self.run = _run(content.metadata)
        elif isinstance(content, Attachment) and content.name == layout.START_ATTACHMENT:
            self.first_sample = _first_sample(content.data)


class _Rebuilt(NamedTuple):
    """One file of the new recording."""

    part: PartSummary
    topics: dict[str, Topic]  # by full name
    report: RecoveredPart


class _Track:
    """Follows the samples of a recording through its parts, and where some are missing."""

    def __init__(self, run: RunMetadata | None) -> None:
        self.run = run
        self.node = "/gearbox" if run is None else run.node
        self.gaps: list[SampleRange] = []
        self.samples = 0  # of the part at hand
        self.span: SampleRange | None = None  # of the part at hand
        self._topic = resolve(TOPICS["waveform"], self.node)
        self._expected: int | None = None

    def begin(self, first_sample: int | None) -> None:
        """A part begins, with the sample that its start tells."""
        self.samples, self.span = 0, None
        if first_sample is not None:
            self._reach(SampleRange(first_sample, first_sample))

    def follow(self, content: ChunkContent, channels: Mapping[int, Channel]) -> None:
        """Take in the next chunk."""
        wanted = [number for number in content.positions if channels[number].topic == self._topic]
        for _, time_ns, data in content.messages(wanted):
            self._add(self._held(time_ns, data))

    def _add(self, held: SampleRange | None) -> None:
        if held is None:
            return
        self._reach(held)
        self.samples += held.end - held.first
        known = held if self.span is None else self.span
        self.span = SampleRange(min(known.first, held.first), max(known.end, held.end))

    def _reach(self, held: SampleRange) -> None:
        if self._expected is not None and held.first > self._expected:
            self.gaps.append(SampleRange(self._expected, held.first))
        self._expected = held.end if self._expected is None else max(held.end, self._expected)

    def _held(self, time_ns: int, data: memoryview) -> SampleRange | None:
        """The samples of a message, stamped at its last; None if it can't be one of a run."""
        if self.run is None:
            return None
        try:
            rows = row_count(data)
        except GearboxError:  # a message that can't be understood is kept as it is, but holds no samples
            return None
        last, rest = divmod(time_ns - self.run.epoch_ns, self.run.sample_interval_ns)
        return SampleRange(last - rows + 1, last + 1) if rows and not rest else None


def _require_place(source: Path, target: Path) -> None:
    require_new(target)
    if Path(os.path.realpath(target)).is_relative_to(os.path.realpath(source)):
        raise UsageError(f"'{target}' lies inside the recording itself: choose a path beside it")


def _stage(progress: Callable[[float], None], number: int, count: int) -> Callable[[float], None]:
    """Progress within one of ``count`` stages of the work."""
    return lambda share: progress((number + share) / count)


def _inspect_all(
    source: Path, files: Sequence[Path], progress: Callable[[float], None]
) -> tuple[list[_Source], dict[str, str]]:
    """What is whole in the files of a recording; and why others are left out, by name.

    Raises UsageError if the recording is not of this package, GearboxError if no file is MCAP.
    """
    inspected = [_inspect(file, _stage(progress, number, len(files))) for number, file in enumerate(files)]
    found = [part for part in inspected if part is not None]
    if not found:
        raise GearboxError(f"'{files[0]}' is no MCAP file: its first bytes are not those of one")
    _require_own(source, found)
    begun, unbegun = _begun(found)
    left_out = {
        **{file.name: "no MCAP file" for file, part in zip(files, inspected, strict=True) if part is None},
        **{part.path.name: "broke off before its start" for part in unbegun},
    }
    return begun, left_out


def _inspect(path: Path, progress: Callable[[float], None]) -> _Source | None:
    """What is whole in a file; None if it is no MCAP file."""
    with reading(path) as stream:
        if not MCAP0_MAGIC.startswith(first_bytes(stream)):
            return None
        size = stream.seek(0, os.SEEK_END)
        summary = read_summary(stream)
        source = _Source(path, size, min(size, len(MCAP0_MAGIC)), summary is not None)
        outside = Definitions({}, {})
        for record in walk(stream, size):
            source.note(record)
            if isinstance(record.content, Schema):
                _add(outside, {record.content.id: record.content}, {})
            elif isinstance(record.content, Channel):
                _add(outside, {}, {record.content.id: record.content})
            progress((record.offset + record.length) / size)
    # Those inside chunks have a checksum each, the summary has one, those that stand alone have none.
    for schemas, channels in ([] if summary is None else [(summary.schemas, summary.channels)]) + [outside]:
        _add(source.definitions, schemas, channels)
    source.definitions = _usable(source.definitions)
    return source


def _require_own(source: Path, found: Sequence[_Source]) -> None:
    """Raise UsageError where nothing says that this package recorded any of the files."""
    strange = [
        part.library for part in found if part.library and not part.library.startswith(layout.RUN_METADATA)
    ]
    if len(strange) == len(found) and all(part.run is None for part in found):
        raise UsageError(f"'{source}' is no recording of this package: {strange[0]!r:.80} wrote it")


def _begun(found: Sequence[_Source]) -> tuple[list[_Source], list[_Source]]:
    """The files without those that a crash right after a split leaves, and those; where others are there."""
    unbegun = [part for part in found if part.unbegun]
    if len(unbegun) == len(found):
        return list(found), []
    return [part for part in found if not part.unbegun], unbegun


def _add(found: Definitions, schemas: Mapping[int, Schema], channels: Mapping[int, Channel]) -> None:
    """Take in what has no definition yet."""
    for number, schema in schemas.items():
        found.schemas.setdefault(number, schema)
    for number, channel in channels.items():
        found.channels.setdefault(number, channel)


def _usable(found: Definitions) -> Definitions:
    """Without channels that no reader could decode."""
    channels = {
        number: channel
        for number, channel in found.channels.items()
        if channel.message_encoding == "cdr"
        and channel.schema_id in found.schemas
        and found.schemas[channel.schema_id].name in TYPESTORE.fielddefs
    }
    return Definitions(found.schemas, channels)


def _require_known(path: Path, content: ChunkContent) -> None:
    for channel in content.channels.values():
        schema = content.schemas.get(channel.schema_id)
        if schema is not None and schema.name not in TYPESTORE.fielddefs:
            raise GearboxError(
                f"'{path}' is no recording of this package: "
                f"its topic {channel.topic!r:.80} has the type {schema.name!r:.80}"
            )


def _run(values: Mapping[str, str]) -> RunMetadata | None:
    try:
        return RunMetadata.from_text(values)
    except (KeyError, ValueError):
        return None


def _first_sample(start: bytes) -> int | None:
    try:
        return StoredCheckpoint.from_text(start.decode(), layout.START_ATTACHMENT).checkpoint.sample
    except (UnicodeDecodeError, UsageError):
        return None


def _names(found: Sequence[_Source], target: Path) -> list[str]:
    """File names of the new parts, with the numbers of the old ones where these have any."""
    numbers = [layout.part_number(part.path) for part in found]
    if min(numbers) < 0 or len(set(numbers)) < len(numbers):
        numbers = list(range(len(found)))
    return [layout.part_name(target, number) for number in numbers]


def _definitions(part: _Source, found: Sequence[_Source]) -> Definitions:
    """The file's own; if the chunk that held them is lost, those of another: all files of a run agree."""
    candidates = (part.definitions, *(each.definitions for each in found))
    return next((each for each in candidates if each.channels), part.definitions)


def _rebuild_all(
    found: Sequence[_Source],
    folder: Path,
    names: Sequence[str],
    track: _Track,
    progress: Callable[[float], None],
) -> list[_Rebuilt]:
    """Write the new files, and metadata.yaml beside them. Raises OSError when that fails."""
    rebuilt = [
        _rebuild(part, folder / name, _definitions(part, found), track, _stage(progress, number, len(found)))
        for number, (part, name) in enumerate(zip(found, names, strict=True))
    ]
    topics = {name: topic for part in rebuilt for name, topic in part.topics.items()}
    metadata = layout.metadata_yaml(topics, [part.part for part in rebuilt])
    replace_text(folder / layout.METADATA_FILE, metadata)
    return rebuilt


def _rebuild(
    source: _Source,
    path: Path,
    definitions: Definitions,
    track: _Track,
    progress: Callable[[float], None],
) -> _Rebuilt:
    """Write one new file. Raises OSError when that fails."""
    track.begin(source.first_sample)
    with reading(source.path) as stream, closing(McapWriter(path, _LIBRARY)) as writer:
        _define(writer, definitions, track.node)
        spoilt = _copy_records(source, stream, writer, definitions.channels, track, progress)
        index = writer.index
        part = PartSummary(path.name, index.start_ns, index.end_ns, index.topic_counts())
        topics = _topics(index.schemas, index.channels, track.node)
        writer.add_metadata(layout.ROSBAG2_METADATA, layout.embedded_metadata(topics, part))
        writer.finish()
    return _Rebuilt(part, topics, _recovered_part(source, part, track, spoilt))


def _copy_records(
    source: _Source,
    stream: BinaryIO,
    writer: McapWriter,
    channels: Mapping[int, Channel],
    track: _Track,
    progress: Callable[[float], None],
) -> Counter[int]:
    """Copy what is whole; returns how many records of which kind are spoilt."""
    spoilt: Counter[int] = Counter()
    for record in _data(stream, source.end):
        progress((record.offset + record.length) / source.size)
        content = record.content
        if isinstance(content, ChunkContent) and _readable(content, channels):
            _copy_chunk(writer, content)
            track.follow(content, channels)
        elif isinstance(content, Attachment):
            writer.add_attachment(content.log_time, content.name, content.media_type, bytes(content.data))
        elif isinstance(content, Metadata):
            _copy_metadata(writer, content)
        else:
            spoilt[record.opcode] += 1
    return spoilt


def _recovered_part(source: _Source, part: PartSummary, track: _Track, spoilt: Counter[int]) -> RecoveredPart:
    return RecoveredPart(
        name=source.path.name,
        size=source.size,
        finished=source.finished,
        ended=source.ended,
        break_at=source.end,
        messages=part.messages,
        samples=track.samples,
        span=track.span,
        spoilt_chunks=spoilt[Opcode.CHUNK],
        spoilt_attachments=spoilt[Opcode.ATTACHMENT],
        spoilt_metadata=spoilt[Opcode.METADATA],
    )


def _data(stream: BinaryIO, end: int) -> Iterator[FoundRecord]:
    """The records of data before byte ``end``."""
    return itertools.takewhile(lambda record: record.opcode != Opcode.DATA_END, walk(stream, end))


def _define(writer: McapWriter, found: Definitions, node: str) -> None:
    """Schemas and channels, before the first chunk; those of an empty recording where none are known."""
    if not found.channels:
        found = layout.channel_definitions((resolve(topic, node), topic) for topic in TOPICS.values())
    writer.add_definitions(*found)


def _readable(content: ChunkContent, channels: Mapping[int, Channel]) -> bool:
    """Whether all channels of a chunk are known."""
    return content.positions.keys() | content.channels.keys() <= channels.keys()


def _copy_chunk(writer: McapWriter, content: ChunkContent) -> None:
    if not content.positions:
        return
    times = [time_ns for flat in content.positions.values() for time_ns in flat[::2]]
    # The times in the head of a chunk have no checksum; those of its messages have.
    chunk = replace(content.chunk, message_start_time=min(times), message_end_time=max(times))
    writer.add_chunk(chunk, content.positions)


def _copy_metadata(writer: McapWriter, content: Metadata) -> None:
    # The one about the old file, by its old name, gives way to one about the new.
    if content.name != layout.ROSBAG2_METADATA:
        writer.add_metadata(content.name, content.metadata)


def _topics(schemas: Mapping[int, Schema], channels: Mapping[int, Channel], node: str) -> dict[str, Topic]:
    """Topics by full name, with the quality of service of this version's, or the usual one."""
    known = {resolve(topic, node): topic for topic in TOPICS.values()}
    return {
        channel.topic: known.get(channel.topic, Topic(channel.topic, schemas[channel.schema_id].name, ""))
        for channel in channels.values()
    }
