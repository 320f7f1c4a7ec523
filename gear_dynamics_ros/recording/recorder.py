"""Recorder: writes messages to a rosbag2 folder of MCAP files, on its own thread.

It never overwrites a file and never drops a message, and no error of it reaches the calling thread. With a
slow disk the caller waits; a full or missing disk sets ``error``.
"""

from __future__ import annotations

import hashlib
import math
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from gear_dynamics_ros import __version__
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.parameters import dump_parameters
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.digest import INPUT_TOPICS, RunningDigest
from gear_dynamics_ros.recording.layout import PartSummary, RunMetadata
from gear_dynamics_ros.recording.mcap.writer import McapWriter
from gear_dynamics_ros.simulation.checkpoint import Checkpoint, StoredCheckpoint
from gear_dynamics_ros.simulation.provenance import current_provenance
from gear_dynamics_ros.system.files import replace_text, sync_folder
from gear_dynamics_ros.system.threads import begin_thread
from gear_dynamics_ros.topics import DEFAULT_NAMES, TOPICS, NodeNames, Topic

# Three seconds of all channels at 100 kHz: a disk rarely pauses longer.
QUEUE_BYTES: Final = 64 << 20
# Size of a checkpoint in the queue, about.
STATE_BYTES: Final = 1 << 14
# A crash may lose a second: half of it here, half of it for the queue and the disk.
FLUSH_SECONDS: Final = 0.5
# So long, or until such a part of the queue is full, messages wait for more. Woken up for each chunk, the
# thread would take the lock of Python, and what the processor has cached, from the engine as often.
BATCH_SECONDS: Final = 0.05
BATCHES_IN_QUEUE: Final = 64

_LATCHED: Final = tuple(key for key, topic in TOPICS.items() if topic.latched)


class RecorderStats(NamedTuple):
    """Progress of the recorder."""

    queued: int  # messages received and not yet written
    queued_bytes: int
    messages: int  # messages written
    flushed: int  # messages on the disk, which survive a crash
    bytes: int  # size of all parts
    parts: int
    lost: int  # messages received after an error, or not yet on the disk when it occurred
    free_bytes: int  # on the disk, at the last check
    seconds_left: float  # wall time until recording.minimum_free is reached at the latest rate of writing


class _Split(NamedTuple):
    start: Checkpoint


class _NamedCheckpoint(NamedTuple):
    name: str  # of the attachment
    checkpoint: Checkpoint


_QueueEntry: TypeAlias = Sequence[Record] | _Split | _NamedCheckpoint


class _StoppedError(Exception):
    """Recording has to stop; the text says why and what to do."""


class Recorder:
    """Records one run from the checkpoint ``start`` on into the new folder ``path``.

    ``epoch_ns`` is the stamp of simulated time 0, ``names`` are the node's. ``report`` is called once, on the
    thread of the recorder, with the error that stops it. Raises UsageError if ``path`` exists or can't be
    created, GearboxError if the first file can't be created or less than ``recording.minimum_free`` is free.
    """

    def __init__(
        self,
        path: Path,
        start: Checkpoint,
        epoch_ns: int,
        names: NodeNames = DEFAULT_NAMES,
        report: Callable[[str], None] = lambda error: None,
    ) -> None:
        self._report = report
        self.path = Path(os.path.abspath(path))
        layout.require_text(self.path.name)
        self._epoch_ns = epoch_ns
        self._sample_interval_ns = start.parameters.solver.sample_interval_ns
        self._topics = layout.recorded_topics(start.parameters, names)
        self._sequences: Counter[str] = Counter()
        self._latched: dict[str, bytes] = {}
        self._error: str | None = None
        self._parts: list[PartSummary] = []
        self._written = 0
        self._flushed = 0
        self._in_progress = 0  # messages of the present queue entry that the file has accepted
        self._repeated = 0  # messages at the start of the part, copied from the part before
        self._lost = 0
        self._earlier_bytes = 0
        self._queue: deque[_QueueEntry] = deque()
        self._queued = 0
        self._queued_bytes = 0
        self._splits = 0  # in the queue
        self._closing = False
        self._finished = False
        self._changed = threading.Condition()
        _make_folder(self.path)
        try:
            self._disk = _Disk(self.path, start.parameters.recording.minimum_free)
            self._part = self._new_part()
        except (OSError, _StoppedError) as error:
            self.path.rmdir()
            raise GearboxError(f"recording.path: can't write in '{self.path}': {_reason(error)}") from error
        # Everything that takes a while is left to the thread: an engine may wait for this one.
        self._thread = threading.Thread(target=self._work, args=(start, names), name="recorder", daemon=True)
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Why recording stopped; None if it did not."""
        return self._error

    @property
    def stats(self) -> RecorderStats:
        """Present values."""
        with self._changed:
            return RecorderStats(
                self._queued,
                self._queued_bytes,
                self._written,
                self._flushed,
                self._earlier_bytes + self._part.size,
                len(self._parts) + (not self._part.finished),
                self._lost,
                self._disk.free_bytes,
                self._disk.seconds_left,
            )

    @property
    def topics(self) -> Collection[str]:
        """What it records, keys in TOPICS."""
        return self._topics.keys()

    @property
    def part_bytes(self) -> int:
        """Size of the present part, bytes; 0 while a split is in the queue."""
        with self._changed:
            return 0 if self._splits else self._part.size

    def write(self, records: Sequence[Record]) -> None:
        """Queue messages, in order; waits while the queue is full. Ignores topics that are not recorded."""
        kept = [record for record in records if record.topic in self._topics]
        self._put(kept, len(kept), sum(len(record.data) for record in kept))

    def split(self, start: Checkpoint) -> None:
        """Begin a new part, complete in itself, with the checkpoint ``start``."""
        self._put(_Split(start), 0, STATE_BYTES)

    def checkpoint(self, checkpoint: Checkpoint) -> None:
        """Store ``checkpoint``, taken right after the last chunk written. A replay may begin there."""
        self._put(_NamedCheckpoint(layout.checkpoint_name(checkpoint.sample), checkpoint), 0, STATE_BYTES)

    def conclude(self, checkpoint: Checkpoint) -> None:
        """Store ``checkpoint`` as the end of the recording. Only ``close`` may follow."""
        self._put(_NamedCheckpoint(layout.END_ATTACHMENT, checkpoint), 0, STATE_BYTES)

    def close(self) -> None:
        """Write the queue, finish the part and write metadata.yaml. A second call does nothing."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        if not self._finished:
            self._salvage()

    def _put(self, item: _QueueEntry, messages: int, size: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._queued_bytes < QUEUE_BYTES or self._stopped)
            if self._stopped:
                self._lost += messages
                return
            self._queue.append(item)
            self._queued += messages
            self._queued_bytes += size
            self._splits += isinstance(item, _Split)
            if len(self._queue) == 1 or self._batch_complete:
                self._changed.notify_all()

    @property
    def _stopped(self) -> bool:
        return self._closing or self._error is not None

    def _work(self, start: Checkpoint, names: NodeNames) -> None:
        begin_thread()
        try:
            self._begin(start, names)
            self._write_all()
            self._finish_part()
            self._write_metadata()
            self._finished = True
        except Exception as error:
            # No error may reach the engine, or leave it waiting for space in the queue.
            self._fail(error)
            self._salvage()

    def _begin(self, start: Checkpoint, names: NodeNames) -> None:
        provenance = current_provenance()
        origin = hashlib.sha256(StoredCheckpoint(start, provenance).to_text().encode())
        self._run = RunMetadata(
            provenance=provenance,
            epoch_ns=self._epoch_ns,
            names=names,
            sample_interval_ns=self._sample_interval_ns,
            origin=origin.hexdigest(),
        )
        try:
            self._part.begin(self._run, start)
        except OSError:
            self._part.discard()
            self.path.rmdir()
            raise
        sync_folder(self.path)
        sync_folder(self.path.parent)

    def _write_all(self) -> None:
        flush_at = time.monotonic() + FLUSH_SECONDS
        while True:
            item = self._next(flush_at)
            if isinstance(item, _Split):
                self._next_part(item.start)
                self._release(STATE_BYTES)
            elif isinstance(item, _NamedCheckpoint):
                self._store(item)
                self._release(STATE_BYTES)
            elif item:
                for record in item:
                    # If its chunk does not reach the disk, ``salvage`` counts it as lost.
                    self._in_progress += 1
                    self._write_record(record)
                self._done(item)
            elif self._closing and not self._queue:
                return
            if time.monotonic() >= flush_at:
                self._flush()
                flush_at = time.monotonic() + FLUSH_SECONDS

    def _next(self, until: float) -> _QueueEntry | None:
        """Next entry of the queue, once a batch is complete; None at the time ``until`` or when closing."""
        with self._changed:
            if not self._queue:
                self._changed.wait_for(
                    lambda: self._queue or self._closing, timeout=max(0.0, until - time.monotonic())
                )
                self._changed.wait_for(lambda: self._batch_complete, timeout=BATCH_SECONDS)
            return self._queue.popleft() if self._queue else None

    @property
    def _batch_complete(self) -> bool:
        return self._closing or self._queued_bytes * BATCHES_IN_QUEUE >= QUEUE_BYTES

    def _done(self, records: Sequence[Record]) -> None:
        with self._changed:
            self._queued -= len(records)
            self._queued_bytes -= sum(len(record.data) for record in records)
            self._written += len(records)
            self._in_progress = 0
            self._changed.notify_all()

    def _release(self, size: int) -> None:
        """Free ``size`` bytes of the queue."""
        with self._changed:
            self._queued_bytes -= size
            self._changed.notify_all()

    def _write_record(self, record: Record) -> None:
        if record.topic in _LATCHED:
            self._latched[record.topic] = record.data
        self._part.write(record, self._sequences[record.topic])
        self._sequences[record.topic] += 1

    def _store(self, named: _NamedCheckpoint) -> None:
        self._part.store(named, self._time_ns(named.checkpoint))

    def _flush(self) -> None:
        self._part.flush()
        self._part.require_in_place()
        self._flushed = self._written
        self._disk.check(self._earlier_bytes + self._part.size)

    def _new_part(self) -> _PartWriter:
        return _PartWriter(self.path / layout.part_name(self.path, len(self._parts)), self._topics)

    def _finish_part(self) -> None:
        self._part.require_in_place()
        self._parts.append(self._part.finish())
        self._flushed = self._written

    def _next_part(self, start: Checkpoint) -> None:
        self._store(_NamedCheckpoint(layout.END_ATTACHMENT, start))
        self._finish_part()
        part = self._new_part()
        try:
            part.begin(self._run, start)
        except OSError:
            part.discard()
            raise
        with self._changed:
            self._earlier_bytes += self._part.size
            self._part = part
            self._splits -= 1
        sync_folder(self.path)
        self._repeated = len(self._latched)
        for key, data in self._latched.items():
            self._write_record(Record(key, self._time_ns(start), data))

    def _time_ns(self, checkpoint: Checkpoint) -> int:
        return self._epoch_ns + checkpoint.sample * self._sample_interval_ns

    def _write_metadata(self) -> None:
        text = layout.metadata_yaml(dict(self._topics.values()), self._parts)
        replace_text(self.path / layout.METADATA_FILE, text)

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self._error = f"recording '{self.path}' stopped: {_reason(error)}"
            self._written += self._in_progress
            self._lost += self._queued - self._in_progress
            self._queue.clear()
            self._queued = self._queued_bytes = 0
            self._changed.notify_all()
        self._report(self._error)

    def _salvage(self) -> None:
        """Finish the part after an error, as far as the disk allows."""
        try:
            self._part.require_in_place()
            if not self._part.finished:
                part, abandoned = self._part.salvage()
                self._parts.append(part)
                if not part.messages:
                    abandoned = max(0, abandoned - self._repeated)
                self._lost += abandoned
                self._written -= abandoned
            self._write_metadata()
            self._finished = True
        except (OSError, _StoppedError):
            self._finished = False


class _Disk:
    """Checks the free space for a recording at ``path``. Raises _StoppedError below ``minimum`` bytes."""

    def __init__(self, path: Path, minimum: int) -> None:
        self._path = path
        self._minimum = minimum
        self._checked_at = time.monotonic()
        self._written = 0  # bytes, at the last check
        self.free_bytes = 0
        self.seconds_left = math.inf
        self.check(0)

    def check(self, written: int) -> None:
        """Check the free space; ``written`` is the present size of the recording in bytes."""
        now = time.monotonic()
        volume = os.statvfs(self._path)
        self.free_bytes = volume.f_bavail * volume.f_frsize
        rate = (written - self._written) / (now - self._checked_at) if written > self._written else 0.0
        self.seconds_left = max(0, self.free_bytes - self._minimum) / rate if rate else math.inf
        self._written, self._checked_at = written, now
        if self.free_bytes < self._minimum:
            raise _StoppedError(
                f"only {self.free_bytes / 1e6:.1f} MB are free there, less than recording.minimum_free = "
                f"{self._minimum / 1e6:g} MB: free space and start a new recording"
            )


class _PartWriter:
    """Writes one part: an MCAP file that is complete in itself."""

    def __init__(self, path: Path, topics: Mapping[str, tuple[str, Topic]]) -> None:
        self._path = path
        self._topics = topics
        self._channels = {key: number for number, key in enumerate(topics, start=1)}
        self._mcap = McapWriter(path, f"{layout.RUN_METADATA} {__version__}")
        self._digest = RunningDigest()
        self.finished = False

    @property
    def size(self) -> int:
        """Size of the file, bytes."""
        return self._mcap.index.end

    def begin(self, run: RunMetadata, start: Checkpoint) -> None:
        """Write attachments and channels: what a reader needs before the first message."""
        self._mcap.add_metadata(layout.RUN_METADATA, run.to_text())
        parameters = dump_parameters(start.parameters)
        state = StoredCheckpoint(start, current_provenance()).to_text()
        self._attach(run.epoch_ns, layout.PARAMETERS_ATTACHMENT, "yaml", parameters)
        self._attach(run.epoch_ns, layout.START_ATTACHMENT, "json", state)
        self._digest = RunningDigest(run.to_lines(), parameters.encode(), state.encode())
        self._mcap.add_definitions(*layout.channel_definitions(self._topics.values()))
        self._mcap.sync()

    def write(self, record: Record, sequence: int) -> None:
        """Write a message."""
        self._mcap.add_message(self._channels[record.topic], sequence, record.time_ns, record.data)
        if record.topic in INPUT_TOPICS:
            self._digest.add(self._topics[record.topic][0], record.time_ns, record.data)

    def store(self, named: _NamedCheckpoint, time_ns: int) -> None:
        """Attach a checkpoint after all messages before it, with the digest since the last checkpoint."""
        self._mcap.end_chunk()
        text = StoredCheckpoint(named.checkpoint, current_provenance(), self._digest.text()).to_text()
        self._attach(time_ns, named.name, "json", text)
        self._digest = RunningDigest(text.encode())

    def flush(self) -> None:
        """Write every message to the disk (fsync)."""
        self._mcap.end_chunk()
        self._mcap.sync()

    def require_in_place(self) -> None:
        """Raise _StoppedError if the file was moved or removed."""
        if not self._mcap.in_place:
            raise _StoppedError(
                f"its file '{self._path.name}' was moved or removed, with what was written: "
                "start a new recording"
            )

    def finish(self) -> PartSummary:
        """Write the index and close the file."""
        self._mcap.end_chunk()
        part = self._part()
        embedded = layout.embedded_metadata(dict(self._topics.values()), part)
        self._mcap.add_metadata(layout.ROSBAG2_METADATA, embedded)
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return part

    def salvage(self) -> tuple[PartSummary, int]:
        """After a failed write, complete the file without the open chunk.

        Returns the number of messages in that chunk too, which are lost.
        """
        abandoned = self._mcap.abandon_chunk()
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return self._part(), abandoned

    def discard(self) -> None:
        """Close and remove the file."""
        self._mcap.close()
        self._path.unlink()

    def _attach(self, time_ns: int, name: str, kind: str, text: str) -> None:
        self._mcap.add_attachment(time_ns, name, f"application/{kind}", text.encode())

    def _part(self) -> PartSummary:
        index = self._mcap.index
        return PartSummary(self._path.name, index.start_ns, index.end_ns, index.topic_counts())


def _reason(error: Exception) -> str:
    """Text of ``error`` with what to do."""
    if isinstance(error, _StoppedError):
        return str(error)
    if isinstance(error, FileNotFoundError):
        return "its folder was moved or removed, with what was written: start a new recording"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}: what was written stays readable; free space or choose another path"
    return f"{str(error) or repr(error)}: what was written stays readable; start a new recording"


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
