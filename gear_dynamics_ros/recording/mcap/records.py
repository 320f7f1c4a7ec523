"""Decodes the records of an MCAP file, complete or broken off, one by one.

No content of a file is trusted: lengths, offsets and bytes may be anything.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
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
    Header,
    Metadata,
    Schema,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError, one_line

# Three times the largest possible message. A record that claims more is damaged and must not fill the memory.
RECORD_LIMIT: Final = 1 << 30

_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_PRIVATE: Final = 0x80  # opcodes from here on are private to other programs
_KINDS: Final = frozenset(Opcode)
T = TypeVar("T")


class _Writable(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


class ChunkContent(NamedTuple):
    """A chunk and its content."""

    chunk: Chunk  # as stored
    data: bytes  # its records, uncompressed
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    positions: dict[int, list[int]]  # channel -> time, offset in data, time, offset ... of its messages

    def messages(self, channels: Collection[int]) -> Iterator[tuple[int, int, memoryview]]:
        """Channel, stamp in ns and CDR of each message of ``channels``, in the order of the chunk."""
        places = [
            (offset, time_ns, channel)
            for channel in channels
            for time_ns, offset in _pairs(self.positions.get(channel, []))
        ]
        view = memoryview(self.data)
        for offset, time_ns, channel in sorted(places):
            begin = offset + _HEAD.size
            _, length = _HEAD.unpack_from(self.data, offset)
            yield channel, time_ns, view[begin + _MESSAGE.size : begin + length]


class FoundRecord(NamedTuple):
    """A record that lies completely in a file."""

    offset: int
    length: int  # with its opcode and length field, bytes
    opcode: int
    # None if the record is damaged or of another kind
    content: ChunkContent | Header | Attachment | Metadata | Schema | Channel | None
    fault: str  # why it is damaged; empty if it is not


def first_bytes(stream: BinaryIO) -> bytes:
    """The first bytes of a file, as many as MCAP0_MAGIC has; fewer if the file is shorter."""
    return read_bytes(stream, 0, min(len(MCAP0_MAGIC), file_size(stream)))


def walk(stream: BinaryIO, size: int | None = None) -> Iterator[FoundRecord]:
    """Every whole record of the first ``size`` bytes, damaged ones too, one in memory at a time.

    Stops at the end, at an incomplete record, or at bytes that can't be a record. Raises GearboxError if the
    file can't be read.
    """
    limit = file_size(stream) if size is None else size
    offset = len(MCAP0_MAGIC)
    while (head := _head(stream, offset, limit)) is not None:
        yield _decode(stream, offset, *head)
        offset += _HEAD.size + head[1]


def read_chunk(stream: BinaryIO, index: ChunkIndex) -> ChunkContent:
    """The chunk at the position of ``index``. Raises GearboxError if it is damaged."""
    return record_at(stream, index.chunk_start_offset, ChunkContent)


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Content of the attachment at the position of ``index``. Raises GearboxError if it is damaged."""
    return bytes(record_at(stream, index.offset, Attachment).data)


def encode(records: Iterable[_Writable]) -> bytes:
    """MCAP records as bytes."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def file_size(stream: BinaryIO) -> int:
    """Size of an open file, bytes. Raises GearboxError if it can't be read."""
    try:
        return stream.seek(0, 2)
    except OSError as error:
        raise GearboxError(f"can't read '{stream.name}': {error.strerror}") from error


def read_bytes(stream: BinaryIO, offset: int, length: int) -> bytes:
    """The ``length`` bytes from ``offset`` on. Raises GearboxError if they can't be read."""
    try:
        stream.seek(offset)
        data = stream.read(length)
    except OSError as error:
        raise GearboxError(f"can't read '{stream.name}': {error.strerror}") from error
    if len(data) != length:
        raise GearboxError(
            f"'{stream.name}' became shorter while it was read: try again when no program writes to it"
        )
    return data


def _head(stream: BinaryIO, offset: int, limit: int) -> tuple[int, int] | None:
    """Opcode and length of the record at ``offset``; None if none can be there before ``limit``."""
    if offset + _HEAD.size > limit:
        return None
    opcode, length = _HEAD.unpack(read_bytes(stream, offset, _HEAD.size))
    possible = opcode in _KINDS or opcode >= _PRIVATE
    return (opcode, length) if possible and offset + _HEAD.size + length <= limit else None


def _decode(stream: BinaryIO, offset: int, opcode: int, length: int) -> FoundRecord:
    size = _HEAD.size + length
    if opcode not in _DECODERS:
        return FoundRecord(offset, size, opcode, None, "")
    if length > RECORD_LIMIT:
        return FoundRecord(
            offset, size, opcode, None, f"it claims {length} bytes; the limit is {RECORD_LIMIT}"
        )
    body = read_bytes(stream, offset + _HEAD.size, length)
    try:
        return FoundRecord(offset, size, opcode, _DECODERS[opcode](body), "")
    except Exception as error:  # mcap and the decompressors raise many kinds of errors
        return FoundRecord(offset, size, opcode, None, one_line(f"{error!r:.200}"))


def record_at(stream: BinaryIO, offset: int, kind: type[T]) -> T:
    """Content of the record at ``offset``, which must be of the type ``kind``.

    Raises GearboxError if it is damaged or of another kind.
    """
    head = _head(stream, offset, file_size(stream))
    record = None if head is None else _decode(stream, offset, *head)
    if record is not None and isinstance(record.content, kind):
        return record.content
    fault = record.fault if record is not None and record.fault else f"it is not of the type {kind.__name__}"
    raise GearboxError(
        f"{stream.name}: the record at byte {offset} is damaged: {fault}: replay recover keeps what is whole"
    )


def _unpack(body: bytes) -> ChunkContent:
    chunk = parse_record(body, Chunk.read)
    content = ChunkContent(chunk, _decompress(chunk), {}, {}, {})
    for opcode, offset, record in split_records(content.data):
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(record)
            content.positions.setdefault(channel, []).extend((time_ns, offset))
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(record, Schema.read)
            content.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            known = parse_record(record, Channel.read)
            content.channels[known.id] = known
    return content


def _decompress(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        raise ValueError(f"its content claims {size} bytes; the limit is {RECORD_LIMIT}")
    if chunk.compression == "zstd":
        # zstandard allocates the size that the data claim, whatever limit it is given.
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


def split_records(data: bytes) -> Iterator[tuple[int, int, memoryview]]:
    """Opcode, offset and content of each record in ``data``. Raises ValueError if one is incomplete."""
    view = memoryview(data)
    offset = 0
    while offset < len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        begin = offset + _HEAD.size
        if begin + length > len(data):
            raise ValueError(f"a record of {length} bytes in it is longer than the rest")
        yield opcode, offset, view[begin : begin + length]
        offset = begin + length


def _pairs(flat: list[int]) -> Iterator[tuple[int, int]]:
    return zip(flat[::2], flat[1::2], strict=True)


def _exact(read: Callable[[ReadDataStream], Any]) -> Callable[[bytes], Any]:
    """Decoder that raises ValueError unless the decoded record, encoded again, gives the same bytes."""

    def decode(body: bytes) -> Any:
        record = parse_record(body, read)
        if encode((record,))[_HEAD.size :] != body:
            raise ValueError("its checksum or its lengths do not fit its content")
        return record

    return decode


def parse_record(body: bytes | memoryview, read: Callable[[ReadDataStream], T]) -> T:
    """Decode the content of a record with ``read`` of its mcap class."""
    return read(ReadDataStream(BytesIO(body)))


# mcap itself does not check the checksum of an attachment; _exact does.
_DECODERS: Final[Mapping[int, Callable[[bytes], Any]]] = {
    Opcode.HEADER: _exact(Header.read),
    Opcode.CHUNK: _unpack,
    Opcode.ATTACHMENT: _exact(Attachment.read),
    Opcode.METADATA: _exact(Metadata.read),
    Opcode.SCHEMA: _exact(Schema.read),
    Opcode.CHANNEL: _exact(Channel.read),
}
