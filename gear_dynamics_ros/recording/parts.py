"""The MCAP files of a recording: what each starts from, and its messages one by one."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import AttachmentIndex
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import RunMetadata
from gear_dynamics_ros.recording.mcap.index import FileIndex, read_index, read_metadata
from gear_dynamics_ros.recording.mcap.records import first_bytes, read_attachment, read_chunk
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint


class StoredMessage(NamedTuple):
    """A message as it stands in a file."""

    topic: str
    time_ns: int
    data: memoryview  # CDR


@dataclass(frozen=True)
class PartFile:
    """One MCAP file of a recording."""

    path: Path
    run: RunMetadata
    parameters: str  # those in force at the start, as ``parameters.dump`` writes them
    start: StoredCheckpoint  # from which the part starts
    size: int  # bytes
    index: FileIndex

    @property
    def complete(self) -> bool:
        """Whether the file was finished; False after a crash."""
        return self.index.complete

    @property
    def first_sample(self) -> int:
        """Sample before which the part starts."""
        return self.start.checkpoint.sample

    @property
    def end(self) -> str:
        """Name of the attachment with the state in which the part ended; empty if there is none."""
        names = [entry.name for entry in self.index.attachments if entry.name == layout.END_ATTACHMENT]
        return names[-1] if names else ""

    @property
    def checkpoints(self) -> dict[int, str]:
        """Names of the attachments with states behind the start, by sample, in order."""
        numbered = [(layout.checkpoint_sample(entry.name), entry.name) for entry in self.index.attachments]
        return dict(sorted((sample, name) for sample, name in numbered if sample is not None))

    def attachment(self, name: str) -> bytes:
        """Content of an attachment. Raises GearboxError if it can't be read."""
        with reading(self.path) as stream:
            return read_attachment(stream, _index(self.index, name))

    def stored(self, name: str) -> StoredCheckpoint:
        """Checkpoint in an attachment. Raises GearboxError if it can't be read or is none."""
        return _stored(self.attachment(name), f"{self.path.name}: {name}")

    def messages(self, topics: Collection[str], from_ns: int | None = None) -> Iterator[StoredMessage]:
        """Messages of topics (full names) in their order, those before ``from_ns`` left out.

        Holds one chunk of the file at a time. Raises GearboxError where a chunk is spoilt.
        """
        wanted = self._channels(topics)
        with reading(self.path) as stream:
            for index in self.index.chunks:
                if wanted.keys().isdisjoint(index.message_index_offsets):
                    continue
                if from_ns is not None and index.message_end_time < from_ns:
                    continue
                for channel, time_ns, data in read_chunk(stream, index).messages(wanted):
                    if from_ns is None or time_ns >= from_ns:
                        yield StoredMessage(wanted[channel], time_ns, data)

    def last_message(self, topic: str) -> StoredMessage | None:
        """The last message of a topic."""
        wanted = self._channels([topic])
        with reading(self.path) as stream:
            for index in reversed(self.index.chunks):
                if not wanted.keys().isdisjoint(index.message_index_offsets):
                    *_, (channel, time_ns, data) = read_chunk(stream, index).messages(wanted)
                    return StoredMessage(wanted[channel], time_ns, data)
        return None

    def _channels(self, topics: Collection[str]) -> dict[int, str]:
        channels = self.index.channels.items()
        return {number: channel.topic for number, channel in channels if channel.topic in topics}


def open_parts(path: Path) -> tuple[PartFile, ...]:
    """The files of the recording at ``path``, a rosbag2 folder or one MCAP file, in order.

    Raises UsageError if there is none, GearboxError if one wasn't written by this package or is spoilt.
    """
    files = part_files(path)
    parts = [_open_part(file) for file in files[:-1]]
    try:
        parts.append(_open_part(files[-1]))
    except GearboxError:
        # A crash right after a split leaves a last file without even its start.
        if not (parts and _unbegun(files[-1])):
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
    """The file open for reading. Raises GearboxError if it can't be."""
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
        except (KeyError, ValueError) as error:
            raise GearboxError(
                f"'{path}' is no recording of this package, or its start is lost: {error}"
            ) from error
        stored = _stored(start, f"{path.name}: {layout.START_ATTACHMENT}")
        return PartFile(path, run, text, stored, path.stat().st_size, index)


def _stored(content: bytes, name: str) -> StoredCheckpoint:
    try:
        return StoredCheckpoint.from_text(content.decode(), name)
    except (UnicodeDecodeError, UsageError) as error:
        raise GearboxError(str(error)) from error


def _unbegun(path: Path) -> bool:
    """Whether a file broke off before its first message."""
    with reading(path) as stream:
        begin = first_bytes(stream)
        if begin != MCAP0_MAGIC:
            return MCAP0_MAGIC.startswith(begin)
        return not read_index(stream).chunks


def _index(index: FileIndex, name: str) -> AttachmentIndex:
    try:
        return next(entry for entry in index.attachments if entry.name == name)
    except StopIteration:
        raise KeyError(name) from None
