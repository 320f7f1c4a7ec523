"""Re-simulate a recording with all that was done to it, and compare every bit that a run makes.

A recording is cut at its checkpoints into stretches, run side by side. Nothing stored is taken on trust: each
stretch must arrive at exactly the state, and the parameters, from which the next one starts.
"""

from __future__ import annotations

import os
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event as Flag
from threading import Lock
from typing import Final, NamedTuple, TypeVar

import yaml

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.parts import StoredMessage
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.replay.mismatch import Mismatch
from gear_dynamics_ros.replay.part_reader import Action, PartReader
from gear_dynamics_ros.replay.resimulation import Resimulation
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.simulation.provenance import provenance_differences
from gear_dynamics_ros.topics import OF_A_CHUNK

T = TypeVar("T")
# Stretches for each processor: when one is done early, there is another.
SHARES: Final = 4
_START: Final = (layout.PARAMETERS_ATTACHMENT, layout.START_ATTACHMENT)


class Verification(NamedTuple):
    """What a re-simulation found."""

    samples: int  # compared
    messages: int  # compared
    states: int  # compared
    simulated: float  # s
    elapsed: float  # s of wall time, compilation included
    difference: Mismatch | None


class _Place(NamedTuple):
    """Where a checkpoint is stored."""

    part: int
    names: tuple[str, ...]  # of the attachments


class _Leg(NamedTuple):
    """The way from one stored checkpoint to the next."""

    first: int  # sample
    start: _Place
    reader: PartReader
    actions: Sequence[Action]
    told: Sequence[StoredMessage]  # what no chunk made
    end: int | None  # sample before which the next leg begins in the same part
    goals: tuple[_Place, ...]  # none where the recording broke off


class _Findings(NamedTuple):
    samples: int = 0
    messages: int = 0
    states: int = 0
    difference: Mismatch | None = None
    untold: Mismatch | None = None  # the first digest that does not fit what the recording tells

    def plus(self, more: _Findings) -> _Findings:
        """Those of both, the later ones being ``more``."""
        return _Findings(
            self.samples + more.samples,
            self.messages + more.messages,
            self.states + more.states,
            more.difference,
            self.untold or more.untold,
        )


def verify_recording(
    recording: Recording,
    start: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Verification:
    """Run the model again from the recording's start, or from the last state stored before ``start`` s.

    Commands, changes of parameters, restored checkpoints and resets act at their samples. Every message that
    a chunk makes, the waveform above all, and every stored state on the way must come out to the same bytes.
    ``progress`` is called with the number of samples compared so far.

    Raises UsageError if the recording does not hold ``start``, GearboxError where it can't be read on or
    lacks the waveform.
    """
    began = time.perf_counter()
    _require_whole(recording)
    legs = _legs(recording, start)
    found = _run_side_by_side(recording, legs, _SampleCount(progress))
    # Where the model parts from the recording tells most.
    difference = (
        found.difference or _missing(recording, legs) or _surplus(recording, legs, found) or found.untold
    )
    simulated = found.samples * recording.sample_interval_ns / 1e9
    elapsed = time.perf_counter() - began
    return Verification(found.samples, found.messages, found.states, simulated, elapsed, difference)


def origins(recording: Recording) -> list[str]:
    """What of the program and the machine differs between the recording and this process, a line each."""
    return provenance_differences(recording.run.provenance)


class _SampleCount:
    """Adds up what several threads have compared."""

    def __init__(self, tell: Callable[[int], None] | None) -> None:
        self._tell = tell
        self._lock = Lock()
        self._samples = 0

    def add(self, samples: int) -> None:
        """So many more."""
        with self._lock:
            self._samples += samples
            if self._tell is not None:
                self._tell(self._samples)


def _require_whole(recording: Recording) -> None:
    """Raise GearboxError where a file is lost, or nothing can be compared."""
    for name in _lost_files(recording):
        gone = not (recording.path / name).exists()
        what = "is missing: put it back" if gone else "has lost its start: replay recover keeps what is whole"
        raise GearboxError(f"{recording.path}: metadata.yaml lists {name}, which {what}")
    if not any(part.index.chunks or part.end for part in recording.parts):
        raise GearboxError(
            f"{recording.path} broke off before its first message: there is nothing to compare"
        )
    if "waveform" not in recording.recorded:
        raise GearboxError(
            f"{recording.path} holds no waveform to compare: add waveform to recording.topics when recording"
        )


def _lost_files(recording: Recording) -> list[str]:
    """Names of the files that metadata.yaml lists and that are no part: missing, or without a start."""
    path = recording.path / layout.METADATA_FILE
    if not path.is_file():
        return []
    try:
        listed = yaml.safe_load(path.read_text(encoding="utf-8"))[layout.INFORMATION][layout.FILES]
        return sorted({str(name) for name in listed} - {part.path.name for part in recording.parts})
    except (KeyError, OSError, TypeError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise GearboxError(f"{path} is spoilt: {' '.join(repr(error).split()):.200}") from error


def _missing(recording: Recording, legs: Sequence[_Leg]) -> Mismatch | None:
    """Parameters that are not those of the start; a channel or a repeated message that should be there."""
    first = legs[0].start.part
    for number, part in enumerate(recording.parts[first:], first):
        reader = PartReader(recording, number)
        for name in reader.unlike_parameters():
            what = f"{layout.PARAMETERS_ATTACHMENT}: {name}"
            return Mismatch(part.first_sample, what, "one value", f"another in {layout.START_ATTACHMENT}")
        if not part.index.chunks:  # it broke off before its first message
            continue
        for topic in reader.lacking():
            return Mismatch(part.first_sample, topic, "no channel", "one in recording.topics")
        topic = reader.unrepeated() if number > first else ""
        if topic:
            return Mismatch(part.first_sample, topic, "another first message", "the last one before")
    return None


def _surplus(recording: Recording, legs: Sequence[_Leg], found: _Findings) -> Mismatch | None:
    """Messages of chunks that stand where no chunk has them; the end of what broke off may hold some."""
    whole = all(part.end for part in recording.parts) and legs[0].start == _Place(0, _START)
    names = {recording.topic_names[key] for key in OF_A_CHUNK}
    count = sum(topic.messages for topic in recording.topics if topic.name in names)
    if whole and count != found.messages:
        return Mismatch(recording.end_sample, "messages of chunks", count, found.messages)
    return None


def _legs(recording: Recording, start: float | None) -> list[_Leg]:
    """The whole recording, leg by leg, or from the last checkpoint stored before ``start`` s on."""
    parts = recording.parts
    number, sample = (0, parts[0].first_sample) if start is None else _last_before(recording, start)
    legs = [leg for later in range(number, len(parts)) for leg in _legs_of(recording, later)]
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


def _legs_of(recording: Recording, number: int) -> Iterator[_Leg]:
    """One part, leg by leg."""
    part = recording.parts[number]
    reader = PartReader(recording, number)
    reader.require_order()
    actions = reader.actions()
    places = {part.first_sample: _Place(number, _START)}
    for sample, name in part.checkpoints.items():
        places[sample] = _Place(number, (name,))
    for first, end in zip(places, [*list(places)[1:], None], strict=True):
        goals = _goals(recording, number) if end is None else (places[end],)
        acted = _cut(actions, first, end, key=lambda action: action[0])
        # At the start of a part nothing precedes the state: all from its first message on follows.
        from_ns = None if places[first].names == _START else recording.stamp_of(first)
        end_ns = None if end is None else recording.stamp_of(end)
        on_the_way = _cut(reader.told, from_ns, end_ns, key=lambda message: message.time_ns)
        yield _Leg(first, places[first], reader, acted, on_the_way, end, goals)


def _cut(found: Sequence[T], first: int | None, end: int | None, key: Callable[[T], int]) -> Sequence[T]:
    """Of what is in order by ``key``, that in [first, end)."""
    low = 0 if first is None else bisect_left(found, first, key=key)
    high = len(found) if end is None else bisect_left(found, end, key=key)
    return found[low:high]


def _goals(recording: Recording, number: int) -> tuple[_Place, ...]:
    """The checkpoints at the end of a part: its own, if it was concluded, and the start of the next one."""
    end = recording.parts[number].end
    own = (_Place(number, (end,)),) if end else ()
    return own if number + 1 == len(recording.parts) else (*own, _Place(number + 1, _START))


def _load(recording: Recording, place: _Place) -> StoredCheckpoint:
    part = recording.parts[place.part]
    return part.start if place.names == _START else part.stored(*place.names)


def _run_side_by_side(recording: Recording, legs: Sequence[_Leg], count: _SampleCount) -> _Findings:
    """Run all legs, several stretches at a time, up to the first difference."""
    stop = Flag()
    found = _Findings()
    processors = len(os.sched_getaffinity(0))
    # The kernel works without Python's lock: threads share the processors and all that is loaded.
    with ThreadPoolExecutor(processors, thread_name_prefix="verify") as workers:
        futures = [
            workers.submit(_run, recording, stretch, stop, count)
            for stretch in _stretches(legs, processors * SHARES)
        ]
        try:
            for future in futures:
                found = found.plus(future.result())
                if found.difference is not None:
                    break
        finally:
            stop.set()
    return found


def _stretches(legs: Sequence[_Leg], most: int) -> list[list[_Leg]]:
    """The legs in order, gathered into at most ``most`` stretches of about the same length."""
    first, last = legs[0].first, legs[-1].first
    stretches: list[list[_Leg]] = [[] for _ in range(most)]
    for leg in legs:
        stretches[(leg.first - first) * most // (last - first + 1)].append(leg)
    return [stretch for stretch in stretches if stretch]


def _run(recording: Recording, legs: Sequence[_Leg], stop: Flag, count: _SampleCount) -> _Findings:
    """Run a stretch from the checkpoint at its start."""
    start = _load(recording, legs[0].start).checkpoint
    again = Resimulation(start, recording.epoch_ns, recording.recorded)
    found = _Findings(difference=again.compare_state(start))
    for leg in legs:
        if found.difference is not None or stop.is_set():
            break
        found = found.plus(_run_leg(again, recording, leg, stop, count))
    return found


def _run_leg(
    again: Resimulation, recording: Recording, leg: _Leg, stop: Flag, count: _SampleCount
) -> _Findings:
    actions = deque(leg.actions)
    samples = messages = 0
    for recorded in leg.reader.chunks(leg.first, leg.end):
        if stop.is_set():
            return _Findings(samples, messages)
        difference = again.act_before(actions, recorded.first) or again.compare_chunk(recorded)
        if difference is not None:
            return _Findings(samples, messages, difference=difference)
        samples += recorded.samples
        messages += len(recorded.messages)
        count.add(recorded.samples)
    difference = _finish(again, actions, leg)
    if difference is not None:
        return _Findings(samples, messages, difference=difference)
    return _Findings(samples, messages).plus(_arrive(again, recording, leg))


def _finish(again: Resimulation, actions: deque[Action], leg: _Leg) -> Mismatch | None:
    """Let act what follows the last chunk of a part; within a part that belongs to the next leg."""
    if leg.end is None:
        return again.act(actions)
    return again.misplaced(*actions[0]) if actions else None


def _arrive(again: Resimulation, recording: Recording, leg: _Leg) -> _Findings:
    """Compare where the engine has come, and what was told on the way, with what was stored there."""
    part, opening = leg.start
    untold = None
    for goal in leg.goals:
        stored = _load(recording, goal)
        difference = again.compare_state(stored.checkpoint)
        if difference is not None:
            return _Findings(states=1, difference=difference)
        told = leg.reader.digest(opening, leg.told) if goal.part == part else stored.digest
        if told != stored.digest:
            what = f"the state at sample {leg.first}, or messages since then that no chunk makes: SHA-256"
            untold = Mismatch(again.sample, what, stored.digest, told)
    return _Findings(states=len(leg.goals), untold=untold)
