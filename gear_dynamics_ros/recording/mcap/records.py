"""The records of an MCAP file, broken off or not, decoded one by one.

Nothing that stands in a file is trusted: lengths, offsets and content may be anything.
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

from gear_dynamics_ros.errors import GearboxError

# Three times the largest message there can be; what claims more is spoilt and must not fill the memory.
RECORD_LIMIT: Final = 1 << 30

_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_PRIVATE: Final = 0x80  # kinds of records from here on are anybody's
_KINDS: Final = frozenset(Opcode)
T = TypeVar("T")


class _Written(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


class ChunkContent(NamedTuple):
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


class FoundRecord(NamedTuple):
    """A record that stands whole in a file."""

    offset: int
    length: int  # with its head
    opcode: int
    # None of a spoilt or another record
    content: ChunkContent | Header | Attachment | Metadata | Schema | Channel | None
    fault: str  # what is spoilt in it; empty if nothing


def first_bytes(stream: BinaryIO) -> bytes:
    """What stands where an MCAP file has MCAP0_MAGIC, or as much of it as there is."""
    return read_bytes(stream, 0, min(len(MCAP0_MAGIC), file_size(stream)))


def walk(stream: BinaryIO, size: int | None = None) -> Iterator[FoundRecord]:
    """Every whole record of the first ``size`` bytes, spoilt ones too, one in memory at a time.

    Ends where no record follows: at the end, in the middle of one, or where none can begin. Raises
    GearboxError if the file can't be read.
    """
    limit = file_size(stream) if size is None else size
    offset = len(MCAP0_MAGIC)
    while (head := _head(stream, offset, limit)) is not None:
        yield _found(stream, offset, *head)
        offset += _HEAD.size + head[1]


def read_chunk(stream: BinaryIO, index: ChunkIndex) -> ChunkContent:
    """A chunk and what stands in it. Raises GearboxError if it is spoilt."""
    return record_at(stream, index.chunk_start_offset, ChunkContent)


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Content of an attachment. Raises GearboxError if it is spoilt."""
    return bytes(record_at(stream, index.offset, Attachment).data)


def encode(records: Iterable[_Written]) -> bytes:
    """MCAP records as bytes."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def file_size(stream: BinaryIO) -> int:
    try:
        return stream.seek(0, 2)
    except OSError as error:
        raise GearboxError(f"can't read '{stream.name}': {error.strerror}") from error


def read_bytes(stream: BinaryIO, offset: int, length: int) -> bytes:
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
    opcode, length = _HEAD.unpack(read_bytes(stream, offset, _HEAD.size))
    possible = opcode in _KINDS or opcode >= _PRIVATE
    return (opcode, length) if possible and offset + _HEAD.size + length <= limit else None


def _found(stream: BinaryIO, offset: int, opcode: int, length: int) -> FoundRecord:
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
    except Exception as error:  # mcap and the decompressors have errors of their own, each another
        return FoundRecord(offset, size, opcode, None, " ".join(f"{error!r:.200}".split()))


def record_at(stream: BinaryIO, offset: int, kind: type[T]) -> T:
    """Content of the record that an index says is at ``offset``."""
    head = _head(stream, offset, file_size(stream))
    record = None if head is None else _found(stream, offset, *head)
    if record is not None and isinstance(record.content, kind):
        return record.content
    fault = record.fault if record is not None and record.fault else f"no {kind.__name__} stands there"
    raise GearboxError(
        f"{stream.name}: the record at byte {offset} is spoilt: {fault}: replay recover keeps what is whole"
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


def split_records(data: bytes) -> Iterator[tuple[int, int, memoryview]]:
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
        record = parse_record(body, read)
        if encode((record,))[_HEAD.size :] != body:
            raise ValueError("its checksum or its lengths do not fit its content")
        return record

    return decode


def parse_record(body: bytes | memoryview, read: Callable[[ReadDataStream], T]) -> T:
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
