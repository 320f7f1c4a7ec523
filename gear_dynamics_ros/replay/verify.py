"""Re-simulate a recording with all that was done to it, and compare every bit that a run makes.

A recording is cut at its checkpoints into stretches, run side by side. Nothing stored is taken on trust: each
stretch must arrive at exactly the state, and the parameters, from which the next one starts.
"""

from __future__ import annotations

import os
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from threading import Event as Flag
from threading import Lock
from typing import Final, NamedTuple, TypeAlias, TypeVar

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE
from gear_dynamics_ros.messages.decoder import changes_meant
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import change_values, parse
from gear_dynamics_ros.realtime.mailbox import RELEASED
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.parts import Stored
from gear_dynamics_ros.recording.reader import Event, RecordedChunk, Recording
from gear_dynamics_ros.replay.fidelity import (
    Difference,
    State,
    compare_event,
    compare_message,
    compare_state,
)
from gear_dynamics_ros.simulation import checkpoints, provenance
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import Origin
from gear_dynamics_ros.topics import OF_A_CHUNK

T = TypeVar("T")
# Stretches for each processor: when one is done early, there is another.
SHARES: Final = 4
_START: Final = (layout.PARAMETERS_ATTACHMENT, layout.START_ATTACHMENT)
# The waveform tells more than what is taken from it.
TELLING: Final = ("waveform", *(topic for topic in OF_A_CHUNK if topic != "waveform"))


class Asked(NamedTuple):
    """What a message on a command topic asked for."""

    topic: str  # key in TOPICS
    changes: Mapping[str, float]  # by field of Commands


Action: TypeAlias = tuple[int, Event | Commands | Asked]


class Verification(NamedTuple):
    """What a re-simulation found."""

    samples: int  # compared
    messages: int  # compared
    states: int  # compared
    simulated: float  # s
    elapsed: float  # s of wall time, compilation included
    difference: Difference | None


class _Place(NamedTuple):
    """Where a state is stored."""

    part: int
    names: tuple[str, ...]  # of the attachments


class _Leg(NamedTuple):
    """The way from one stored state to the next."""

    first: int  # sample
    start: _Place
    actions: Sequence[Action]
    told: Sequence[Stored]  # what no chunk made
    end: int | None  # sample before which the next leg begins in the same part
    goals: tuple[_Place, ...]  # none where the recording broke off


class _Tally(NamedTuple):
    samples: int = 0
    messages: int = 0
    states: int = 0
    difference: Difference | None = None
    untold: Difference | None = None  # the first digest that does not fit what the recording tells


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
    stop = Flag()
    count = _Counter(progress)
    found = _Tally()
    processors = len(os.sched_getaffinity(0))
    # The kernel works without Python's lock: threads share the processors and all that is loaded.
    with ThreadPoolExecutor(processors, thread_name_prefix="verify") as workers:
        futures = [
            workers.submit(_run, recording, stretch, stop, count)
            for stretch in _stretches(legs, processors * SHARES)
        ]
        try:
            for future in futures:
                found = _sum(found, future.result())
                if found.difference is not None:
                    break
        finally:
            stop.set()
    # Where the model parts from the recording tells most.
    difference = (
        found.difference or _lack(recording, legs) or _surplus(recording, legs, found) or found.untold
    )
    simulated = found.samples * recording.sample_interval_ns / 1e9
    elapsed = time.perf_counter() - began
    return Verification(found.samples, found.messages, found.states, simulated, elapsed, difference)


def origins(recording: Recording) -> list[str]:
    """What of the program and the machine differs between the recording and this process, a line each."""
    run = recording.run._asdict()
    return provenance.differences(Origin(**{name: run[name] for name in Origin._fields}))


class _Counter:
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
    for name in recording.lost_files:
        gone = not (recording.path / name).exists()
        what = "is missing: put it back" if gone else "has lost its start: replay recover keeps what is whole"
        raise GearboxError(f"{recording.path}: metadata.yaml lists {name}, which {what}")
    if not any(part.found.chunks or part.end for part in recording.parts):
        raise GearboxError(
            f"{recording.path} broke off before its first message: there is nothing to compare"
        )
    if "waveform" not in recording.recorded:
        raise GearboxError(
            f"{recording.path} holds no waveform to compare: add waveform to recording.topics when recording"
        )


def _lack(recording: Recording, legs: Sequence[_Leg]) -> Difference | None:
    """A channel or a repeated message that should be there."""
    first = legs[0].start.part
    for number, part in enumerate(recording.parts[first:], first):
        if not part.found.chunks:  # it broke off before its first message
            continue
        for topic in recording.lacking(number):
            return Difference(part.first_sample, topic, "no channel", "one in recording.topics")
        topic = recording.unrepeated(number) if number > first else ""
        if topic:
            return Difference(part.first_sample, topic, "another first message", "the last one before")
    return None


def _surplus(recording: Recording, legs: Sequence[_Leg], found: _Tally) -> Difference | None:
    """Messages of chunks that stand where no chunk has them; the end of what broke off may hold some."""
    whole = all(part.end for part in recording.parts) and legs[0].start == _Place(0, _START)
    count = recording.count(OF_A_CHUNK)
    if whole and count != found.messages:
        return Difference(recording.end_sample, "messages of chunks", count, found.messages)
    return None


def _legs(recording: Recording, start: float | None) -> list[_Leg]:
    """The whole recording, leg by leg, or from the last state stored before ``start`` s on."""
    parts = recording.parts
    number, sample = (0, parts[0].first_sample) if start is None else _last_before(recording, start)
    legs = [leg for later in range(number, len(parts)) for leg in _legs_of(recording, later)]
    return [leg for leg in legs if leg.first >= sample]


def _last_before(recording: Recording, start: float) -> tuple[int, int]:
    """Part and sample of the last state stored before ``start`` s."""
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
    told = recording.told(number)
    _require_order(recording, number, told)
    actions = _actions(recording, number, told)
    states = {part.first_sample: _Place(number, _START)}
    for sample, name in part.checkpoints.items():
        states[sample] = _Place(number, (name,))
    for first, end in zip(states, [*list(states)[1:], None], strict=True):
        goals = _goals(recording, number) if end is None else (states[end],)
        acted = _cut(actions, first, end, key=lambda action: action[0])
        # At the start of a part nothing precedes the state: all from its first message on follows.
        from_ns = None if states[first].names == _START else recording.time_ns(first)
        end_ns = None if end is None else recording.time_ns(end)
        on_the_way = _cut(told, from_ns, end_ns, key=lambda message: message.time_ns)
        yield _Leg(first, states[first], acted, on_the_way, end, goals)


def _cut(found: list[T], first: int | None, end: int | None, key: Callable[[T], int]) -> list[T]:
    """Of what is in order by ``key``, that in [first, end)."""
    low = 0 if first is None else bisect_left(found, first, key=key)
    high = len(found) if end is None else bisect_left(found, end, key=key)
    return found[low:high]


def _require_order(recording: Recording, number: int, told: Sequence[Stored]) -> None:
    """Raise GearboxError where a part is of another run, tells a state twice or goes back in time."""
    part = recording.parts[number]
    if part.run != recording.run:
        raise GearboxError(f"{part.path} is of another run than {recording.parts[0].path.name}")
    names = Counter(index.name for index in part.found.attachments)
    names[layout.checkpoint_name(part.first_sample)] += 1
    for name, count in names.items():
        if count > 1:
            raise GearboxError(f"{part.path} holds {name} twice, or beside the start: one of them is wrong")
    for earlier, later in pairwise(told):
        if later.time_ns < earlier.time_ns:
            raise GearboxError(f"{part.path} goes back in time with a message on {later.topic}")


def _actions(recording: Recording, number: int, told: Sequence[Stored]) -> list[Action]:
    """What acted in a part and, behind it, what was asked for at the same sample."""
    prefix = recording.parameters.joint_prefix
    asked = [
        (sample, Asked(topic, changes_meant(topic, message, prefix)[0]))
        for sample, topic, message in recording.received(told)
    ]
    return sorted([*recording.actions(number, told), *asked], key=lambda action: action[0])


def _goals(recording: Recording, number: int) -> tuple[_Place, ...]:
    """The states at the end of a part: its own, if it was concluded, and that of the next one's start."""
    end = recording.parts[number].end
    own = (_Place(number, (end,)),) if end else ()
    return own if number + 1 == len(recording.parts) else (*own, _Place(number + 1, _START))


def _load(recording: Recording, place: _Place) -> State:
    part = recording.parts[place.part]
    if place.names == _START:
        return State(part.start, parse(part.parameters))
    (name,) = place.names
    try:
        saved = checkpoints.from_text(part.attachment(name).decode(), f"{part.path.name}: {name}")
    except (UnicodeDecodeError, UsageError) as error:
        raise GearboxError(str(error)) from error
    return State(saved.checkpoint, saved.parameters, saved.history)


def _stretches(legs: Sequence[_Leg], most: int) -> list[list[_Leg]]:
    """The legs in order, gathered into at most ``most`` stretches of about the same length."""
    first, last = legs[0].first, legs[-1].first
    stretches: list[list[_Leg]] = [[] for _ in range(most)]
    for leg in legs:
        stretches[(leg.first - first) * most // (last - first + 1)].append(leg)
    return [stretch for stretch in stretches if stretch]


def _run(recording: Recording, legs: Sequence[_Leg], stop: Flag, count: _Counter) -> _Tally:
    """Run a stretch from the state at its start."""
    start = _load(recording, legs[0].start)
    engine = Engine(start.parameters)
    engine.restore(start.checkpoint)
    engine.command(engine.commands)  # which are part of the state too, and must be the same there
    found = _Tally(difference=compare_state(engine, start))
    if found.difference is not None:
        return found
    encoder = Encoder(start.parameters, recording.epoch_ns)
    for leg in legs:
        found = _sum(found, _run_leg(engine, encoder, recording, leg, stop, count))
        if found.difference is not None or stop.is_set():
            break
    return found


def _run_leg(
    engine: Engine, encoder: Encoder, recording: Recording, leg: _Leg, stop: Flag, count: _Counter
) -> _Tally:
    actions = deque(leg.actions)
    kept = recording.recorded
    samples = messages = 0
    for recorded in recording.recorded_chunks(leg.start.part, leg.first, leg.end):
        if stop.is_set():
            return _Tally(samples, messages)
        difference = _act(engine, actions, recorded.first) or _compare_chunk(engine, encoder, kept, recorded)
        if difference is not None:
            return _Tally(samples, messages, difference=difference)
        samples += recorded.samples
        messages += len(recorded.messages)
        count.add(recorded.samples)
    if leg.end is None:
        difference = _act(engine, actions, None)
    elif actions:
        difference = _misplaced(engine, *actions[0])
    else:
        difference = None
    if difference is not None:
        return _Tally(samples, messages, difference=difference)
    return _sum(_Tally(samples, messages), _arrive(engine, recording, leg))


def _arrive(engine: Engine, recording: Recording, leg: _Leg) -> _Tally:
    """Compare where the engine has come, and what was told on the way, with what was stored there."""
    part, opening = leg.start
    untold = None
    for goal in leg.goals:
        stored = _load(recording, goal)
        difference = compare_state(engine, stored)
        if difference is not None:
            return _Tally(states=1, difference=difference)
        if goal.part == part:
            told = recording.history(part, opening, leg.told)
            what = f"the state at sample {leg.first}, or messages since then that no chunk makes: SHA-256"
            untold = Difference(engine.sample, what, stored.history, told) if told != stored.history else None
    return _Tally(states=len(leg.goals), untold=untold)


def _act(engine: Engine, actions: deque[Action], sample: int | None) -> Difference | None:
    """Let act what came before ``sample`` was made; all that is left if it is None.

    Each must act at the very sample that has come. The last that was asked of each command must then be in
    force.
    """
    if sample is not None and engine.sample != sample:
        return Difference(engine.sample, "waveform", f"nothing before sample {sample}", "samples")
    asked: dict[str, tuple[str, float]] = {}
    while actions and (sample is None or actions[0][0] <= sample):
        at, action = actions.popleft()
        if at != engine.sample:
            return _misplaced(engine, at, action)
        if isinstance(action, Commands):
            engine.command(action)
        elif isinstance(action, Asked):
            asked |= {name: (action.topic, value) for name, value in action.changes.items()}
        else:
            _repeat(engine, action)
            difference = compare_event(engine, action)
            if difference is not None:
                return difference
    for name, (topic, value) in asked.items():
        in_force = getattr(engine.commands, name)
        if value != in_force and not _released(engine, name):
            return Difference(engine.sample, f"{topic}: {name}", value, in_force)
    return None


def _misplaced(engine: Engine, sample: int, action: Event | Commands | Asked) -> Difference:
    """Of what should have acted where no chunk begins."""
    kind = type(action).__name__.lower()
    what = f"event {action.kind}" if isinstance(action, Event) else kind
    return Difference(engine.sample, what, f"at sample {sample}", "no edge of a chunk there")


def _released(engine: Engine, name: str) -> bool:
    """Whether a command may be 0 because none came in time."""
    operation = engine.parameters.operation
    released = operation.command_timeout > 0.0 and operation.on_timeout == "release"
    return released and name in RELEASED and getattr(engine.commands, name) == 0.0


def _repeat(engine: Engine, event: Event) -> None:
    if event.kind == RESET:
        engine.reset()
    elif event.kind == CHANGE:
        try:
            engine.change(change_values(engine.parameters, event.parameters))
        except UsageError as error:
            raise GearboxError(
                f"the change of parameters at sample {event.sample} can't be: {error}"
            ) from error
    elif event.kind == RESTORE:
        engine.resume(event.checkpoint)


def _compare_chunk(
    engine: Engine, encoder: Encoder, kept: frozenset[str], recorded: RecordedChunk
) -> Difference | None:
    """Make the chunk, and compare its messages on the topics ``kept``."""
    try:
        chunk = engine.advance(recorded.samples)
    except GearboxError as error:
        return Difference(recorded.first, "waveform", f"{recorded.samples} samples", f"none: {error}")
    made = {record.topic: record.data for record in encoder.chunk(chunk) if record.topic in kept}
    for topic in TELLING:
        difference = compare_message(recorded, topic, made.get(topic))
        if difference is not None:
            return difference
    return None


def _sum(left: _Tally, right: _Tally) -> _Tally:
    return _Tally(
        left.samples + right.samples,
        left.messages + right.messages,
        left.states + right.states,
        right.difference,
        left.untold or right.untold,
    )
