"""Where everything in an MCAP file is: by the file's own summary, or by reading a broken file through."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.recording.mcap.records import (
    RECORD_LIMIT,
    ChunkContent,
    FoundRecord,
    encode,
    file_size,
    first_bytes,
    parse_record,
    read_bytes,
    record_at,
    split_records,
    walk,
)

_FOOTER: Final = struct.Struct("<BQQQ")
_CHECKSUM: Final = struct.Struct("<I")
_ENDING_BYTES: Final = _FOOTER.size + _CHECKSUM.size + len(MCAP0_MAGIC)


@dataclass
class FileIndex:
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
        """Messages on each topic, which may have several channels."""
        counts: dict[str, int] = {}
        for number, channel in self.channels.items():
            counts[channel.topic] = counts.get(channel.topic, 0) + self.counts.get(number, 0)
        return counts


def read_index(stream: BinaryIO) -> FileIndex:
    """Index of an MCAP file open for reading; of a broken one, up to its first spoilt chunk.

    Raises GearboxError if it is no MCAP file at all or can't be read.
    """
    if first_bytes(stream) != MCAP0_MAGIC:
        raise GearboxError(f"{stream.name}: not an MCAP file: its first bytes are not those of one")
    return read_summary(stream) or _from_records(stream)


def read_summary(stream: BinaryIO) -> FileIndex | None:
    """Index by the file's own summary; None if it has none, or a spoilt one."""
    footer_at = file_size(stream) - _ENDING_BYTES
    if footer_at < len(MCAP0_MAGIC):
        return None
    ending_bytes = read_bytes(stream, footer_at, _ENDING_BYTES)
    opcode, length, start, _ = _FOOTER.unpack_from(ending_bytes)
    (checksum,) = _CHECKSUM.unpack_from(ending_bytes, _FOOTER.size)
    if not ending_bytes.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if not len(MCAP0_MAGIC) <= start < footer_at <= start + RECORD_LIMIT:
        return None
    summary = read_bytes(stream, start, footer_at - start)
    if checksum and checksum != zlib.crc32(ending_bytes[: _FOOTER.size], zlib.crc32(summary)):
        return None
    try:
        found = _whole(summary)
    except Exception:  # the file has its records besides, and mcap raises whatever comes its way
        return None
    return found if found is not None and _inside(found, start) else None


def read_metadata(stream: BinaryIO, found: FileIndex) -> dict[str, dict[str, str]]:
    """Metadata records by name. Raises GearboxError if one is spoilt."""
    records = (record_at(stream, index.offset, Metadata) for index in found.metadata)
    return {record.name: record.metadata for record in records}


def ending(found: FileIndex) -> bytes:
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
    return b"".join((encode((DataEnd(0),)), summary, footer, _CHECKSUM.pack(checksum), MCAP0_MAGIC))


def _whole(summary: bytes) -> FileIndex | None:
    """Index that the records of a summary make; None if they lack the statistics."""
    found = FileIndex(complete=True)
    statistics = None
    for opcode, _, body in split_records(summary):
        if opcode == Opcode.SCHEMA:
            schema = parse_record(body, Schema.read)
            found.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(body, Channel.read)
            found.channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            found.chunks.append(parse_record(body, ChunkIndex.read))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            found.attachments.append(parse_record(body, AttachmentIndex.read))
        elif opcode == Opcode.METADATA_INDEX:
            found.metadata.append(parse_record(body, MetadataIndex.read))
        elif opcode == Opcode.STATISTICS:
            statistics = parse_record(body, Statistics.read)
    if statistics is None:
        return None
    found.chunks.sort(key=lambda index: index.chunk_start_offset)
    found.counts = dict(statistics.channel_message_counts)
    return found


def _inside(found: FileIndex, end: int) -> bool:
    """Whether everything that a summary tells of stands before byte ``end``."""
    spans = [
        *((index.chunk_start_offset, index.chunk_length) for index in found.chunks),
        *((index.offset, index.length) for index in found.attachments),
        *((index.offset, index.length) for index in found.metadata),
    ]
    return all(offset >= len(MCAP0_MAGIC) and offset + length <= end for offset, length in spans)


def _from_records(stream: BinaryIO) -> FileIndex:
    found = FileIndex(complete=False, end=len(MCAP0_MAGIC))
    for record in walk(stream):
        if record.opcode == Opcode.DATA_END or (record.opcode == Opcode.CHUNK and record.fault):
            break
        _note(found, record)
        found.end = record.offset + record.length
    return found


def _note(found: FileIndex, record: FoundRecord) -> None:
    content = record.content
    if isinstance(content, ChunkContent):
        _note_chunk(found, record, content)
    elif isinstance(content, Attachment):
        found.attachments.append(_attachment_index(record, content))
    elif isinstance(content, Metadata):
        index = MetadataIndex(offset=record.offset, length=record.length, name=content.name)
        found.metadata.append(index)
    elif isinstance(content, Schema):
        found.schemas[content.id] = content
    elif isinstance(content, Channel):
        found.channels[content.id] = content


def _note_chunk(found: FileIndex, record: FoundRecord, content: ChunkContent) -> None:
    found.schemas.update(content.schemas)
    found.channels.update(content.channels)
    for number, flat in content.positions.items():
        found.counts[number] = found.counts.get(number, 0) + len(flat) // 2
    chunk = content.chunk
    found.chunks.append(
        ChunkIndex(
            chunk_length=record.length,
            chunk_start_offset=record.offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets=dict.fromkeys(content.positions, 0),
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )


def _statistics(found: FileIndex) -> Statistics:
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


def _attachment_index(record: FoundRecord, attachment: Attachment) -> AttachmentIndex:
    return AttachmentIndex(
        offset=record.offset,
        length=record.length,
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
