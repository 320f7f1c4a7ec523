"""The parts of a recording, one MCAP file each: start, checkpoints and messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import AttachmentIndex
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError, UsageError, one_line
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import RunMetadata
from gear_dynamics_ros.recording.mcap.index import FileIndex, read_index, read_metadata
from gear_dynamics_ros.recording.mcap.records import first_bytes, read_attachment, read_chunk
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint


class StoredMessage(NamedTuple):
    """A message of a file."""

    topic: str
    time_ns: int
    data: memoryview  # CDR


@dataclass(frozen=True)
class PartFile:
    """One MCAP file of a recording."""

    path: Path
    run: RunMetadata
    parameters: str  # in force at the start, as ``dump_parameters`` writes them
    start: StoredCheckpoint  # before the first sample
    size: int  # bytes
    index: FileIndex

    @property
    def complete(self) -> bool:
        """Whether the file has its index; False after a crash."""
        return self.index.complete

    @property
    def first_sample(self) -> int:
        """Index of the first sample of the part."""
        return self.start.checkpoint.sample

    @property
    def end(self) -> str:
        """Name of the attachment with the checkpoint at the end of the part; empty if there is none."""
        names = [entry.name for entry in self.index.attachments if entry.name == layout.END_ATTACHMENT]
        return names[-1] if names else ""

    @property
    def checkpoints(self) -> dict[int, str]:
        """Names of the attachments with checkpoints after the start, by sample, in order."""
        numbered = [(layout.checkpoint_sample(entry.name), entry.name) for entry in self.index.attachments]
        return dict(sorted((sample, name) for sample, name in numbered if sample is not None))

    def attachment(self, name: str) -> bytes:
        """Content of the attachment ``name``.

        Raises GearboxError if it can't be read, KeyError if it is missing.
        """
        with reading(self.path) as stream:
            return read_attachment(stream, _index(self.index, name))

    def stored(self, name: str) -> StoredCheckpoint:
        """Checkpoint in the attachment ``name``. Raises GearboxError if it can't be read or is invalid."""
        return _stored(self.attachment(name), f"{self.path.name}: {name}")

    def messages(self, topics: Collection[str], from_ns: int | None = None) -> Iterator[StoredMessage]:
        """Messages on ``topics`` (full names) in the order of the file, from the stamp ``from_ns`` on.

        Holds one chunk of the file at a time. Raises GearboxError at a damaged chunk.
        """
        channels = self._channels(topics)
        with reading(self.path) as stream:
            for index in self.index.chunks:
                if channels.keys().isdisjoint(index.message_index_offsets):
                    continue
                if from_ns is not None and index.message_end_time < from_ns:
                    continue
                for channel, time_ns, data in read_chunk(stream, index).messages(channels):
                    if from_ns is None or time_ns >= from_ns:
                        yield StoredMessage(channels[channel], time_ns, data)

    def last_message(self, topic: str) -> StoredMessage | None:
        """The last message on ``topic`` (full name), None if there is none.

        Raises GearboxError if its chunk is damaged.
        """
        channels = self._channels([topic])
        with reading(self.path) as stream:
            for index in reversed(self.index.chunks):
                if not channels.keys().isdisjoint(index.message_index_offsets):
                    *_, (channel, time_ns, data) = read_chunk(stream, index).messages(channels)
                    return StoredMessage(channels[channel], time_ns, data)
        return None

    def _channels(self, topics: Collection[str]) -> dict[int, str]:
        """Topics by number of their channels."""
        channels = self.index.channels.items()
        return {number: channel.topic for number, channel in channels if channel.topic in topics}


def open_parts(path: Path) -> tuple[PartFile, ...]:
    """The parts of the recording at ``path``, a rosbag2 folder or one MCAP file, in order.

    Raises UsageError if there is none, GearboxError if one was not recorded by this package or is damaged.
    """
    files = part_files(path)
    parts = [_open_part(file) for file in files[:-1]]
    try:
        parts.append(_open_part(files[-1]))
    except GearboxError:
        # After a crash right after a split the last file may lack its start.
        if not (parts and _without_messages(files[-1])):
            raise
    return tuple(parts)


def part_files(path: Path) -> Sequence[Path]:
    """Paths of the files of a recording, in order. Raises UsageError if there is none."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise UsageError(f"no recording at '{path}': give a rosbag2 folder or an .mcap file")
    files = sorted((file for file in path.glob("*.mcap") if file.is_file()), key=layout.part_number)
    if not files:
        raise UsageError(f"no recording in '{path}': the folder holds no .mcap file")
    return files


@contextmanager
def reading(path: Path) -> Iterator[BinaryIO]:
    """The file ``path``, open for reading. Raises GearboxError if it can't be opened."""
    try:
        stream = path.open("rb")
    except OSError as error:
        raise GearboxError(f"can't read '{path}': {error.strerror}") from error
    with stream:
        yield stream


def _open_part(path: Path) -> PartFile:
    with reading(path) as stream:
        index = read_index(stream)
        try:
            run = RunMetadata.from_text(read_metadata(stream, index)[layout.RUN_METADATA])
            parameters, start = (
                read_attachment(stream, _index(index, name))
                for name in (layout.PARAMETERS_ATTACHMENT, layout.START_ATTACHMENT)
            )
            text = parameters.decode()
        except KeyError as error:
            raise GearboxError(
                f"'{path}' was not recorded by this package, or its start is lost: it has no entry {error}"
            ) from error
        except ValueError as error:
            raise GearboxError(
                f"'{path}' was not recorded by this package, or its start is damaged: {one_line(error)}"
            ) from error
        stored = _stored(start, f"{path.name}: {layout.START_ATTACHMENT}")
        return PartFile(path, run, text, stored, path.stat().st_size, index)


def _stored(content: bytes, name: str) -> StoredCheckpoint:
    try:
        return StoredCheckpoint.from_text(content.decode(), name)
    except (UnicodeDecodeError, UsageError) as error:
        raise GearboxError(str(error)) from error


def _without_messages(path: Path) -> bool:
    """Whether the file broke off before its first message."""
    with reading(path) as stream:
        begin = first_bytes(stream)
        if begin != MCAP0_MAGIC:
            return MCAP0_MAGIC.startswith(begin)
        return not read_index(stream).chunks


def _index(index: FileIndex, name: str) -> AttachmentIndex:
    """Index of the attachment ``name``. Raises KeyError if it is missing."""
    try:
        return next(entry for entry in index.attachments if entry.name == name)
    except StopIteration:
        raise KeyError(name) from None
