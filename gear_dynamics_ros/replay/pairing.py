"""Two recordings side by side: the samples and channels that both have, and under what each was made."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.events import CHANGE, RESET, RESTORE, OperatorEvent
from gear_dynamics_ros.parameters import differences
from gear_dynamics_ros.recording.reader import Recording

BY_TIME: Final = "time"
BY_START: Final = "start"
ACTING: Final = (RESET, CHANGE, RESTORE)  # events that act on the model


class Ends(NamedTuple):
    """How many samples of a window one recording has before and after those that both have."""

    before: int
    after: int


class CommandDifference(NamedTuple):
    """Commands in force from ``sample`` on, None where a recording tells of none."""

    sample: int
    a: Commands | None
    b: Commands | None


class Pair(NamedTuple):
    """Recordings A and B; sample n of A is compared with sample n + ``shift`` of B.

    Samples are numbered as in A. Those compared are [first, beyond), ``ends`` what A and B have besides.
    """

    a: Recording
    b: Recording
    shift: int
    first: int
    beyond: int
    ends: tuple[Ends, Ends]

    @property
    def interval(self) -> float:
        """Sample interval of both in s."""
        return self.a.parameters.solver.sample_interval

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that both have, in the order of A; not time where it is shifted."""
        theirs = set(self.b.channel_names) - ({"time"} if self.shift else set())
        return tuple(name for name in self.a.channel_names if name in theirs)

    @property
    def lone_channels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Channels that A alone has, and those that B alone has."""
        ours, theirs = self.a.channel_names, self.b.channel_names
        return (
            tuple(name for name in ours if name not in theirs),
            tuple(name for name in theirs if name not in ours),
        )

    def stretches(self, channels: Sequence[str]) -> Iterator[tuple[Samples, Samples]]:
        """The samples compared, from A and from B, piece by piece of the same length.

        Raises GearboxError where one of them is spoilt or has a gap.
        """
        yield from side_by_side(
            self.a.pieces(self.first, self.beyond, channels),
            self.b.pieces(self.first + self.shift, self.beyond + self.shift, channels),
        )

    def parameters(self) -> dict[str, tuple[object, object]]:
        """Parameters at the start that differ, by dotted name: in A, in B."""
        ours = self.a.parameters.to_flat()
        changed = differences(self.a.parameters, self.b.parameters)
        return {name: (ours[name], value) for name, value in changed.items()}

    def commands(self) -> list[CommandDifference]:
        """Where, among the samples compared, commands in force come to differ, or differ otherwise."""
        ours = self.a.commands
        theirs = [(sample - self.shift, values) for sample, values in self.b.commands]
        at = sorted({min(max(n, self.first), self.beyond) for n, _ in ours + theirs} | {self.first})
        found = [
            CommandDifference(n, _in_force(ours, n), _in_force(theirs, n)) for n in at if n < self.beyond
        ]
        return [entry for entry in found if entry.a != entry.b]

    def events(self) -> tuple[list[OperatorEvent], list[OperatorEvent]]:
        """Resets, restores and changes of parameters among the samples compared that A or B alone has."""
        ours, theirs = self._acted(self.a, 0), self._acted(self.b, self.shift)
        return _without(ours, theirs), _without(theirs, ours)

    def _acted(self, recording: Recording, shift: int) -> list[OperatorEvent]:
        shifted = (
            event._replace(sample=event.sample - shift, time=(event.sample - shift) * self.interval)
            for event in recording.events
            if event.kind in ACTING
        )
        return [event for event in shifted if self.first <= event.sample < self.beyond]


def pair(a: Recording, b: Recording, align: str, start: float | None, end: float | None) -> Pair:
    """A and B at times in [start, end) s of A, aligned BY_TIME or BY_START.

    Raises UsageError if their sample intervals differ or nothing is in common.
    """
    if a.sample_interval_ns != b.sample_interval_ns:
        raise UsageError(
            f"solver.sample_interval is {a.parameters.solver.sample_interval:g} s in {a.path} and "
            f"{b.parameters.solver.sample_interval:g} s in {b.path}: "
            "compare recordings made with the same"
        )
    shift = b.first_sample - a.first_sample if align == BY_START else 0
    ours = a.first_sample, a.end_sample
    theirs = b.first_sample - shift, b.end_sample - shift
    (low, high), (other_low, other_high) = (
        (
            first if start is None else max(first, a.sample_at(start)),
            beyond if end is None else min(beyond, a.sample_at(end)),
        )
        for first, beyond in (ours, theirs)
    )
    first, beyond = max(low, other_low), min(high, other_high)
    if first >= beyond:
        raise UsageError(_nothing_shared(a, b, align, start, end))
    ends = tuple(
        Ends(max(first - begin, 0), max(stop - beyond, 0))
        for begin, stop in ((low, high), (other_low, other_high))
    )
    found = Pair(a, b, shift, first, beyond, (ends[0], ends[1]))
    if not found.channels:
        raise UsageError(f"{a.path} and {b.path} have no channel in common but the time")
    return found


def _nothing_shared(a: Recording, b: Recording, align: str, start: float | None, end: float | None) -> str:
    spans = " and ".join(
        f"{bag.path} covers {bag.first_sample * bag.sample_interval_ns / 1e9:.9g} s to "
        f"{bag.end_sample * bag.sample_interval_ns / 1e9:.9g} s"
        for bag in (a, b)
    )
    asked = [f"{word} {time:.9g} s" for word, time in (("from", start), ("to", end)) if time is not None]
    if asked:
        return f"no sample in common {' '.join(asked)}: {spans}: ask for another time"
    remedy = "" if align == BY_START else ": align their starts instead of the time"
    return f"no sample in common: {spans}{remedy}"


def side_by_side(left: Iterator[Samples], right: Iterator[Samples]) -> Iterator[tuple[Samples, Samples]]:
    ours, theirs = next(left, None), next(right, None)
    while ours is not None and theirs is not None:
        count = min(len(ours), len(theirs))
        yield _part(ours, 0, count), _part(theirs, 0, count)
        ours = _part(ours, count, len(ours)) if count < len(ours) else next(left, None)
        theirs = _part(theirs, count, len(theirs)) if count < len(theirs) else next(right, None)


def _part(samples: Samples, begin: int, end: int) -> Samples:
    return Samples(samples.first + begin, samples.interval, samples.names, samples.values[begin:end])


def _in_force(commands: Sequence[tuple[int, Commands]], sample: int) -> Commands | None:
    after = bisect_right(commands, sample, key=lambda command: command[0])
    return commands[after - 1][1] if after else None


def _without(events: Sequence[OperatorEvent], others: Sequence[OperatorEvent]) -> list[OperatorEvent]:
    there = Counter(map(_deed, others))
    left = []
    for event in events:
        if there[_deed(event)]:
            there[_deed(event)] -= 1
        else:
            left.append(event)
    return left


def _deed(event: OperatorEvent) -> str:
    """What an event did and when, to compare by."""
    return json.dumps([event.sample, event.kind, dict(event.parameters), dict(event.checkpoint)])
