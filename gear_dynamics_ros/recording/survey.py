"""What one MCAP file holds, broken off or not: its own index, or one made by reading it through."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError

_HEAD: Final = struct.Struct("<BQ")
T = TypeVar("T")


class _Written(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


@dataclass
class Survey:
    """Where everything in an MCAP file is."""

    complete: bool  # the file ends with its own summary
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # channel -> messages
    end: int = 0  # where the last whole record of data ends
    unindexed: list[MessageIndex] = field(default_factory=list)  # of a last chunk whose own index is cut

    @property
    def start_ns(self) -> int:
        """Time of the first message, 0 if there is none."""
        return min((chunk.message_start_time for chunk in self.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message, 0 if there is none."""
        return max((chunk.message_end_time for chunk in self.chunks), default=0)

    def topic_counts(self) -> dict[str, int]:
        """Messages on each topic."""
        return {channel.topic: self.counts.get(number, 0) for number, channel in self.channels.items()}


def survey(stream: BinaryIO) -> Survey:
    """Survey of an MCAP file open for reading.

    Raises GearboxError if it is no MCAP file at all.
    """
    stream.seek(0)
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise GearboxError(f"{stream.name}: not an MCAP file: its first bytes are not those of one")
    return _from_summary(stream) or _from_records(stream)


def read_record(stream: BinaryIO, offset: int) -> bytes:
    """Content of the record at ``offset``."""
    stream.seek(offset)
    _, length = _HEAD.unpack(stream.read(_HEAD.size))
    return stream.read(length)


def read_chunk(stream: BinaryIO, index: ChunkIndex) -> list[Schema | Channel | Message]:
    """The records inside a chunk. Raises GearboxError if its checksum or content is spoilt."""
    return _unpack(_parse(read_record(stream, index.chunk_start_offset), Chunk.read), stream.name)


def read_attachments(stream: BinaryIO, found: Survey) -> dict[str, bytes]:
    """Attachments by name."""
    attachments = (_parse(read_record(stream, index.offset), Attachment.read) for index in found.attachments)
    return {attachment.name: attachment.data for attachment in attachments}


def read_metadata(stream: BinaryIO, found: Survey) -> dict[str, dict[str, str]]:
    """Metadata records by name."""
    records = (_parse(read_record(stream, index.offset), Metadata.read) for index in found.metadata)
    return {record.name: record.metadata for record in records}


def seal(path: Path) -> Survey:
    """Give a file that broke off the indexes and summary it lacks, cutting the piece of a record at its end.

    Raises OSError if the disk refuses, GearboxError if this is no MCAP file.
    """
    with path.open("r+b") as stream:
        found = survey(stream)
        if not found.complete:
            stream.truncate(found.end)
            stream.seek(found.end)
            stream.write(_ending(found))
    return found


def _from_summary(stream: BinaryIO) -> Survey | None:
    try:
        stream.seek(-len(MCAP0_MAGIC), 2)
        if stream.read() != MCAP0_MAGIC:
            return None
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except (McapError, OSError, struct.error, ValueError):
        return None
    return None if summary is None or summary.statistics is None else _whole(summary, summary.statistics)


def _whole(summary: Summary, statistics: Statistics) -> Survey:
    return Survey(
        complete=True,
        schemas=summary.schemas,
        channels=summary.channels,
        chunks=sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset),
        attachments=summary.attachment_indexes,
        metadata=summary.metadata_indexes,
        counts=dict(statistics.channel_message_counts),
    )


def _from_records(stream: BinaryIO) -> Survey:
    found = Survey(complete=False, end=len(MCAP0_MAGIC))
    last: Chunk | None = None
    for offset, opcode, body in _records(stream):
        if opcode == Opcode.MESSAGE_INDEX and last is not None:
            _note_index(found, offset, _HEAD.size + len(body), _parse(body, MessageIndex.read))
            continue
        if last is not None:
            found.end = offset
            last = None
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            last = _parse(body, Chunk.read)
            if not _note_chunk(found, offset, _HEAD.size + len(body), last, stream.name):
                last = None
                break
        elif opcode == Opcode.ATTACHMENT:
            found.attachments.append(
                _attachment_index(offset, _HEAD.size + len(body), _parse(body, Attachment.read))
            )
        elif opcode == Opcode.METADATA:
            name = _parse(body, Metadata.read).name
            found.metadata.append(MetadataIndex(offset=offset, length=_HEAD.size + len(body), name=name))
        found.end = offset + _HEAD.size + len(body)
    if last is not None:
        _index_last(found, last, stream.name)
    return found


def _records(stream: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
    """Offset, kind and content of each whole record; ends where the file breaks off."""
    size = stream.seek(0, 2)
    offset = len(MCAP0_MAGIC)
    while offset + _HEAD.size <= size:
        stream.seek(offset)
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        if offset + _HEAD.size + length > size:
            return
        yield offset, opcode, stream.read(length)
        offset += _HEAD.size + length


def _note_chunk(found: Survey, offset: int, length: int, chunk: Chunk, name: str) -> bool:
    """Add a chunk; False if it is spoilt, as after a loss of power."""
    try:
        content = _unpack(chunk, name)
    except GearboxError:
        return False
    for record in content:
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
        else:
            found.counts[record.channel_id] = found.counts.get(record.channel_id, 0) + 1
    found.chunks.append(
        ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    return True


def _note_index(found: Survey, offset: int, length: int, index: MessageIndex) -> None:
    chunk = found.chunks[-1]
    chunk.message_index_offsets[index.channel_id] = offset
    chunk.message_index_length += length


def _index_last(found: Survey, chunk: Chunk, name: str) -> None:
    """Replace the index of the last chunk, which may be cut, by a new one from the chunk's content."""
    indexes: dict[int, MessageIndex] = {}
    offset = 0
    for record in _unpack(chunk, name):
        if isinstance(record, Message):
            index = indexes.setdefault(record.channel_id, MessageIndex(record.channel_id, []))
            index.records.append((record.log_time, offset))
        offset += _length(record)
    found.unindexed = list(indexes.values())
    last = found.chunks[-1]
    last.message_index_length = 0
    for index in found.unindexed:
        last.message_index_offsets[index.channel_id] = found.end + last.message_index_length
        last.message_index_length += _length(index)


def _ending(found: Survey) -> bytes:
    """Everything after the last whole record of data."""
    summary_start = found.end + sum(map(_length, found.unindexed)) + _length(DataEnd(0))
    summary: tuple[_Written, ...] = (
        *found.schemas.values(),
        *found.channels.values(),
        _statistics(found),
        *found.chunks,
        *found.attachments,
        *found.metadata,
        Footer(summary_offset_start=0, summary_start=summary_start, summary_crc=0),
    )
    return _bytes((*found.unindexed, DataEnd(0), *summary)) + MCAP0_MAGIC


def _statistics(found: Survey) -> Statistics:
    return Statistics(
        attachment_count=len(found.attachments),
        channel_count=len(found.channels),
        channel_message_counts=found.counts,
        chunk_count=len(found.chunks),
        message_count=sum(found.counts.values()),
        message_end_time=found.end_ns,
        message_start_time=found.start_ns,
        metadata_count=len(found.metadata),
        schema_count=len(found.schemas),
    )


def _attachment_index(offset: int, length: int, attachment: Attachment) -> AttachmentIndex:
    return AttachmentIndex(
        offset=offset,
        length=length,
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _unpack(chunk: Chunk, name: str) -> list[Schema | Channel | Message]:
    try:
        records = breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # the decompressors have errors of their own, each another
        raise GearboxError(f"{name}: a chunk is spoilt: {error}") from error
    return [record for record in records if isinstance(record, Schema | Channel | Message)]


def _parse(body: bytes, read: Callable[[ReadDataStream], T]) -> T:
    return read(ReadDataStream(BytesIO(body)))


def _length(record: _Written) -> int:
    return len(_bytes((record,)))


def _bytes(records: Iterable[_Written]) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
