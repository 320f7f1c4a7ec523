"""Computes a recorded run again, with everything that acted on it, and compares every bit.

The recording is divided at its checkpoints into sections that run in parallel. No stored value is trusted:
each section must end in exactly the state, and with the parameters, from which the next one starts.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event as Flag
from threading import Lock
from typing import Final, NamedTuple, TypeVar

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.parts import StoredMessage
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.replay.mismatch import Mismatch
from gear_dynamics_ros.replay.part_reader import Action, PartReader
from gear_dynamics_ros.replay.resimulation import Resimulation
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.system.threads import processor_count
from gear_dynamics_ros.topics import CHUNK_TOPICS

T = TypeVar("T")
# More sections than processors, so that no processor waits long for the last ones.
SECTIONS_PER_PROCESSOR: Final = 4
_START_ATTACHMENTS: Final = (layout.PARAMETERS_ATTACHMENT, layout.START_ATTACHMENT)


class Verification(NamedTuple):
    """Result of a re-simulation."""

    samples: int  # compared
    messages: int  # compared
    states: int  # compared
    simulated: float  # simulated time, s
    elapsed: float  # wall time with compilation, s
    difference: Mismatch | None  # the first one


class _Place(NamedTuple):
    """Where a checkpoint is stored."""

    part: int
    names: tuple[str, ...]  # of the attachments


class _Leg(NamedTuple):
    """The recording from one stored checkpoint to the next."""

    first: int  # sample
    start: _Place
    reader: PartReader
    actions: Sequence[Action]
    inputs: Sequence[StoredMessage]  # the messages that no chunk made
    end: int | None  # first sample of the next leg in the same part
    goals: tuple[_Place, ...]  # checkpoints to arrive at; none if the recording broke off


class _Findings(NamedTuple):
    """What was compared, and the first differences."""

    samples: int = 0
    messages: int = 0
    states: int = 0
    difference: Mismatch | None = None
    digest_difference: Mismatch | None = None  # the first digest that does not fit the recorded inputs

    def plus(self, later: _Findings) -> _Findings:
        """Both together; there is no difference in ``self`` when ``later`` exists."""
        return _Findings(
            self.samples + later.samples,
            self.messages + later.messages,
            self.states + later.states,
            later.difference,
            self.digest_difference or later.digest_difference,
        )


def verify_recording(
    recording: Recording,
    start: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Verification:
    """Compute the run again from the start of the recording, or from the last checkpoint before ``start`` s.

    Commands, changes of parameters, restored checkpoints and resets act at their recorded samples. Every
    message that a chunk makes, such as the waveform, and every stored checkpoint must have the same bytes.
    ``progress`` is called with the number of samples compared so far.

    Raises UsageError if ``start`` lies outside the recording, GearboxError if the recording is damaged or has
    no waveform.
    """
    began = time.perf_counter()
    _require_whole(recording)
    legs = _legs(recording, start)
    findings = _run_in_parallel(recording, legs, _SampleCount(progress))
    # A difference of a computed value says most, so it comes first.
    difference = (
        findings.difference
        or _missing(recording, legs)
        or _surplus(recording, legs, findings)
        or findings.digest_difference
    )
    simulated = findings.samples * recording.sample_interval_ns / 1e9
    elapsed = time.perf_counter() - began
    return Verification(findings.samples, findings.messages, findings.states, simulated, elapsed, difference)


class _SampleCount:
    """Counts the samples that several threads have compared."""

    def __init__(self, progress: Callable[[int], None] | None) -> None:
        self._progress = progress
        self._lock = Lock()
        self._samples = 0

    def add(self, samples: int) -> None:
        """Add ``samples`` and report the total."""
        with self._lock:
            self._samples += samples
            if self._progress is not None:
                self._progress(self._samples)


def _require_whole(recording: Recording) -> None:
    """Raise GearboxError if a file is lost, or there is nothing to compare."""
    for lost in recording.coverage.lost_files:
        raise GearboxError(f"{recording.path}: {lost}")
    if not any(part.index.chunks or part.end for part in recording.parts):
        raise GearboxError(
            f"{recording.path} broke off before its first message: there is nothing to compare"
        )
    if "waveform" not in recording.recorded:
        raise GearboxError(
            f"{recording.path} holds no waveform to compare: add waveform to recording.topics when recording"
        )


def _missing(recording: Recording, legs: Sequence[_Leg]) -> Mismatch | None:
    """The first parameter that differs from the start, missing channel or missing repetition."""
    first = legs[0].start.part
    for number, part in enumerate(recording.parts[first:], first):
        reader = PartReader(recording, number)
        for name in reader.inconsistent_parameters():
            what = f"{layout.PARAMETERS_ATTACHMENT}: {name}"
            return Mismatch(part.first_sample, what, "one value", f"another in {layout.START_ATTACHMENT}")
        if not part.index.chunks:  # it broke off before its first message
            continue
        for topic in reader.missing_topics():
            return Mismatch(part.first_sample, topic, "no channel", "one in recording.topics")
        topic = reader.first_unrepeated_topic() if number > first else ""
        if topic:
            return Mismatch(part.first_sample, topic, "another first message", "the last one before")
    return None


def _surplus(recording: Recording, legs: Sequence[_Leg], findings: _Findings) -> Mismatch | None:
    """Messages on topics of chunks that belong to no chunk. A recording that broke off may end with some."""
    whole = all(part.end for part in recording.parts) and legs[0].start == _Place(0, _START_ATTACHMENTS)
    names = {recording.topic_names[key] for key in CHUNK_TOPICS}
    count = sum(topic.messages for topic in recording.topics if topic.name in names)
    if whole and count != findings.messages:
        return Mismatch(recording.end_sample, "messages of chunks", count, findings.messages)
    return None


def _legs(recording: Recording, start: float | None) -> list[_Leg]:
    """All legs, or those from the last checkpoint before ``start`` s on."""
    parts = recording.parts
    number, sample = (0, parts[0].first_sample) if start is None else _last_before(recording, start)
    legs = [leg for later in range(number, len(parts)) for leg in _legs_of_part(recording, later)]
    return [leg for leg in legs if leg.first >= sample]


def _last_before(recording: Recording, start: float) -> tuple[int, int]:
    """Part and sample of the last checkpoint stored before ``start`` s."""
    interval = recording.sample_interval_ns / 1e9
    begin, end = recording.parts[0].first_sample * interval, recording.end_sample * interval
    if not begin <= start <= end:
        raise UsageError(f"--from {start:g} s lies outside the recording: it holds {begin:g} s to {end:g} s")
    return max(
        (number, sample)
        for number, part in enumerate(recording.parts)
        for sample in (part.first_sample, *part.checkpoints)
        if sample * interval <= start
    )


def _legs_of_part(recording: Recording, number: int) -> Iterator[_Leg]:
    """The legs of part ``number``, in order."""
    part = recording.parts[number]
    reader = PartReader(recording, number)
    reader.require_order()
    actions = reader.actions()
    places = {part.first_sample: _Place(number, _START_ATTACHMENTS)}
    for sample, name in part.checkpoints.items():
        places[sample] = _Place(number, (name,))
    for first, end in zip(places, [*list(places)[1:], None], strict=True):
        goals = _goals(recording, number) if end is None else (places[end],)
        leg_actions = _slice(actions, first, end, key=lambda action: action[0])
        # The first leg of a part has all messages from the start of the file on.
        from_ns = None if places[first].names == _START_ATTACHMENTS else recording.stamp_of(first)
        end_ns = None if end is None else recording.stamp_of(end)
        leg_inputs = _slice(reader.inputs, from_ns, end_ns, key=lambda message: message.time_ns)
        yield _Leg(first, places[first], reader, leg_actions, leg_inputs, end, goals)


def _slice(entries: Sequence[T], first: int | None, end: int | None, key: Callable[[T], int]) -> Sequence[T]:
    """Those of ``entries``, sorted by ``key``, with a key in [first, end); None means without that limit."""
    low = 0 if first is None else bisect_left(entries, first, key=key)
    high = len(entries) if end is None else bisect_left(entries, end, key=key)
    return entries[low:high]


def _goals(recording: Recording, number: int) -> tuple[_Place, ...]:
    """The checkpoints at the end of a part: its own, unless it broke off, and the start of the next part."""
    end = recording.parts[number].end
    own = (_Place(number, (end,)),) if end else ()
    return own if number + 1 == len(recording.parts) else (*own, _Place(number + 1, _START_ATTACHMENTS))


def _load(recording: Recording, place: _Place) -> StoredCheckpoint:
    part = recording.parts[place.part]
    return part.start if place.names == _START_ATTACHMENTS else part.stored(*place.names)


def _run_in_parallel(recording: Recording, legs: Sequence[_Leg], count: _SampleCount) -> _Findings:
    """Run all legs, several sections at a time, up to the first difference."""
    stop = Flag()
    findings = _Findings()
    processors = processor_count()
    # The kernel releases Python's lock (GIL), so threads use all processors.
    with ThreadPoolExecutor(processors, thread_name_prefix="verify") as workers:
        futures = [
            workers.submit(_run_section, recording, section, stop, count)
            for section in _sections(legs, processors * SECTIONS_PER_PROCESSOR)
        ]
        try:
            for future in futures:
                findings = findings.plus(future.result())
                if findings.difference is not None:
                    break
        finally:
            stop.set()
    return findings


def _sections(legs: Sequence[_Leg], most: int) -> list[list[_Leg]]:
    """The legs in order, grouped into at most ``most`` sections of similar length."""
    first, last = legs[0].first, legs[-1].first
    sections: list[list[_Leg]] = [[] for _ in range(most)]
    for leg in legs:
        sections[(leg.first - first) * most // (last - first + 1)].append(leg)
    return [section for section in sections if section]


def _run_section(recording: Recording, legs: Sequence[_Leg], stop: Flag, count: _SampleCount) -> _Findings:
    """Run consecutive legs from the checkpoint at the start of the first."""
    start = _load(recording, legs[0].start).checkpoint
    resimulation = Resimulation(start, recording.epoch_ns, recording.recorded)
    findings = _Findings(difference=resimulation.compare_state(start))
    for leg in legs:
        if findings.difference is not None or stop.is_set():
            break
        findings = findings.plus(_run_leg(resimulation, recording, leg, stop, count))
    return findings


def _run_leg(
    resimulation: Resimulation, recording: Recording, leg: _Leg, stop: Flag, count: _SampleCount
) -> _Findings:
    """Run one leg, chunk by chunk."""
    actions = deque(leg.actions)
    samples = messages = 0
    for recorded in leg.reader.chunks(leg.first, leg.end):
        if stop.is_set():
            return _Findings(samples, messages)
        difference = resimulation.act_before(actions, recorded.first) or resimulation.compare_chunk(recorded)
        if difference is not None:
            return _Findings(samples, messages, difference=difference)
        samples += recorded.samples
        messages += len(recorded.messages)
        count.add(recorded.samples)
    difference = _act_after_last_chunk(resimulation, actions, leg)
    if difference is not None:
        return _Findings(samples, messages, difference=difference)
    return _Findings(samples, messages).plus(_compare_goals(resimulation, recording, leg))


def _act_after_last_chunk(resimulation: Resimulation, actions: deque[Action], leg: _Leg) -> Mismatch | None:
    """Perform the actions after the last chunk of a part. Within a part they belong to the next leg."""
    if leg.end is None:
        return resimulation.act(actions)
    return resimulation.misplaced(*actions[0]) if actions else None


def _compare_goals(resimulation: Resimulation, recording: Recording, leg: _Leg) -> _Findings:
    """Compare the state after a leg, and the digest of its inputs, with the checkpoints stored there."""
    part, opening = leg.start
    digest_difference = None
    for goal in leg.goals:
        stored = _load(recording, goal)
        difference = resimulation.compare_state(stored.checkpoint)
        if difference is not None:
            return _Findings(states=1, difference=difference)
        digest = leg.reader.digest(opening, leg.inputs) if goal.part == part else stored.digest
        if digest != stored.digest:
            what = f"the state at sample {leg.first}, or messages since then that no chunk makes: SHA-256"
            digest_difference = Mismatch(resimulation.sample, what, stored.digest, digest)
    return _Findings(states=len(leg.goals), digest_difference=digest_difference)
