"""Recorder: messages into a rosbag2 folder of MCAP files, on a thread of its own.

It never overwrites, never drops and never raises into the thread that hands over: a slow disk holds that
thread back, a full one sets ``error``.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gear_dynamics_ros import __version__
from gear_dynamics_ros.engine import kernel_hash
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages import TOPICS, Record, Topic, resolve
from gear_dynamics_ros.parameters import Parameters, dump
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import Part, RunMetadata
from gear_dynamics_ros.recording.mcap_writer import McapWriter
from gear_dynamics_ros.threads import name_thread

# Three seconds of every channel at 100 kHz: longer than a disk usually pauses.
QUEUE_BYTES: Final = 64 << 20
# Half of the second that a crash may cost; the rest is for the queue and the disk.
FLUSH_SECONDS: Final = 0.5

_LATCHED: Final = tuple(key for key, topic in TOPICS.items() if topic.latched)


class Stats(NamedTuple):
    """How the recorder stands."""

    queued: int  # messages handed over, not yet written
    queued_bytes: int
    messages: int  # messages written
    bytes: int  # size of all files
    lost: int  # messages handed over after an error, or queued when it came


class _Split(NamedTuple):
    start: Mapping[str, Any]
    parameters: str


class Recorder:
    """Records one run into the folder ``path``, made here; ``start`` is the checkpoint it starts from.

    ``parameters`` are those in force there.

    Raises UsageError if ``path`` exists or can't be made, GearboxError if the first file can't be written.
    """

    def __init__(
        self,
        path: Path,
        parameters: Parameters,
        start: Mapping[str, Any],
        epoch_ns: int,
        node: str = "/gearbox",
    ) -> None:
        self.path = Path(os.path.abspath(path))
        self._run = RunMetadata(
            __version__, kernel_hash(), epoch_ns, node, parameters.solver.sample_interval_ns
        )
        self._topics = {key: (resolve(topic, node), topic) for key, topic in TOPICS.items()}
        self._sequences: Counter[str] = Counter()
        self._latched: dict[str, bytes] = {}
        self._error: str | None = None
        self._parts: list[Part] = []
        self._written = 0
        self._lost = 0
        self._earlier_bytes = 0
        self._queue: deque[Sequence[Record] | _Split] = deque()
        self._queued = 0
        self._queued_bytes = 0
        self._closing = False
        self._finished = False
        self._changed = threading.Condition()
        _make_folder(self.path)
        try:
            self._part = self._open_part(start, dump(parameters))
        except OSError as error:
            self.path.rmdir()
            raise GearboxError(
                f"recording.path: can't write in '{self.path}': {error.strerror}: "
                "free space or choose another path"
            ) from error
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Why recording stopped; None while all is well."""
        return self._error

    @property
    def stats(self) -> Stats:
        """Figures of this moment."""
        with self._changed:
            return Stats(
                self._queued,
                self._queued_bytes,
                self._written,
                self._earlier_bytes + self._part.size,
                self._lost,
            )

    def write(self, records: Sequence[Record]) -> None:
        """Hand over messages, in order; waits while the queue is full."""
        self._put(records, len(records), sum(len(record.data) for record in records))

    def split(self, start: Mapping[str, Any], parameters: Parameters) -> None:
        """Go on in a new file, complete in itself, from the checkpoint ``start`` on.

        ``parameters`` are those in force there.
        """
        self._put(_Split(start, dump(parameters)), 0, 0)

    def close(self) -> None:
        """Write what is queued, finish the file and metadata.yaml. A second call does nothing."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        if not self._finished:
            self._salvage()

    def _put(self, item: Sequence[Record] | _Split, messages: int, size: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._queued_bytes < QUEUE_BYTES or self._stopped)
            if self._stopped:
                self._lost += messages
                return
            self._queue.append(item)
            self._queued += messages
            self._queued_bytes += size
            self._changed.notify_all()

    @property
    def _stopped(self) -> bool:
        return self._closing or self._error is not None

    def _work(self) -> None:
        name_thread()
        try:
            self._write_all()
            self._parts.append(self._part.finish())
            self._write_metadata()
            self._finished = True
        except Exception as error:
            # Whatever went wrong here must neither reach the engine nor leave it waiting for room.
            self._fail(error)
            self._salvage()

    def _write_all(self) -> None:
        flush_at = time.monotonic() + FLUSH_SECONDS
        while True:
            item = self._next(flush_at)
            if isinstance(item, _Split):
                self._next_part(item)
            elif item:
                for record in item:
                    self._write_record(record)
                self._done(item)
            elif self._closing and not self._queue:
                return
            if time.monotonic() >= flush_at:
                self._part.flush()
                flush_at = time.monotonic() + FLUSH_SECONDS

    def _next(self, until: float) -> Sequence[Record] | _Split | None:
        """What was handed over next; None at the time ``until`` or when closing."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._queue or self._closing, timeout=max(0.0, until - time.monotonic())
            )
            return self._queue.popleft() if self._queue else None

    def _done(self, records: Sequence[Record]) -> None:
        with self._changed:
            self._queued -= len(records)
            self._queued_bytes -= sum(len(record.data) for record in records)
            self._written += len(records)
            self._changed.notify_all()

    def _write_record(self, record: Record) -> None:
        if record.topic in _LATCHED:
            self._latched[record.topic] = record.data
        self._part.write(record, self._sequences[record.topic])
        self._sequences[record.topic] += 1

    def _open_part(self, start: Mapping[str, Any], parameters: str) -> _PartWriter:
        part = _PartWriter(self.path / layout.part_name(self.path, len(self._parts)), self._topics)
        try:
            part.begin(self._run, parameters, json.dumps(start))
        except OSError:
            part.discard()
            raise
        return part

    def _next_part(self, split: _Split) -> None:
        self._parts.append(self._part.finish())
        part = self._open_part(split.start, split.parameters)
        with self._changed:
            self._earlier_bytes += self._part.size
            self._part = part
        time_ns = self._run.epoch_ns + int(split.start["sample"]) * self._run.sample_interval_ns
        for key, data in self._latched.items():
            self._write_record(Record(key, time_ns, data))

    def _write_metadata(self) -> None:
        text = layout.metadata_yaml(dict(self._topics.values()), self._parts)
        draft = self.path / f"{layout.METADATA_FILE}.part"
        with draft.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(self.path / layout.METADATA_FILE)

    def _fail(self, error: Exception) -> None:
        reason = (
            error.strerror if isinstance(error, OSError) and error.strerror else str(error) or repr(error)
        )
        with self._changed:
            self._error = (
                f"recording '{self.path}' stopped: {reason}: what was written stays readable; "
                "free space and start a new recording"
            )
            self._lost += self._queued
            self._queue.clear()
            self._queued = self._queued_bytes = 0
            self._changed.notify_all()

    def _salvage(self) -> None:
        """Finish, as far as the disk allows, the file that broke off."""
        try:
            if not self._part.finished:
                self._parts.append(self._part.salvage())
            self._write_metadata()
            self._finished = True
        except OSError:
            self._finished = False


class _PartWriter:
    """One MCAP file of a recording, complete in itself."""

    def __init__(self, path: Path, topics: Mapping[str, tuple[str, Topic]]) -> None:
        self._path = path
        self._topics = topics
        self._channels: dict[str, int] = {}
        self._mcap = McapWriter(path, f"{layout.RUN_METADATA} {__version__}")
        self.finished = False

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._mcap.survey.end

    def begin(self, run: RunMetadata, parameters: str, start: str) -> None:
        """Attachments and channels: whatever a reader needs before the first message."""
        self._mcap.add_metadata(layout.RUN_METADATA, run.to_text())
        self._mcap.add_attachment(
            run.epoch_ns, layout.PARAMETERS_ATTACHMENT, "application/yaml", parameters.encode()
        )
        self._mcap.add_attachment(run.epoch_ns, layout.START_ATTACHMENT, "application/json", start.encode())
        for key, (name, topic) in self._topics.items():
            self._channels[key] = self._mcap.add_channel(
                name, topic.type, layout.schema(topic.type), layout.channel_metadata(topic)
            )
        self._mcap.sync()

    def write(self, record: Record, sequence: int) -> None:
        """Add a message."""
        self._mcap.add_message(self._channels[record.topic], sequence, record.time_ns, record.data)

    def flush(self) -> None:
        """Bring every message to the disk."""
        self._mcap.end_chunk()
        self._mcap.sync()

    def finish(self) -> Part:
        """Complete the file."""
        self._mcap.end_chunk()
        part = self._part()
        embedded = layout.embedded_metadata(dict(self._topics.values()), part)
        self._mcap.add_metadata(layout.ROSBAG2_METADATA, embedded)
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return part

    def salvage(self) -> Part:
        """Complete the file with what was written whole, after a write failed."""
        self._mcap.abandon_chunk()
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return self._part()

    def discard(self) -> None:
        """Remove the file again."""
        self._mcap.close()
        self._path.unlink()

    def _part(self) -> Part:
        found = self._mcap.survey
        return Part(self._path.name, found.start_ns, found.end_ns, found.topic_counts())


def _make_folder(path: Path) -> None:
    if os.path.lexists(path):
        raise UsageError(
            f"recording.path: '{path}' exists already and recordings never overwrite: "
            "choose another path or move it away"
        )
    try:
        path.mkdir()
    except FileNotFoundError:
        raise UsageError(
            f"recording.path: the folder '{path.parent}' does not exist: make it or choose another path"
        ) from None
    except OSError as error:
        raise UsageError(
            f"recording.path: can't make '{path}': {error.strerror}: choose a writable place"
        ) from error
