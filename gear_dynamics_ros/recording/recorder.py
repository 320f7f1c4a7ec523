"""Recorder: messages into a rosbag2 folder of MCAP files, on a thread of its own.

It never overwrites, never drops and never raises into the thread that hands over: a slow disk holds that
thread back, a full or missing one sets ``error``.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from gear_dynamics_ros import __version__
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.parameters import dump_parameters
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.digest import TOLD, RunningDigest
from gear_dynamics_ros.recording.layout import PartSummary, RunMetadata
from gear_dynamics_ros.recording.mcap.writer import McapWriter
from gear_dynamics_ros.simulation.checkpoint import Checkpoint, StoredCheckpoint
from gear_dynamics_ros.simulation.provenance import current_provenance
from gear_dynamics_ros.system.files import replace_text, sync_folder
from gear_dynamics_ros.system.threads import name_thread
from gear_dynamics_ros.topics import TOPICS, Topic

# Three seconds of every channel at 100 kHz: longer than a disk usually pauses.
QUEUE_BYTES: Final = 64 << 20
# What a checkpoint takes up in the queue.
STATE_BYTES: Final = 1 << 14
# Half of the second that a crash may cost; the rest is for the queue and the disk.
FLUSH_SECONDS: Final = 0.5

_LATCHED: Final = tuple(key for key, topic in TOPICS.items() if topic.latched)


class RecorderStats(NamedTuple):
    """How the recorder stands."""

    queued: int  # messages handed over, not yet written
    queued_bytes: int
    messages: int  # messages written
    flushed: int  # of them on the disk, where no crash takes them
    bytes: int  # size of all files
    parts: int
    lost: int  # messages handed over after an error, or on their way to the disk when it came
    free_bytes: int  # on the disk when last looked at
    seconds_left: float  # of wall time, until recording.minimum_free is reached at the pace of late


class _Split(NamedTuple):
    start: Checkpoint


class _Keep(NamedTuple):
    name: str  # of the attachment
    checkpoint: Checkpoint


class _StoppedError(Exception):
    """Why no more can be recorded, and what to do, in words."""


class Recorder:
    """Records one run into the folder ``path``, made here, from the checkpoint ``start`` on.

    ``report`` is called once, on the recorder's thread, with the
    error that stops it.

    Raises UsageError if ``path`` exists or can't be made, GearboxError if the first file can't be opened or
    less than ``recording.minimum_free`` is free there.
    """

    def __init__(
        self,
        path: Path,
        start: Checkpoint,
        epoch_ns: int,
        node: str = "/gearbox",
        report: Callable[[str], None] = lambda error: None,
    ) -> None:
        self._report = report
        self.path = Path(os.path.abspath(path))
        self._run = RunMetadata(
            provenance=current_provenance(),
            epoch_ns=epoch_ns,
            node=node,
            sample_interval_ns=start.parameters.solver.sample_interval_ns,
        )
        self._topics = layout.recorded_topics(start.parameters, node)
        self._sequences: Counter[str] = Counter()
        self._latched: dict[str, bytes] = {}
        self._error: str | None = None
        self._parts: list[PartSummary] = []
        self._written = 0
        self._flushed = 0
        self._in_hand = 0  # messages of those handed over last that the file has taken
        self._repeated = 0  # messages at the start of the part that stood in one before it
        self._lost = 0
        self._earlier_bytes = 0
        self._queue: deque[Sequence[Record] | _Split | _Keep] = deque()
        self._queued = 0
        self._queued_bytes = 0
        self._splits = 0  # that wait in the queue
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
        self._thread = threading.Thread(target=self._work, args=(start,), name="recorder", daemon=True)
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Why recording stopped; None while all is well."""
        return self._error

    @property
    def stats(self) -> RecorderStats:
        """Figures of this moment."""
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
    def part_bytes(self) -> int:
        """Size of the file being written; 0 while a split waits."""
        with self._changed:
            return 0 if self._splits else self._part.size

    def write(self, records: Sequence[Record]) -> None:
        """Hand over messages, in order; waits while the queue is full. Those not recorded are left out."""
        wanted = [record for record in records if record.topic in self._topics]
        self._put(wanted, len(wanted), sum(len(record.data) for record in wanted))

    def split(self, start: Checkpoint) -> None:
        """Go on in a new file, complete in itself, from the checkpoint ``start`` on."""
        self._put(_Split(start), 0, STATE_BYTES)

    def checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep the checkpoint right after the last chunk handed over, so that a replay may begin there."""
        self._put(_Keep(layout.checkpoint_name(checkpoint.sample), checkpoint), 0, STATE_BYTES)

    def conclude(self, checkpoint: Checkpoint) -> None:
        """Keep the checkpoint in which the recording ends; nothing but ``close`` follows."""
        self._put(_Keep(layout.END_ATTACHMENT, checkpoint), 0, STATE_BYTES)

    def close(self) -> None:
        """Write what is queued, finish the file and metadata.yaml. A second call does nothing."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        if not self._finished:
            self._salvage()

    def _put(self, item: Sequence[Record] | _Split | _Keep, messages: int, size: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._queued_bytes < QUEUE_BYTES or self._stopped)
            if self._stopped:
                self._lost += messages
                return
            self._queue.append(item)
            self._queued += messages
            self._queued_bytes += size
            self._splits += isinstance(item, _Split)
            self._changed.notify_all()

    @property
    def _stopped(self) -> bool:
        return self._closing or self._error is not None

    def _work(self, start: Checkpoint) -> None:
        name_thread()
        try:
            self._begin(start)
            self._write_all()
            self._finish_part()
            self._write_metadata()
            self._finished = True
        except Exception as error:
            # Whatever went wrong here must neither reach the engine nor leave it waiting for room.
            self._fail(error)
            self._salvage()

    def _begin(self, start: Checkpoint) -> None:
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
            elif isinstance(item, _Keep):
                self._keep(item)
                self._release(STATE_BYTES)
            elif item:
                for record in item:
                    # Should its chunk not get to the disk, ``salvage`` counts it.
                    self._in_hand += 1
                    self._write_record(record)
                self._done(item)
            elif self._closing and not self._queue:
                return
            if time.monotonic() >= flush_at:
                self._flush()
                flush_at = time.monotonic() + FLUSH_SECONDS

    def _next(self, until: float) -> Sequence[Record] | _Split | _Keep | None:
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
            self._in_hand = 0
            self._changed.notify_all()

    def _release(self, size: int) -> None:
        """Make room in the queue."""
        with self._changed:
            self._queued_bytes -= size
            self._changed.notify_all()

    def _write_record(self, record: Record) -> None:
        if record.topic in _LATCHED:
            self._latched[record.topic] = record.data
        self._part.write(record, self._sequences[record.topic])
        self._sequences[record.topic] += 1

    def _keep(self, kept: _Keep) -> None:
        self._part.keep(kept, self._time_ns(kept.checkpoint))

    def _flush(self) -> None:
        self._part.flush()
        self._part.require_in_place()
        self._flushed = self._written
        self._disk.watch(self._earlier_bytes + self._part.size)

    def _new_part(self) -> _PartWriter:
        return _PartWriter(self.path / layout.part_name(self.path, len(self._parts)), self._topics)

    def _finish_part(self) -> None:
        self._part.require_in_place()
        self._parts.append(self._part.finish())
        self._flushed = self._written

    def _next_part(self, start: Checkpoint) -> None:
        self._keep(_Keep(layout.END_ATTACHMENT, start))
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
        return self._run.epoch_ns + checkpoint.sample * self._run.sample_interval_ns

    def _write_metadata(self) -> None:
        text = layout.metadata_yaml(dict(self._topics.values()), self._parts)
        replace_text(self.path / layout.METADATA_FILE, text)

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self._error = f"recording '{self.path}' stopped: {_reason(error)}"
            self._written += self._in_hand
            self._lost += self._queued - self._in_hand
            self._queue.clear()
            self._queued = self._queued_bytes = 0
            self._changed.notify_all()
        self._report(self._error)

    def _salvage(self) -> None:
        """Finish, as far as the disk allows, the file that broke off."""
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
    """Watches the room that is left where a recording lies.

    Raises _StoppedError where it is less than ``minimum`` bytes.
    """

    def __init__(self, path: Path, minimum: int) -> None:
        self._path = path
        self._minimum = minimum
        self._looked_at = time.monotonic()
        self._bytes = 0
        self.free_bytes = 0
        self.seconds_left = math.inf
        self.watch(0)

    def watch(self, written: int) -> None:
        """Look, ``written`` bytes being written by now."""
        now = time.monotonic()
        volume = os.statvfs(self._path)
        self.free_bytes = volume.f_bavail * volume.f_frsize
        pace = (written - self._bytes) / (now - self._looked_at) if written > self._bytes else 0.0
        self.seconds_left = max(0, self.free_bytes - self._minimum) / pace if pace else math.inf
        self._bytes, self._looked_at = written, now
        if self.free_bytes < self._minimum:
            raise _StoppedError(
                f"only {self.free_bytes / 1e6:.1f} MB are free there, less than recording.minimum_free = "
                f"{self._minimum / 1e6:g} MB: free space and start a new recording"
            )


class _PartWriter:
    """One MCAP file of a recording, complete in itself."""

    def __init__(self, path: Path, topics: Mapping[str, tuple[str, Topic]]) -> None:
        self._path = path
        self._topics = topics
        self._channels = {key: number for number, key in enumerate(topics, start=1)}
        self._mcap = McapWriter(path, f"{layout.RUN_METADATA} {__version__}")
        self._digest = RunningDigest()
        self.finished = False

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._mcap.index.end

    def begin(self, run: RunMetadata, start: Checkpoint) -> None:
        """Attachments and channels: whatever a reader needs before the first message."""
        self._mcap.add_metadata(layout.RUN_METADATA, run.to_text())
        parameters = dump_parameters(start.parameters)
        state = StoredCheckpoint(start, current_provenance()).to_text()
        self._attach(run.epoch_ns, layout.PARAMETERS_ATTACHMENT, "yaml", parameters)
        self._attach(run.epoch_ns, layout.START_ATTACHMENT, "json", state)
        self._digest = RunningDigest(run.to_lines(), parameters.encode(), state.encode())
        self._mcap.add_definitions(*layout.channel_definitions(self._topics.values()))
        self._mcap.sync()

    def write(self, record: Record, sequence: int) -> None:
        """Add a message."""
        self._mcap.add_message(self._channels[record.topic], sequence, record.time_ns, record.data)
        if record.topic in TOLD:
            self._digest.add(self._topics[record.topic][0], record.time_ns, record.data)

    def keep(self, kept: _Keep, time_ns: int) -> None:
        """Attach a checkpoint, behind all messages before it, with the digest of what led to it."""
        self._mcap.end_chunk()
        text = StoredCheckpoint(kept.checkpoint, current_provenance(), self._digest.text()).to_text()
        self._attach(time_ns, kept.name, "json", text)
        self._digest = RunningDigest(text.encode())

    def flush(self) -> None:
        """Bring every message to the disk."""
        self._mcap.end_chunk()
        self._mcap.sync()

    def require_in_place(self) -> None:
        """Raise _StoppedError if the file is no longer where it was made: writing to it would help nobody."""
        if not self._mcap.in_place:
            raise _StoppedError(
                f"its file '{self._path.name}' has gone: what was written is where it went; "
                "start a new recording"
            )

    def finish(self) -> PartSummary:
        """Complete the file."""
        self._mcap.end_chunk()
        part = self._part()
        embedded = layout.embedded_metadata(dict(self._topics.values()), part)
        self._mcap.add_metadata(layout.ROSBAG2_METADATA, embedded)
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return part

    def salvage(self) -> tuple[PartSummary, int]:
        """Complete the file with what was written whole, after a write failed; how many messages were not."""
        abandoned = self._mcap.abandon_chunk()
        self._mcap.finish()
        self._mcap.close()
        self.finished = True
        return self._part(), abandoned

    def discard(self) -> None:
        """Remove the file again."""
        self._mcap.close()
        self._path.unlink()

    def _attach(self, time_ns: int, name: str, kind: str, text: str) -> None:
        self._mcap.add_attachment(time_ns, name, f"application/{kind}", text.encode())

    def _part(self) -> PartSummary:
        index = self._mcap.index
        return PartSummary(self._path.name, index.start_ns, index.end_ns, index.topic_counts())


def _reason(error: Exception) -> str:
    """What went wrong and what to do, in words."""
    if isinstance(error, _StoppedError):
        return str(error)
    if isinstance(error, FileNotFoundError):
        return "its folder has gone: what was written is where it went; start a new recording"
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
