"""What one MCAP file holds, broken off or not: its own index, or one made by reading it through.

Nothing that stands in a file is trusted: lengths, offsets and content may be anything.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, BinaryIO, Final, NamedTuple, Protocol, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError

# Three times the largest message there can be; what claims more is spoilt and must not fill the memory.
RECORD_LIMIT: Final = 1 << 30

_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FOOTER: Final = struct.Struct("<BQQQ")
_CHECKSUM: Final = struct.Struct("<I")
_ENDING_BYTES: Final = _FOOTER.size + _CHECKSUM.size + len(MCAP0_MAGIC)
_PRIVATE: Final = 0x80  # kinds of records from here on are anybody's
_KINDS: Final = frozenset(Opcode)
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
        """Messages on each topic, which may have several channels."""
        counts: dict[str, int] = {}
        for number, channel in self.channels.items():
            counts[channel.topic] = counts.get(channel.topic, 0) + self.counts.get(number, 0)
        return counts


class Content(NamedTuple):
    """A chunk and what stands in it."""

    chunk: Chunk  # as stored
    data: bytes  # the records in it, uncompressed
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    positions: dict[int, list[int]]  # channel -> time, offset in data, time, offset ... of its messages

    def messages(self, channels: Collection[int]) -> Iterator[tuple[int, int, memoryview]]:
        """Channel, time in ns and content of each message of ``channels``, in their order."""
        found = [
            (offset, time_ns, channel)
            for channel in channels
            for time_ns, offset in _pairs(self.positions.get(channel, []))
        ]
        view = memoryview(self.data)
        for offset, time_ns, channel in sorted(found):
            begin = offset + _HEAD.size
            _, length = _HEAD.unpack_from(self.data, offset)
            yield channel, time_ns, view[begin + _MESSAGE.size : begin + length]


class Piece(NamedTuple):
    """A record that stands whole in a file."""

    offset: int
    length: int  # with its head
    opcode: int
    # None of a spoilt or another record
    content: Content | Header | Attachment | Metadata | Schema | Channel | None
    fault: str  # what is spoilt in it; empty if nothing


def survey(stream: BinaryIO) -> Survey:
    """Survey of an MCAP file open for reading; of a broken one, up to its first spoilt chunk.

    Raises GearboxError if it is no MCAP file at all or can't be read.
    """
    if first_bytes(stream) != MCAP0_MAGIC:
        raise GearboxError(f"{stream.name}: not an MCAP file: its first bytes are not those of one")
    return read_summary(stream) or _from_records(stream)


def first_bytes(stream: BinaryIO) -> bytes:
    """What stands where an MCAP file has MCAP0_MAGIC, or the piece that there is."""
    return _read(stream, 0, min(len(MCAP0_MAGIC), _size(stream)))


def read_summary(stream: BinaryIO) -> Survey | None:
    """Survey by the file's own summary; None if it has none, or a spoilt one."""
    footer_at = _size(stream) - _ENDING_BYTES
    if footer_at < len(MCAP0_MAGIC):
        return None
    ending_bytes = _read(stream, footer_at, _ENDING_BYTES)
    opcode, length, start, _ = _FOOTER.unpack_from(ending_bytes)
    (checksum,) = _CHECKSUM.unpack_from(ending_bytes, _FOOTER.size)
    if not ending_bytes.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if not len(MCAP0_MAGIC) <= start < footer_at <= start + RECORD_LIMIT:
        return None
    summary = _read(stream, start, footer_at - start)
    if checksum and checksum != zlib.crc32(ending_bytes[: _FOOTER.size], zlib.crc32(summary)):
        return None
    try:
        found = _whole(summary)
    except Exception:  # the file has its records besides, and mcap raises whatever comes its way
        return None
    return found if found is not None and _inside(found, start) else None


def walk(stream: BinaryIO, size: int | None = None) -> Iterator[Piece]:
    """Every whole record of the first ``size`` bytes, spoilt ones too, one in memory at a time.

    Ends where no record follows: at the end, in the middle of one, or where none can begin. Raises
    GearboxError if the file can't be read.
    """
    limit = _size(stream) if size is None else size
    offset = len(MCAP0_MAGIC)
    while (head := _head(stream, offset, limit)) is not None:
        yield _piece(stream, offset, *head)
        offset += _HEAD.size + head[1]


def read_chunk(stream: BinaryIO, index: ChunkIndex) -> Content:
    """A chunk and what stands in it. Raises GearboxError if it is spoilt."""
    return _record(stream, index.chunk_start_offset, Content)


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Content of an attachment. Raises GearboxError if it is spoilt."""
    return bytes(_record(stream, index.offset, Attachment).data)


def read_metadata(stream: BinaryIO, found: Survey) -> dict[str, dict[str, str]]:
    """Metadata records by name. Raises GearboxError if one is spoilt."""
    records = (_record(stream, index.offset, Metadata) for index in found.metadata)
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
    return b"".join((encode((DataEnd(0),)), summary, footer, _CHECKSUM.pack(checksum), MCAP0_MAGIC))


def encode(records: Iterable[_Written]) -> bytes:
    """MCAP records as bytes."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _whole(summary: bytes) -> Survey | None:
    """Survey that the records of a summary make; None if they lack the statistics."""
    found = Survey(complete=True)
    statistics = None
    for opcode, _, body in _split(summary):
        if opcode == Opcode.SCHEMA:
            schema = _parse(body, Schema.read)
            found.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = _parse(body, Channel.read)
            found.channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            found.chunks.append(_parse(body, ChunkIndex.read))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            found.attachments.append(_parse(body, AttachmentIndex.read))
        elif opcode == Opcode.METADATA_INDEX:
            found.metadata.append(_parse(body, MetadataIndex.read))
        elif opcode == Opcode.STATISTICS:
            statistics = _parse(body, Statistics.read)
    if statistics is None:
        return None
    found.chunks.sort(key=lambda index: index.chunk_start_offset)
    found.counts = dict(statistics.channel_message_counts)
    return found


def _inside(found: Survey, end: int) -> bool:
    """Whether everything that a summary tells of stands before byte ``end``."""
    spans = [
        *((index.chunk_start_offset, index.chunk_length) for index in found.chunks),
        *((index.offset, index.length) for index in found.attachments),
        *((index.offset, index.length) for index in found.metadata),
    ]
    return all(offset >= len(MCAP0_MAGIC) and offset + length <= end for offset, length in spans)


def _from_records(stream: BinaryIO) -> Survey:
    found = Survey(complete=False, end=len(MCAP0_MAGIC))
    for piece in walk(stream):
        if piece.opcode == Opcode.DATA_END or (piece.opcode == Opcode.CHUNK and piece.fault):
            break
        _note(found, piece)
        found.end = piece.offset + piece.length
    return found


def _note(found: Survey, piece: Piece) -> None:
    content = piece.content
    if isinstance(content, Content):
        _note_chunk(found, piece, content)
    elif isinstance(content, Attachment):
        found.attachments.append(_attachment_index(piece, content))
    elif isinstance(content, Metadata):
        index = MetadataIndex(offset=piece.offset, length=piece.length, name=content.name)
        found.metadata.append(index)
    elif isinstance(content, Schema):
        found.schemas[content.id] = content
    elif isinstance(content, Channel):
        found.channels[content.id] = content


def _note_chunk(found: Survey, piece: Piece, content: Content) -> None:
    found.schemas.update(content.schemas)
    found.channels.update(content.channels)
    for number, flat in content.positions.items():
        found.counts[number] = found.counts.get(number, 0) + len(flat) // 2
    chunk = content.chunk
    found.chunks.append(
        ChunkIndex(
            chunk_length=piece.length,
            chunk_start_offset=piece.offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets=dict.fromkeys(content.positions, 0),
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )


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


def _attachment_index(piece: Piece, attachment: Attachment) -> AttachmentIndex:
    return AttachmentIndex(
        offset=piece.offset,
        length=piece.length,
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _size(stream: BinaryIO) -> int:
    try:
        return stream.seek(0, 2)
    except OSError as error:
        raise GearboxError(f"can't read '{stream.name}': {error.strerror}") from error


def _read(stream: BinaryIO, offset: int, length: int) -> bytes:
    """The ``length`` bytes from ``offset`` on, which must stand in the file."""
    try:
        stream.seek(offset)
        data = stream.read(length)
    except OSError as error:
        raise GearboxError(f"can't read '{stream.name}': {error.strerror}") from error
    if len(data) != length:
        raise GearboxError(f"'{stream.name}' became shorter while it was read: try again when it rests")
    return data


def _head(stream: BinaryIO, offset: int, limit: int) -> tuple[int, int] | None:
    """Kind and length of the record at ``offset``; None if none can begin there or end before ``limit``."""
    if offset + _HEAD.size > limit:
        return None
    opcode, length = _HEAD.unpack(_read(stream, offset, _HEAD.size))
    possible = opcode in _KINDS or opcode >= _PRIVATE
    return (opcode, length) if possible and offset + _HEAD.size + length <= limit else None


def _piece(stream: BinaryIO, offset: int, opcode: int, length: int) -> Piece:
    size = _HEAD.size + length
    if opcode not in _DECODERS:
        return Piece(offset, size, opcode, None, "")
    if length > RECORD_LIMIT:
        return Piece(offset, size, opcode, None, f"it claims {length} bytes; the limit is {RECORD_LIMIT}")
    body = _read(stream, offset + _HEAD.size, length)
    try:
        return Piece(offset, size, opcode, _DECODERS[opcode](body), "")
    except Exception as error:  # mcap and the decompressors have errors of their own, each another
        return Piece(offset, size, opcode, None, " ".join(f"{error!r:.200}".split()))


def _record(stream: BinaryIO, offset: int, kind: type[T]) -> T:
    """Content of the record that an index says is at ``offset``."""
    head = _head(stream, offset, _size(stream))
    piece = None if head is None else _piece(stream, offset, *head)
    if piece is not None and isinstance(piece.content, kind):
        return piece.content
    fault = piece.fault if piece is not None and piece.fault else f"no {kind.__name__} stands there"
    raise GearboxError(
        f"{stream.name}: the record at byte {offset} is spoilt: {fault}: replay recover keeps what is whole"
    )


def _unpack(body: bytes) -> Content:
    chunk = _parse(body, Chunk.read)
    content = Content(chunk, _decompress(chunk), {}, {}, {})
    for opcode, offset, record in _split(content.data):
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(record)
            content.positions.setdefault(channel, []).extend((time_ns, offset))
        elif opcode == Opcode.SCHEMA:
            schema = _parse(record, Schema.read)
            content.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            known = _parse(record, Channel.read)
            content.channels[known.id] = known
    return content


def _decompress(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        raise ValueError(f"its content claims {size} bytes; the limit is {RECORD_LIMIT}")
    if chunk.compression == "zstd":
        # Memory is taken for what the data themselves claim, whatever limit zstandard is given.
        if zstandard.frame_content_size(chunk.data) not in (-1, size):
            raise ValueError(f"its content is not of {size} bytes")
        data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
    elif chunk.compression in ("", "lz4"):
        stream, length = get_chunk_data_stream(chunk)
        data = stream.read(length)
    else:
        raise ValueError(f"compression {chunk.compression!r:.40} is unknown")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum does not fit its content")
    return bytes(data)


def _split(data: bytes) -> Iterator[tuple[int, int, memoryview]]:
    """Kind, offset and content of each record. Raises ValueError where one goes beyond the end."""
    view = memoryview(data)
    offset = 0
    while offset < len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        begin = offset + _HEAD.size
        if begin + length > len(data):
            raise ValueError(f"a record of {length} bytes inside goes beyond its end")
        yield opcode, offset, view[begin : begin + length]
        offset = begin + length


def _pairs(flat: list[int]) -> Iterator[tuple[int, int]]:
    return zip(flat[::2], flat[1::2], strict=True)


def _exact(read: Callable[[ReadDataStream], Any]) -> Callable[[bytes], Any]:
    """Reader of records that raises unless the record, written again, is the same to the last byte."""

    def decode(body: bytes) -> Any:
        record = _parse(body, read)
        if encode((record,))[_HEAD.size :] != body:
            raise ValueError("its checksum or its lengths do not fit its content")
        return record

    return decode


def _parse(body: bytes | memoryview, read: Callable[[ReadDataStream], T]) -> T:
    return read(ReadDataStream(BytesIO(body)))


# The checksum of an attachment is among what _exact compares; mcap itself leaves it unread.
_DECODERS: Final[Mapping[int, Callable[[bytes], Any]]] = {
    Opcode.HEADER: _exact(Header.read),
    Opcode.CHUNK: _unpack,
    Opcode.ATTACHMENT: _exact(Attachment.read),
    Opcode.METADATA: _exact(Metadata.read),
    Opcode.SCHEMA: _exact(Schema.read),
    Opcode.CHANNEL: _exact(Channel.read),
}
