"""Index of an MCAP file: from its own summary, or made by reading through a broken file."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
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
    """Positions of all records of an MCAP file."""

    complete: bool  # whether the file ends with its own summary
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)  # of a broken file, with message offsets 0
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # channel -> messages
    end: int = 0  # offset of the byte after the last whole record of data
    behind: int = 0  # bytes behind the end of the file according to its footer

    @property
    def start_ns(self) -> int:
        """Stamp of the first message, ns; 0 if there is none."""
        return min((chunk.message_start_time for chunk in self.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Stamp of the last message, ns; 0 if there is none."""
        return max((chunk.message_end_time for chunk in self.chunks), default=0)

    def topic_counts(self) -> dict[str, int]:
        """Number of messages by topic; a topic may have several channels."""
        counts: dict[str, int] = {}
        for number, channel in self.channels.items():
            counts[channel.topic] = counts.get(channel.topic, 0) + self.counts.get(number, 0)
        return counts


def read_index(stream: BinaryIO) -> FileIndex:
    """Index of an MCAP file open for reading; of a broken file, up to its first damaged chunk.

    Raises GearboxError if it is not an MCAP file or can't be read.
    """
    if first_bytes(stream) != MCAP0_MAGIC:
        raise GearboxError(f"{stream.name}: not an MCAP file: its first bytes are not those of one")
    return read_summary(stream) or _from_records(stream)


def read_summary(stream: BinaryIO) -> FileIndex | None:
    """Index from the summary of the file; None if it is missing or damaged."""
    footer_offset = file_size(stream) - _ENDING_BYTES
    if footer_offset < len(MCAP0_MAGIC):
        return None
    ending_bytes = read_bytes(stream, footer_offset, _ENDING_BYTES)
    opcode, length, start, _ = _FOOTER.unpack_from(ending_bytes)
    (checksum,) = _CHECKSUM.unpack_from(ending_bytes, _FOOTER.size)
    if not ending_bytes.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if not len(MCAP0_MAGIC) <= start < footer_offset <= start + RECORD_LIMIT:
        return None
    summary = read_bytes(stream, start, footer_offset - start)
    if checksum and checksum != zlib.crc32(ending_bytes[: _FOOTER.size], zlib.crc32(summary)):
        return None
    try:
        index = _from_summary(summary)
    except Exception:  # mcap raises many kinds of errors; the index can be made from the records
        return None
    return index if index is not None and _all_before(index, start) else None


def read_metadata(stream: BinaryIO, index: FileIndex) -> dict[str, dict[str, str]]:
    """Metadata records by name. Raises GearboxError if one is damaged."""
    records = (record_at(stream, entry.offset, Metadata) for entry in index.metadata)
    return {record.name: record.metadata for record in records}


def ending(index: FileIndex) -> bytes:
    """The bytes after the last record of data: end of the data, summary, footer."""
    summary_start = index.end + len(encode((DataEnd(0),)))
    summary = encode(
        (
            *index.schemas.values(),
            *index.channels.values(),
            _statistics(index),
            *index.chunks,
            *index.attachments,
            *index.metadata,
        )
    )
    # The checksum covers the summary and the footer up to the checksum itself.
    footer = _FOOTER.pack(Opcode.FOOTER, 20, summary_start, 0)
    checksum = zlib.crc32(footer, zlib.crc32(summary))
    return b"".join((encode((DataEnd(0),)), summary, footer, _CHECKSUM.pack(checksum), MCAP0_MAGIC))


def _from_summary(summary: bytes) -> FileIndex | None:
    """Index from the records of a summary; None if they lack the statistics."""
    index = FileIndex(complete=True)
    statistics = None
    for opcode, _, body in split_records(summary):
        if opcode == Opcode.SCHEMA:
            schema = parse_record(body, Schema.read)
            index.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(body, Channel.read)
            index.channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            index.chunks.append(parse_record(body, ChunkIndex.read))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            index.attachments.append(parse_record(body, AttachmentIndex.read))
        elif opcode == Opcode.METADATA_INDEX:
            index.metadata.append(parse_record(body, MetadataIndex.read))
        elif opcode == Opcode.STATISTICS:
            statistics = parse_record(body, Statistics.read)
    if statistics is None:
        return None
    index.chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    index.counts = dict(statistics.channel_message_counts)
    return index


def _all_before(index: FileIndex, end: int) -> bool:
    """Whether all positions of ``index`` lie between the magic bytes and byte ``end``."""
    spans = [
        *((chunk.chunk_start_offset, chunk.chunk_length) for chunk in index.chunks),
        *((attachment.offset, attachment.length) for attachment in index.attachments),
        *((metadata.offset, metadata.length) for metadata in index.metadata),
    ]
    return all(offset >= len(MCAP0_MAGIC) and offset + length <= end for offset, length in spans)


def _from_records(stream: BinaryIO) -> FileIndex:
    index = FileIndex(complete=False, end=len(MCAP0_MAGIC))
    records = walk(stream)
    for record in records:
        if record.opcode == Opcode.DATA_END:
            index.behind = bytes_behind(stream, records)
            break
        if record.opcode == Opcode.CHUNK and record.fault:
            break
        _add(index, record)
        index.end = record.offset + record.length
    return index


def bytes_behind(stream: BinaryIO, records: Iterator[FoundRecord]) -> int:
    """Bytes of the file behind its end, if ``records``, those after its data, have a footer; else 0."""
    footer = next((record for record in records if record.opcode == Opcode.FOOTER), None)
    if footer is None:
        return 0
    return max(file_size(stream) - (footer.offset + footer.length + len(MCAP0_MAGIC)), 0)


def _add(index: FileIndex, record: FoundRecord) -> None:
    content = record.content
    if isinstance(content, ChunkContent):
        _add_chunk(index, record, content)
    elif isinstance(content, Attachment):
        index.attachments.append(_attachment_index(record, content))
    elif isinstance(content, Metadata):
        entry = MetadataIndex(offset=record.offset, length=record.length, name=content.name)
        index.metadata.append(entry)
    elif isinstance(content, Schema):
        index.schemas[content.id] = content
    elif isinstance(content, Channel):
        index.channels[content.id] = content


def _add_chunk(index: FileIndex, record: FoundRecord, content: ChunkContent) -> None:
    index.schemas.update(content.schemas)
    index.channels.update(content.channels)
    for number, flat in content.positions.items():
        index.counts[number] = index.counts.get(number, 0) + len(flat) // 2
    chunk = content.chunk
    index.chunks.append(
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


def _statistics(index: FileIndex) -> Statistics:
    return Statistics(
        attachment_count=len(index.attachments),
        channel_count=len(index.channels),
        channel_message_counts=index.counts,
        chunk_count=len(index.chunks),
        message_count=sum(index.counts.values()),
        message_end_time=index.end_ns,
        message_start_time=index.start_ns,
        metadata_count=len(index.metadata),
        schema_count=len(index.schemas),
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
