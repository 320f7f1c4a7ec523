"""Reads recordings, complete or broken off, block by block."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import IMPACTS
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.messages.decoder import MessageDecoder
from gear_dynamics_ros.parameters import Parameters, parse_parameters
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.coverage import SampleRange, cover, ordered
from gear_dynamics_ros.recording.parts import PartFile, StoredMessage, open_parts
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.topics import TOPICS

BLOCK_SAMPLES: Final = 20_000
IMPACT: Final = np.dtype([(entry.name, "<f8") for entry in IMPACTS])  # one bearing contact


class TopicCount(NamedTuple):
    """A topic of a recording (full name) and the number of its messages."""

    name: str
    type: str
    messages: int


class Recording:
    """A recording, a folder or a single MCAP file. Use ``open`` to open one.

    Samples are counted from the start of the run; the recording holds ``first_sample`` to before
    ``end_sample``. Times are simulated, in s. Several threads may read at once.
    """

    def __init__(self, path: Path, parts: tuple[PartFile, ...], parameters: Parameters) -> None:
        """Read the first and the last sample of the waveform. Raises GearboxError if these are damaged."""
        self.path = path
        self.parts = parts
        self.parameters = parameters
        self.run = parts[0].run
        self.coverage = cover(path, parts, self.run.names.topic("waveform"))
        # Full names by key in TOPICS.
        self.topic_names = {key: self.run.names.topic(key) for key in TOPICS}
        # The waveform holds the samples from the first to before the second.
        self.first_sample, self.end_sample = self._find_samples()

    @property
    def epoch_ns(self) -> int:
        """Stamp of simulated time 0, ns."""
        return self.run.epoch_ns

    @property
    def node(self) -> str:
        """Full name of the node."""
        return self.run.names.node

    @property
    def version(self) -> str:
        """Version of the package that made the recording."""
        return self.run.provenance.version

    @property
    def kernel_hash(self) -> str:
        """SHA-256 of the source of the kernel that made the recording."""
        return self.run.provenance.kernel_hash

    @property
    def sample_interval_ns(self) -> int:
        """Simulated time between two samples, ns."""
        return self.run.sample_interval_ns

    @property
    def start(self) -> Checkpoint:
        """Checkpoint before the first sample."""
        return self.parts[0].start.checkpoint

    @property
    def complete(self) -> bool:
        """Whether all is there and as the recorder left it."""
        return self.coverage.whole

    @property
    def concluded(self) -> bool:
        """Whether the recorder came to its end: the run may have continued after that of a broken one."""
        has_metadata = self.path.is_file() or (self.path / layout.METADATA_FILE).is_file()
        return has_metadata and bool(self.parts[-1].end)

    @property
    def samples(self) -> int:
        """Number of samples held; ``first_sample`` to ``end_sample`` may have gaps."""
        return self.coverage.samples if "waveform" in self.recorded else 0

    @property
    def size(self) -> int:
        """Size of all parts, bytes."""
        return sum(part.size for part in self.parts)

    @property
    def topics(self) -> list[TopicCount]:
        """The topics recorded, with their message counts."""
        counts: Counter[str] = Counter()
        for part in self.parts:
            counts.update(part.index.topic_counts())
        return [
            TopicCount(name, TOPICS[key].type, counts[name])
            for key, name in self.topic_names.items()
            if name in counts
        ]

    @property
    def recorded(self) -> frozenset[str]:
        """The topics recorded, as keys in TOPICS."""
        names = {topic.name for topic in self.topics}
        return frozenset(key for key, name in self.topic_names.items() if name in names)

    def require_topic(self, key: str) -> None:
        """Raise UsageError if the topic (key in TOPICS) was not recorded; it may have no messages."""
        if key not in self.recorded:
            raise UsageError(
                f"{self.path} has no {key}, which was not among recording.topics: "
                "replay info lists the topics recorded"
            )

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the waveform's columns."""
        return tuple(self.parameters.waveform_channels)

    @property
    def duration_ns(self) -> int:
        """Simulated time that the waveform covers, ns."""
        return (self.end_sample - self.first_sample) * self.sample_interval_ns

    @cached_property
    def commands(self) -> list[tuple[int, Commands]]:
        """Commands in force, each from its sample on. Read at first use, then kept in memory.

        Raises GearboxError at a damaged message.
        """
        decoder = self.decoder()
        changes = [decoder.applied(*message) for message in self._latched("applied_command")]
        return [(self.sample_of(applied.time_ns), applied.commands) for applied in changes]

    @cached_property
    def events(self) -> list[OperatorEvent]:
        """Operator events in order. Read at first use, then kept in memory.

        Raises GearboxError at a damaged message.
        """
        decoder = self.decoder()
        return [decoder.event(*message) for message in self._latched("event")]

    def decoder(self) -> MessageDecoder:
        """A new decoder of the messages, for one thread."""
        return MessageDecoder(self.channel_names, self.parameters.joint_prefix, str(self.path))

    def waveform(self, first: int | None = None, end: int | None = None) -> NDArray[np.float64]:
        """Samples ``first`` to before ``end``, shape (n, channels), as far as the recording holds them.

        Raises GearboxError if samples are missing or doubled.
        """
        first = self.first_sample if first is None else max(first, self.first_sample)
        end = self.end_sample if end is None else min(end, self.end_sample)
        return self._gather(first, end, slice(None), len(self.channel_names))

    def window(
        self,
        start: float | None = None,
        end: float | None = None,
        channels: Sequence[str] | None = None,
    ) -> Samples:
        """The samples at times in [start, end) s that the recording holds, in memory.

        The columns are ``channels`` in this order (default: all); each value takes 8 bytes. ``blocks`` gives
        the same block by block. Raises UsageError on an unknown channel or a time that is not finite,
        GearboxError if samples are missing.
        """
        first, end_sample = self.clip(start, end)
        names, columns = self.columns(channels)
        rows = self._gather(first, end_sample, columns, len(names))
        return Samples(first, self.parameters.solver.sample_interval, names, rows)

    def blocks(
        self,
        start: float | None = None,
        end: float | None = None,
        channels: Sequence[str] | None = None,
        rows: int = BLOCK_SAMPLES,
    ) -> Iterator[Samples]:
        """The samples of ``window`` in blocks of at least ``rows`` samples; the last may be shorter."""
        return self.pieces(*self.clip(start, end), channels, rows)

    def pieces(
        self, first: int, end: int, channels: Sequence[str] | None = None, rows: int = BLOCK_SAMPLES
    ) -> Iterator[Samples]:
        """``blocks`` of the samples ``first`` to before ``end``; the recording must hold them."""
        names, columns = self.columns(channels)
        interval = self.parameters.solver.sample_interval
        waiting: list[NDArray[np.float64]] = []
        held = 0
        for _, samples in self.chunks(first, end) if first < end else ():
            waiting.append(samples[:, columns])
            held += len(samples)
            if held >= rows:
                yield Samples(first, interval, names, np.concatenate(waiting))
                first, waiting, held = first + held, [], 0
        if waiting:
            yield Samples(first, interval, names, np.concatenate(waiting))

    def impacts(self, start: float | None = None, end: float | None = None) -> NDArray[np.void]:
        """Bearing contacts that ended at times in [start, end) s: structured (n,), fields as IMPACTS.

        Raises GearboxError at a damaged message.
        """
        low, high = -math.inf if start is None else start, math.inf if end is None else end
        selected = [np.empty(0, IMPACT)]
        for _, rows in self.rows("impacts"):
            impacts = np.ascontiguousarray(rows).view(IMPACT)[:, 0]
            selected.append(impacts[(impacts["end"] >= low) & (impacts["end"] < high)])
        return np.concatenate(selected)

    def chunks(
        self, first: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Index of the first sample, and samples (n, channels), of each chunk in [first, end), in order.

        Only the samples in [first, end) are given. Raises GearboxError if samples are missing or doubled.
        """
        low = self.first_sample if first is None else max(first, self.first_sample)
        high = self.end_sample if end is None else min(end, self.end_sample)
        expected, started = low, False
        for time_ns, samples in self._waveform(None if first is None else self.stamp_of(low)):
            begin = self.sample_of(time_ns) - len(samples) + 1
            if begin > expected or (started and begin < expected):
                self._refuse_break(expected, begin)
            expected, started = begin + len(samples), True
            skip, stop = max(low - begin, 0), min(high - begin, len(samples))
            if skip < stop:
                yield begin + skip, samples[skip:stop]
            if high <= expected < self.end_sample:
                return
        if expected < high:
            self._refuse_break(expected, high)

    def _refuse_break(self, expected: int, found: int) -> None:
        """Raise GearboxError: sample ``found`` follows where ``expected`` should."""
        if found < expected:
            raise GearboxError(f"{self.path}: sample {expected} should follow, but sample {found} does")
        missing = SampleRange(expected, found).text(self.sample_interval_ns)
        raise GearboxError(
            f"{self.path}: the samples {missing} are missing: choose a time before or behind them"
        )

    def rows(self, topic: str) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Stamp in ns and rows (n, columns) of each message on ``topic`` (key in TOPICS), one with rows."""
        decoder = self.decoder()
        for message in self._messages(topic):
            yield message.time_ns, decoder.rows(topic, message.time_ns, message.data)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Stamp in ns and content of each message on ``topic`` (key in TOPICS), fields as in ROS."""
        decoder = self.decoder()
        for message in self._messages(topic):
            yield message.time_ns, decoder.message(topic, message.time_ns, message.data)

    def sample_of(self, time_ns: int) -> int:
        """Index of the sample with the stamp ``time_ns``. Raises GearboxError if no sample has it."""
        sample, rest = divmod(time_ns - self.epoch_ns, self.sample_interval_ns)
        if rest:
            raise GearboxError(f"{self.path}: no sample has the time {time_ns} ns")
        return sample

    def stamp_of(self, sample: int) -> int:
        """Stamp of a sample in ns."""
        return self.epoch_ns + sample * self.sample_interval_ns

    def require_window(self, start: float | None, end: float | None) -> tuple[int, int]:
        """As ``clip``, but raises UsageError if the requested window holds no sample."""
        first, end_sample = self.clip(start, end)
        if first < end_sample or (start is None and end is None):
            return first, end_sample
        if start is not None and end is not None and start >= end:
            raise UsageError(f"from {start:.9g} s to {end:.9g} s is empty: let it end after it starts")
        interval = self.parameters.solver.sample_interval
        asked = " ".join(
            f"{word} {time:.9g} s" for word, time in (("from", start), ("to", end)) if time is not None
        )
        raise UsageError(
            f"{self.path} has no sample {asked}: "
            f"take from {self.first_sample * interval:.9g} s to {self.end_sample * interval:.9g} s"
        )

    def clip(self, start: float | None, end: float | None) -> tuple[int, int]:
        """First and end of the recorded samples at times in [start, end) s; equal if there are none.

        Raises UsageError on a time that is not finite.
        """
        first = self.first_sample if start is None else max(self.sample_at(start), self.first_sample)
        end_sample = self.end_sample if end is None else min(self.sample_at(end), self.end_sample)
        return first, max(first, end_sample)

    def sample_at(self, time: float) -> int:
        """Index of the first sample at or after ``time`` s. Raises UsageError if it is not finite."""
        if not math.isfinite(time):
            raise UsageError(f"the time {time} s is not finite: give a number of seconds")
        # The time of a sample, as a rounded double, must give that sample, even days after the start.
        return math.ceil(round(time * 1e9 / self.sample_interval_ns, 4))

    def columns(self, channels: Sequence[str] | None) -> tuple[tuple[str, ...], list[int] | slice]:
        """Names of ``channels`` (default: all), and their columns in a row of the waveform.

        Raises UsageError on an unknown channel.
        """
        known = self.channel_names
        if channels is None:
            return known, slice(None)
        for name in channels:
            if name not in known:
                raise UsageError(f"there is no channel '{name}' in {self.path}: it has {', '.join(known)}")
        return tuple(channels), [known.index(name) for name in channels]

    def _gather(self, first: int, end: int, columns: list[int] | slice, width: int) -> NDArray[np.float64]:
        rows = np.empty((max(end - first, 0), width))
        if len(rows):
            for sample, samples in self.chunks(first, end):
                rows[sample - first : sample - first + len(samples)] = samples[:, columns]
        return rows

    def without_repeated(
        self, number: int, topic: str, messages: Iterable[StoredMessage]
    ) -> Iterator[StoredMessage]:
        """Those of ``messages`` of part ``number`` that are on the latched ``topic`` (key in TOPICS).

        Leaves out the first one if it repeats the last one of the part before.
        """
        name = self.topic_names[topic]
        previous = self.parts[number - 1].last_message(name) if number else None
        on_topic = (message for message in messages if message.topic == name)
        for position, message in enumerate(on_topic):
            if position or previous is None or message.data != previous.data:
                yield message

    def _waveform(self, from_ns: int | None) -> Iterator[tuple[int, NDArray[np.float64]]]:
        decoder = self.decoder()
        for message in self._messages("waveform", from_ns):
            yield message.time_ns, decoder.rows("waveform", message.time_ns, message.data)

    def _messages(self, topic: str, from_ns: int | None = None) -> Iterator[StoredMessage]:
        for part in self.parts:
            yield from part.messages([self.topic_names[topic]], from_ns)

    def _latched(self, topic: str) -> Iterator[tuple[int, memoryview]]:
        for number, part in enumerate(self.parts):
            for message in self.without_repeated(number, topic, part.messages([self.topic_names[topic]])):
                yield message.time_ns, message.data

    def _find_samples(self) -> tuple[int, int]:
        earliest = next(self._waveform(None), None)
        if earliest is None:
            return self.start.sample, self.start.sample
        time_ns, samples = earliest
        latest = (part.last_message(self.topic_names["waveform"]) for part in reversed(self.parts))
        last_ns = next((message.time_ns for message in latest if message is not None), time_ns)
        return self.sample_of(time_ns) - len(samples) + 1, self.sample_of(last_ns) + 1


def open(path: str | Path) -> Recording:
    """The recording at ``path``: a rosbag2 folder or one MCAP file, complete or broken off.

    ``coverage`` says what is missing. Raises UsageError if there is none, GearboxError if it was not recorded
    by this package, is damaged or mixes parts of several runs.
    """
    path = Path(path)
    parts = ordered(open_parts(path))
    try:
        return Recording(path, parts, parse_parameters(parts[0].parameters))
    except UsageError as error:
        raise GearboxError(f"{parts[0].path}: {layout.PARAMETERS_ATTACHMENT}: {error}") from error
