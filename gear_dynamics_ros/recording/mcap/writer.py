"""Writes one MCAP file in compressed chunks.

The mcap package's own writer takes twice the processor time for the same file (its compression level is
fixed), and after a failed write it can't complete the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.recording.mcap.index import FileIndex, ending
from gear_dynamics_ros.recording.mcap.records import encode

CHUNK_BYTES: Final = 1 << 20
# Level 1 takes four times as long and saves 4 %: samples of doubles hardly compress.
_LEVEL: Final = -7
_COMPRESSION: Final = "zstd"
_MESSAGE: Final = struct.Struct("<BQHIQQ")
_CHUNK: Final = struct.Struct("<BQQQQII")
_SIZE: Final = struct.Struct("<Q")
_INDEX: Final = struct.Struct("<BQHI")
_HEAD_BYTES: Final = 9  # opcode and length; the length does not count them


class McapWriter:
    """Writes a new MCAP file. ``index`` has the positions of its records.

    Raises FileExistsError if ``path`` exists, and OSError if a write fails: call ``abandon_chunk`` then, and
    ``finish``. If the header can't be written, no file is left behind.
    """

    def __init__(self, path: Path, library: str) -> None:
        self._path = path
        self._file = path.open("xb", buffering=0)
        self._identity = _identity(os.fstat(self._file.fileno()))
        self.index = FileIndex(complete=False)
        self._pending = bytearray()
        # Channel -> time, offset, time, offset ... in the open chunk.
        self._positions: dict[int, list[int]] = {}
        self._earliest = self._latest = 0
        self._synced = 0
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        try:
            self._append(MCAP0_MAGIC + encode((Header(profile="ros2", library=library),)))
        except OSError:
            self._file.close()
            path.unlink()
            raise

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        record = encode(
            (Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data),)
        )
        offset = self._append(record)
        self.index.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=len(record),
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = encode((Metadata(metadata=dict(values), name=name),))
        offset = self._append(record)
        self.index.metadata.append(MetadataIndex(length=len(record), name=name, offset=offset))

    def add_definitions(self, schemas: Mapping[int, Schema], channels: Mapping[int, Channel]) -> None:
        """Write schemas and channels, by their numbers, before the first chunk."""
        self._append(encode((*schemas.values(), *channels.values())))
        self.index.schemas.update(schemas)
        self.index.channels.update(channels)

    def add_message(self, channel: int, sequence: int, time_ns: int, data: bytes) -> None:
        """Add a message to the open chunk; ``data`` is CDR."""
        if not self._positions:
            self._earliest = self._latest = time_ns
        self._earliest = min(self._earliest, time_ns)
        self._latest = max(self._latest, time_ns)
        self._positions.setdefault(channel, []).extend((time_ns, len(self._pending)))
        length = _MESSAGE.size - _HEAD_BYTES + len(data)
        self._pending += _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time_ns, time_ns)
        self._pending += data
        if len(self._pending) >= CHUNK_BYTES:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Write the open chunk, if it holds messages."""
        if not self._positions:
            return
        chunk = Chunk(
            compression=_COMPRESSION,
            data=self._compressor.compress(self._pending),
            message_end_time=self._latest,
            message_start_time=self._earliest,
            uncompressed_crc=zlib.crc32(self._pending),
            uncompressed_size=len(self._pending),
        )
        self.add_chunk(chunk, self._positions)
        self._pending.clear()
        self._positions.clear()

    def add_chunk(self, chunk: Chunk, positions: Mapping[int, list[int]]) -> None:
        """Write a compressed chunk and its message index.

        ``positions`` has, by channel, stamp and offset of each message: time, offset, time, offset ...
        """
        compression = chunk.compression.encode()
        head = _CHUNK.pack(
            Opcode.CHUNK,
            _CHUNK.size - _HEAD_BYTES + len(compression) + _SIZE.size + len(chunk.data),
            chunk.message_start_time,
            chunk.message_end_time,
            chunk.uncompressed_size,
            chunk.uncompressed_crc,
            len(compression),
        )
        record = (head, compression, _SIZE.pack(len(chunk.data)), chunk.data)
        indexes = {channel: _message_index(channel, flat) for channel, flat in positions.items()}
        offset = self._append(b"".join((*record, *indexes.values())))
        length = sum(map(len, record))
        self.index.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=sum(map(len, indexes.values())),
                message_index_offsets=_offsets(indexes, offset + length),
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for channel, flat in positions.items():
            self.index.counts[channel] = self.index.counts.get(channel, 0) + len(flat) // 2

    @property
    def in_place(self) -> bool:
        """Whether the file is still at its path. A removed file accepts writes, but keeps nothing."""
        try:
            return _identity(os.stat(self._path)) == self._identity
        except OSError:
            return False

    def abandon_chunk(self) -> int:
        """After a failed write: discard the open chunk and cut off the incomplete record.

        Returns the number of discarded messages.
        """
        messages = sum(map(len, self._positions.values())) // 2
        self._pending.clear()
        self._positions.clear()
        self._file.truncate(self.index.end)
        self._file.seek(self.index.end)
        return messages

    def finish(self) -> None:
        """Write the open chunk and the summary, and bring the file to the disk (fsync)."""
        self.end_chunk()
        self._append(ending(self.index))
        self.sync()

    def sync(self) -> None:
        """Bring the file to the disk (fsync), if anything was written since the last call."""
        if self._synced != self.index.end:
            os.fsync(self._file.fileno())
            self._synced = self.index.end

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _append(self, data: bytes) -> int:
        """Write whole records; returns their offset."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        offset = self.index.end
        self.index.end += len(data)
        return offset


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _message_index(channel: int, flat: list[int]) -> bytes:
    size = 8 * len(flat)
    head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _HEAD_BYTES + size, channel, size)
    return head + struct.pack(f"<{len(flat)}Q", *flat)


def _offsets(indexes: Mapping[int, bytes], offset: int) -> dict[int, int]:
    offsets: dict[int, int] = {}
    for channel, index in indexes.items():
        offsets[channel] = offset
        offset += len(index)
    return offsets
