"""Makes a complete recording of a broken one: copies all intact records to new files and writes indexes.

The broken recording is only read.
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
from gear_dynamics_ros.recording.coverage import (
    SampleRange,
    listed_files,
    require_no_overlap,
    require_same_run,
)
from gear_dynamics_ros.recording.layout import Definitions, PartSummary, RunMetadata
from gear_dynamics_ros.recording.mcap.index import bytes_behind, read_summary
from gear_dynamics_ros.recording.mcap.records import ChunkContent, FoundRecord, first_bytes, walk
from gear_dynamics_ros.recording.mcap.writer import McapWriter
from gear_dynamics_ros.recording.parts import part_files, reading
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.system.files import new_folder, replace_text, require_new
from gear_dynamics_ros.topics import DEFAULT_NAMES, TOPICS, NodeNames, Topic

_LIBRARY: Final = f"{layout.RUN_METADATA} {__version__}"


class RecoveredPart(NamedTuple):
    """Result for one file."""

    name: str  # of the broken file
    size: int  # of the broken file, bytes
    finished: bool  # whether it ends with an intact index
    ended: bool  # whether its data are complete to their end, with or without an intact index behind them
    break_at: int  # offset of the byte after its last whole record
    behind: int  # bytes behind its end, left out
    messages: int  # kept, on all topics
    samples: int  # kept
    span: SampleRange | None  # from the first to the last sample kept
    damaged_chunks: int
    damaged_attachments: int
    damaged_metadata: int

    @property
    def tail(self) -> int:
        """Number of bytes at the end of the file that hold no whole record of data."""
        return 0 if self.ended else self.size - self.break_at

    @property
    def whole(self) -> bool:
        """Whether nothing of it was lost."""
        damaged = self.damaged_chunks or self.damaged_attachments or self.damaged_metadata
        return self.ended and not (self.behind or damaged)


class Recovery(NamedTuple):
    """Result of a recovery: what was kept, and what is lost."""

    source: Path
    target: Path
    parts: tuple[RecoveredPart, ...]
    left_out: Mapping[str, str]  # reason by name of the file
    missing: tuple[str, ...]  # files that metadata.yaml lists, with their times, and that are not there
    gaps: tuple[SampleRange, ...]  # samples missing between those kept
    sample_interval_ns: int | None  # None if no file has it
    metadata_whole: bool  # whether metadata.yaml was there and readable, or the source is a single file

    @property
    def size(self) -> int:
        """Size of the files read, bytes."""
        return sum(part.size for part in self.parts)

    @property
    def messages(self) -> int:
        """Number of messages kept."""
        return sum(part.messages for part in self.parts)

    @property
    def samples(self) -> int:
        """Number of samples kept."""
        return sum(part.samples for part in self.parts)

    @property
    def span(self) -> SampleRange | None:
        """Range from the first to the last sample kept; None if no sample was kept."""
        spans = [part.span for part in self.parts if part.span is not None]
        return (
            SampleRange(min(span.first for span in spans), max(span.end for span in spans)) if spans else None
        )

    @property
    def whole(self) -> bool:
        """Whether nothing was lost."""
        return all(part.whole for part in self.parts) and not (self.left_out or self.missing or self.gaps)


def default_target(source: Path) -> Path:
    """Default path of the recovered recording: beside ``source``, with ``_recovered`` behind its name."""
    path = Path(os.path.abspath(source))
    name = path.stem if path.is_file() else path.name
    return path.with_name(f"{name}_recovered")


def recover(source: Path, target: Path, progress: Callable[[float], None] = lambda share: None) -> Recovery:
    """Copy everything intact in ``source``, a rosbag2 folder or one MCAP file, to the new folder ``target``.

    ``progress`` is called with the fraction of the work that is done, 0 to 1. Holds one record in memory at a
    time. ``target`` appears when it is complete, or not at all.

    Raises UsageError if ``source`` does not exist or was not recorded by this package, or if ``target``
    exists, lies in ``source`` or can't be created; GearboxError if no file is MCAP, a file has topics that
    this package does not know, the files are not of one run, or reading or writing fails.
    """
    source, target = Path(os.path.abspath(source)), Path(os.path.abspath(target))
    files = part_files(source)
    _require_place(source, target)
    found, left_out = _inspect_all(source, files, lambda share: progress(share / 2))
    found = _in_order(found)
    tracker = _SampleTracker(next((part.run for part in found if part.run is not None), None))
    missing, metadata_whole = _missing_files(source, files, tracker.run)
    with new_folder(target) as draft:
        rebuilt = _rebuild_all(
            found, draft, _names(found, target), tracker, lambda share: progress((1 + share) / 2)
        )
    progress(1.0)
    return Recovery(
        source,
        target,
        tuple(part.report for part in rebuilt),
        left_out,
        missing,
        tuple(tracker.gaps),
        None if tracker.run is None else tracker.run.sample_interval_ns,
        metadata_whole,
    )


@dataclass
class _BrokenFile:
    """One file of the broken recording: what its records say, as far as they have been read."""

    path: Path
    size: int  # bytes
    end: int  # offset of the byte after the last whole record
    finished: bool
    ended: bool = False
    definitions: Definitions = field(default_factory=lambda: Definitions({}, {}))
    library: str = ""  # that wrote it
    run: RunMetadata | None = None
    first_sample: int | None = None  # according to its start checkpoint
    chunks: int = 0  # damaged ones too
    behind: int = 0  # bytes behind its end

    @property
    def without_start(self) -> bool:
        """Whether it broke off before its start checkpoint."""
        return self.first_sample is None and not self.chunks and not self.ended

    def add(self, record: FoundRecord) -> None:
        """Take the next record into account. Raises GearboxError on a topic with an unknown type."""
        content = record.content
        self.chunks += record.opcode == Opcode.CHUNK
        if not record.fault:  # a damaged record at the end of the file counts as part of the tail
            self.end = record.offset + record.length
        if isinstance(content, ChunkContent):
            _require_known(self.path, content)
            _add_missing(self.definitions, content.schemas, content.channels)
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


class _SampleTracker:
    """Follows the samples of a recording through its parts, and notes gaps between them."""

    def __init__(self, run: RunMetadata | None) -> None:
        self.run = run
        self.names = DEFAULT_NAMES if run is None else run.names
        self.gaps: list[SampleRange] = []
        self.samples = 0  # of the present part
        self.span: SampleRange | None = None  # of the present part
        self._topic = self.names.topic("waveform")
        self._expected: int | None = None

    def begin_part(self, path: Path, first_sample: int | None) -> None:
        """Begin the part ``path``; ``first_sample`` is that of its start checkpoint, None if it has none.

        Raises GearboxError if the parts so far have this sample.
        """
        self.samples, self.span = 0, None
        if first_sample is None:
            return
        if self._expected is not None and self.run is not None:
            begun = SampleRange(first_sample, self._expected)
            require_no_overlap(path, begun, self._expected, self.run.sample_interval_ns)
        self._reach(SampleRange(first_sample, first_sample))

    def add_chunk(self, content: ChunkContent, channels: Mapping[int, Channel]) -> None:
        """Take the next chunk into account."""
        waveform = [number for number in content.positions if channels[number].topic == self._topic]
        for _, time_ns, data in content.messages(waveform):
            samples = self._samples_of(time_ns, data)
            if samples is not None:
                self._add(samples)

    def _add(self, samples: SampleRange) -> None:
        self._reach(samples)
        self.samples += samples.end - samples.first
        span = samples if self.span is None else self.span
        self.span = SampleRange(min(span.first, samples.first), max(span.end, samples.end))

    def _reach(self, samples: SampleRange) -> None:
        """Note a gap before ``samples``, if there is one."""
        if self._expected is not None and samples.first > self._expected:
            self.gaps.append(SampleRange(self._expected, samples.first))
        self._expected = samples.end if self._expected is None else max(samples.end, self._expected)

    def _samples_of(self, time_ns: int, data: memoryview) -> SampleRange | None:
        """The samples of a waveform message with the stamp of the last one; None if it is invalid."""
        if self.run is None:
            return None
        try:
            rows = row_count(data)
        except GearboxError:  # an invalid message is copied too, but counts no samples
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
) -> tuple[list[_BrokenFile], dict[str, str]]:
    """The files to recover; and the reasons why others are left out, by name.

    Raises UsageError if the recording was not recorded by this package, GearboxError if no file is MCAP.
    """
    inspected = [_inspect(file, _stage(progress, number, len(files))) for number, file in enumerate(files)]
    broken = [part for part in inspected if part is not None]
    if not broken:
        raise GearboxError(f"'{files[0]}' is not an MCAP file: its first bytes are others")
    _require_own(source, broken)
    with_start, without_start = _separate(broken)
    left_out = {
        **{
            file.name: "not an MCAP file" for file, part in zip(files, inspected, strict=True) if part is None
        },
        **{part.path.name: "broke off before its start" for part in without_start},
    }
    return with_start, left_out


def _inspect(path: Path, progress: Callable[[float], None]) -> _BrokenFile | None:
    """Read through a file; None if it is not an MCAP file."""
    with reading(path) as stream:
        if not MCAP0_MAGIC.startswith(first_bytes(stream)):
            return None
        size = stream.seek(0, os.SEEK_END)
        summary = read_summary(stream)
        broken = _BrokenFile(path, size, min(size, len(MCAP0_MAGIC)), summary is not None)
        outside = Definitions({}, {})  # of chunks
        records = walk(stream, size)
        for record in records:
            if record.opcode == Opcode.DATA_END:
                broken.ended, broken.end = True, record.offset + record.length
                broken.behind = 0 if broken.finished else bytes_behind(stream, records)
                break
            broken.add(record)
            if isinstance(record.content, Schema):
                _add_missing(outside, {record.content.id: record.content}, {})
            elif isinstance(record.content, Channel):
                _add_missing(outside, {}, {record.content.id: record.content})
            progress((record.offset + record.length) / size)
    # Definitions inside chunks come first, then the summary, because both have checksums; others have none.
    if summary is not None:
        _add_missing(broken.definitions, summary.schemas, summary.channels)
    _add_missing(broken.definitions, outside.schemas, outside.channels)
    broken.definitions = _usable(broken.definitions)
    return broken


def _in_order(found: Sequence[_BrokenFile]) -> list[_BrokenFile]:
    """The files in the order of their samples; those without a start stay behind the one before.

    Raises GearboxError if they are not of one run.
    """
    known = [(part.path, part.run) for part in found if part.run is not None]
    for path, run in known[1:]:
        require_same_run(path, run, *known[0])
    starts: list[int] = []
    for part in found:
        before = starts[-1] if starts else -1
        starts.append(before if part.first_sample is None else part.first_sample)
    return [part for _, part in sorted(zip(starts, found, strict=True), key=lambda entry: entry[0])]


def _missing_files(
    source: Path, files: Sequence[Path], run: RunMetadata | None
) -> tuple[tuple[str, ...], bool]:
    """Files that metadata.yaml lists and that are not there; and whether it was there and readable."""
    try:
        listed = listed_files(source)
    except GearboxError:  # it is written again
        return (), False
    names = {file.name for file in files}
    epoch_ns = 0 if run is None else run.epoch_ns
    missing = tuple(file.text(epoch_ns) for file in listed or () if file.name not in names)
    return missing, source.is_file() or listed is not None


def _require_own(source: Path, files: Sequence[_BrokenFile]) -> None:
    """Raise UsageError if other programs wrote all files, according to their headers."""
    others = [
        part.library for part in files if part.library and not part.library.startswith(layout.RUN_METADATA)
    ]
    if len(others) == len(files) and all(part.run is None for part in files):
        raise UsageError(f"'{source}' was not recorded by this package: {others[0]!r:.80} wrote it")


def _separate(files: Sequence[_BrokenFile]) -> tuple[list[_BrokenFile], list[_BrokenFile]]:
    """Files with and without a start. If none has one, all are returned as the first.

    A crash right after a split leaves a last file without a start.
    """
    without_start = [part for part in files if part.without_start]
    if len(without_start) == len(files):
        return list(files), []
    return [part for part in files if not part.without_start], without_start


def _add_missing(
    definitions: Definitions, schemas: Mapping[int, Schema], channels: Mapping[int, Channel]
) -> None:
    """Add those schemas and channels to ``definitions`` whose numbers are not defined there yet."""
    for number, schema in schemas.items():
        definitions.schemas.setdefault(number, schema)
    for number, channel in channels.items():
        definitions.channels.setdefault(number, channel)


def _usable(definitions: Definitions) -> Definitions:
    """``definitions`` without the channels that no reader could decode."""
    channels = {
        number: channel
        for number, channel in definitions.channels.items()
        if channel.message_encoding == "cdr"
        and channel.schema_id in definitions.schemas
        and definitions.schemas[channel.schema_id].name in TYPESTORE.fielddefs
    }
    return Definitions(definitions.schemas, channels)


def _require_known(path: Path, content: ChunkContent) -> None:
    """Raise GearboxError on a topic whose type this package does not know."""
    for channel in content.channels.values():
        schema = content.schemas.get(channel.schema_id)
        if schema is not None and schema.name not in TYPESTORE.fielddefs:
            raise GearboxError(
                f"'{path}' was not recorded by this package: "
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


def _names(found: Sequence[_BrokenFile], target: Path) -> list[str]:
    """File names of the new parts, with the numbers of the old ones in order, if all of these have one."""
    numbers = sorted(layout.part_number(part.path) for part in found)
    if min(numbers) < 0 or len(set(numbers)) < len(numbers):
        numbers = list(range(len(found)))
    return [layout.part_name(target, number) for number in numbers]


def _definitions(part: _BrokenFile, files: Sequence[_BrokenFile]) -> Definitions:
    """Definitions of ``part``, or of another file if it lost its own: all files of a run have the same."""
    candidates = (part.definitions, *(other.definitions for other in files))
    return next((definitions for definitions in candidates if definitions.channels), part.definitions)


def _rebuild_all(
    found: Sequence[_BrokenFile],
    folder: Path,
    names: Sequence[str],
    tracker: _SampleTracker,
    progress: Callable[[float], None],
) -> list[_Rebuilt]:
    """Write the new files, but for those without messages if others have some, and metadata.yaml.

    Raises OSError if that fails.
    """
    rebuilt = [
        _rebuild(
            part, folder / name, _definitions(part, found), tracker, _stage(progress, number, len(found))
        )
        for number, (part, name) in enumerate(zip(found, names, strict=True))
    ]
    topics = {name: topic for part in rebuilt for name, topic in part.topics.items()}
    # rosbag2 takes a file without messages for one at the time 0, and can wait there for ever.
    filled = [part.part for part in rebuilt if part.part.messages]
    for part in rebuilt if filled else ():
        if not part.part.messages:
            (folder / part.part.name).unlink()
    metadata = layout.metadata_yaml(topics, filled or [part.part for part in rebuilt])
    replace_text(folder / layout.METADATA_FILE, metadata)
    return rebuilt


def _rebuild(
    source: _BrokenFile,
    path: Path,
    definitions: Definitions,
    tracker: _SampleTracker,
    progress: Callable[[float], None],
) -> _Rebuilt:
    """Write one new file. Raises OSError if that fails."""
    tracker.begin_part(source.path, source.first_sample)
    with reading(source.path) as stream, closing(McapWriter(path, _LIBRARY)) as writer:
        _define(writer, definitions, tracker.names)
        damaged = _copy_records(source, stream, writer, definitions.channels, tracker, progress)
        index = writer.index
        part = PartSummary(path.name, index.start_ns, index.end_ns, index.topic_counts())
        topics = _topics(index.schemas, index.channels, tracker.names)
        writer.add_metadata(layout.ROSBAG2_METADATA, layout.embedded_metadata(topics, part))
        writer.finish()
    return _Rebuilt(part, topics, _recovered_part(source, part, tracker, damaged))


def _copy_records(
    source: _BrokenFile,
    stream: BinaryIO,
    writer: McapWriter,
    channels: Mapping[int, Channel],
    tracker: _SampleTracker,
    progress: Callable[[float], None],
) -> Counter[int]:
    """Copy all intact records; returns the number of damaged ones by kind (opcode)."""
    damaged: Counter[int] = Counter()
    for record in _data(stream, source.end):
        progress((record.offset + record.length) / source.size)
        content = record.content
        if isinstance(content, ChunkContent) and _readable(content, channels):
            _copy_chunk(writer, content)
            tracker.add_chunk(content, channels)
        elif isinstance(content, Attachment):
            writer.add_attachment(content.log_time, content.name, content.media_type, bytes(content.data))
        elif isinstance(content, Metadata):
            _copy_metadata(writer, content)
        else:
            damaged[record.opcode] += 1
    return damaged


def _recovered_part(
    source: _BrokenFile, part: PartSummary, tracker: _SampleTracker, damaged: Counter[int]
) -> RecoveredPart:
    return RecoveredPart(
        name=source.path.name,
        size=source.size,
        finished=source.finished,
        ended=source.ended,
        break_at=source.end,
        behind=source.behind,
        messages=part.messages,
        samples=tracker.samples,
        span=tracker.span,
        damaged_chunks=damaged[Opcode.CHUNK],
        damaged_attachments=damaged[Opcode.ATTACHMENT],
        damaged_metadata=damaged[Opcode.METADATA],
    )


def _data(stream: BinaryIO, end: int) -> Iterator[FoundRecord]:
    """The records of the data section before byte ``end``."""
    return itertools.takewhile(lambda record: record.opcode != Opcode.DATA_END, walk(stream, end))


def _define(writer: McapWriter, definitions: Definitions, names: NodeNames) -> None:
    """Write schemas and channels; if there are none, those of all topics."""
    if not definitions.channels:
        definitions = layout.channel_definitions((names.topic(key), topic) for key, topic in TOPICS.items())
    writer.add_definitions(*definitions)


def _readable(content: ChunkContent, channels: Mapping[int, Channel]) -> bool:
    """Whether all channels of a chunk are known."""
    return content.positions.keys() | content.channels.keys() <= channels.keys()


def _copy_chunk(writer: McapWriter, content: ChunkContent) -> None:
    if not content.positions:
        return
    times = [time_ns for flat in content.positions.values() for time_ns in flat[::2]]
    # The times in the header of a chunk have no checksum, unlike those of its messages.
    chunk = replace(content.chunk, message_start_time=min(times), message_end_time=max(times))
    writer.add_chunk(chunk, content.positions)


def _copy_metadata(writer: McapWriter, content: Metadata) -> None:
    # The metadata of the old file contain its name; the new file gets its own.
    if content.name != layout.ROSBAG2_METADATA:
        writer.add_metadata(content.name, content.metadata)


def _topics(
    schemas: Mapping[int, Schema], channels: Mapping[int, Channel], names: NodeNames
) -> dict[str, Topic]:
    """Topics by full name, with the quality of service of this version or, if unknown to it, the default."""
    known = {names.topic(key): topic for key, topic in TOPICS.items()}
    return {
        channel.topic: known.get(channel.topic, Topic(channel.topic, schemas[channel.schema_id].name, ""))
        for channel in channels.values()
    }
