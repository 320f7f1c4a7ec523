"""What one MCAP file holds, broken off or not: its own index, or one made by reading it through."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
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
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError

_HEAD: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQ")
T = TypeVar("T")


class _Written(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


@dataclass
class Survey:
    """Where everything in an MCAP file is."""

    complete: bool  # the file ends with its own summary
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)  # offsets inside are 0 where a broken file is read
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # channel -> messages
    end: int = 0  # where the last whole record of data ends

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


def read_content(stream: BinaryIO, index: ChunkIndex) -> bytes:
    """The records inside a chunk as bytes. Raises GearboxError if its checksum or content is spoilt."""
    return _decompress(_parse(read_record(stream, index.chunk_start_offset), Chunk.read), stream.name)


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Content of an attachment."""
    return bytes(_parse(read_record(stream, index.offset), Attachment.read).data)


def read_metadata(stream: BinaryIO, found: Survey) -> dict[str, dict[str, str]]:
    """Metadata records by name."""
    records = (_parse(read_record(stream, index.offset), Metadata.read) for index in found.metadata)
    return {record.name: record.metadata for record in records}


def ending(found: Survey) -> bytes:
    """What follows the last record of data: indexes and summary."""
    summary_start = found.end + len(encode((DataEnd(0),)))
    summary = encode(
        (
            *found.schemas.values(),
            *found.channels.values(),
            _statistics(found),
            *found.chunks,
            *found.attachments,
            *found.metadata,
        )
    )
    # The checksum covers the summary and the footer up to the checksum itself.
    footer = _FOOTER.pack(Opcode.FOOTER, 20, summary_start, 0)
    checksum = zlib.crc32(footer, zlib.crc32(summary))
    return b"".join((encode((DataEnd(0),)), summary, footer, struct.pack("<I", checksum), MCAP0_MAGIC))


def encode(records: Iterable[_Written]) -> bytes:
    """MCAP records as bytes."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


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
    for offset, opcode, body in _records(stream):
        length = _HEAD.size + len(body)
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            if not _note_chunk(found, offset, length, _parse(body, Chunk.read), stream.name):
                break
        elif opcode == Opcode.ATTACHMENT:
            found.attachments.append(_attachment_index(offset, length, _parse(body, Attachment.read)))
        elif opcode == Opcode.METADATA:
            name = _parse(body, Metadata.read).name
            found.metadata.append(MetadataIndex(offset=offset, length=length, name=name))
        found.end = offset + length
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
    inside: Counter[int] = Counter()
    for record in content:
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
        else:
            inside[record.channel_id] += 1
    for number, count in inside.items():
        found.counts[number] = found.counts.get(number, 0) + count
    found.chunks.append(
        ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets=dict.fromkeys(inside, 0),
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    return True


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


def _decompress(chunk: Chunk, name: str) -> bytes:
    try:
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    except Exception as error:  # the decompressors have errors of their own, each another
        raise GearboxError(f"{name}: a chunk is spoilt: {error}") from error
    return bytes(stream.read(size))


def _unpack(chunk: Chunk, name: str) -> list[Schema | Channel | Message]:
    try:
        records = breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # the decompressors have errors of their own, each another
        raise GearboxError(f"{name}: a chunk is spoilt: {error}") from error
    return [record for record in records if isinstance(record, Schema | Channel | Message)]


def _parse(body: bytes, read: Callable[[ReadDataStream], T]) -> T:
    return read(ReadDataStream(BytesIO(body)))
