"""Pairs two recordings: common samples and channels, differing parameters, commands and events."""

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
COMPARED_EVENTS: Final = (RESET, CHANGE, RESTORE)  # those that act on the model


class ExtraSamples(NamedTuple):
    """Number of samples that one recording has before and after the common ones, within the window."""

    before: int
    after: int


class CommandDifference(NamedTuple):
    """Commands in force from ``sample`` on; None if a recording has none yet."""

    sample: int
    a: Commands | None
    b: Commands | None


class Pair(NamedTuple):
    """Recordings A and B; sample n of A is compared with sample n + ``shift`` of B.

    The samples ``first`` to before ``end`` are compared, numbered as in A. ``extra`` are further samples of A
    and of B.
    """

    a: Recording
    b: Recording
    shift: int
    first: int
    end: int
    extra: tuple[ExtraSamples, ExtraSamples]

    @property
    def interval(self) -> float:
        """Sample interval of both in s."""
        return self.a.parameters.solver.sample_interval

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that both have, in the order of A; without ``time`` if B is shifted."""
        theirs = set(self.b.channel_names) - ({"time"} if self.shift else set())
        return tuple(name for name in self.a.channel_names if name in theirs)

    @property
    def extra_channels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Channels that only A has, and those that only B has."""
        ours, theirs = self.a.channel_names, self.b.channel_names
        return (
            tuple(name for name in ours if name not in theirs),
            tuple(name for name in theirs if name not in ours),
        )

    def blocks(self, channels: Sequence[str]) -> Iterator[tuple[Samples, Samples]]:
        """The common samples of A and of B, in blocks of equal length.

        Raises GearboxError if one of them is damaged or has a gap.
        """
        yield from equal_blocks(
            self.a.pieces(self.first, self.end, channels),
            self.b.pieces(self.first + self.shift, self.end + self.shift, channels),
        )

    def parameters(self) -> dict[str, tuple[object, object]]:
        """Parameters at the start that differ, by dotted name: value in A, value in B."""
        ours = self.a.parameters.to_flat()
        changed = differences(self.a.parameters, self.b.parameters)
        return {name: (ours[name], value) for name, value in changed.items()}

    def commands(self) -> list[CommandDifference]:
        """Commands that differ, from each common sample on at which one of the two changes.

        Raises GearboxError if a recording is damaged.
        """
        ours = self.a.commands
        theirs = [(sample - self.shift, values) for sample, values in self.b.commands]
        inside = {max(sample, self.first) for sample, _ in ours + theirs if sample < self.end}
        changes = [
            CommandDifference(sample, _in_force(ours, sample), _in_force(theirs, sample))
            for sample in sorted(inside | {self.first})
        ]
        return [change for change in changes if change.a != change.b]

    def events(self) -> tuple[list[OperatorEvent], list[OperatorEvent]]:
        """Resets, restores and changes of parameters that only A has, and those that only B has.

        Only those at common samples. Raises GearboxError if a recording is damaged.
        """
        ours, theirs = self._compared_events(self.a, 0), self._compared_events(self.b, self.shift)
        return _without(ours, theirs), _without(theirs, ours)

    def _compared_events(self, recording: Recording, shift: int) -> list[OperatorEvent]:
        shifted = (
            event._replace(sample=event.sample - shift, time=(event.sample - shift) * self.interval)
            for event in recording.events
            if event.kind in COMPARED_EVENTS
        )
        return [event for event in shifted if self.first <= event.sample < self.end]


def pair(a: Recording, b: Recording, align: str, start: float | None, end: float | None) -> Pair:
    """A and B at times in [start, end) s of A, aligned BY_TIME or BY_START.

    Raises UsageError if their sample intervals differ or they have no samples or channels in common.
    """
    if a.sample_interval_ns != b.sample_interval_ns:
        raise UsageError(
            f"solver.sample_interval is {a.parameters.solver.sample_interval:g} s in {a.path} and "
            f"{b.parameters.solver.sample_interval:g} s in {b.path}: "
            "compare recordings made with the same"
        )
    shift = b.first_sample - a.first_sample if align == BY_START else 0
    low = None if start is None else a.sample_at(start)
    high = None if end is None else a.sample_at(end)
    ours = _clip(a.first_sample, a.end_sample, low, high)
    theirs = _clip(b.first_sample - shift, b.end_sample - shift, low, high)
    first, end_sample = max(ours[0], theirs[0]), min(ours[1], theirs[1])
    if first >= end_sample:
        raise UsageError(_nothing_shared(a, b, align, start, end))
    extra = _extra(ours, first, end_sample), _extra(theirs, first, end_sample)
    both = Pair(a, b, shift, first, end_sample, extra)
    if not both.channels:
        raise UsageError(f"{a.path} and {b.path} have no channel in common but the time")
    return both


def _clip(first: int, end: int, low: int | None, high: int | None) -> tuple[int, int]:
    """The part of the samples [first, end) in [low, high)."""
    return first if low is None else max(first, low), end if high is None else min(end, high)


def _extra(samples: tuple[int, int], first: int, end: int) -> ExtraSamples:
    """What the range ``samples`` has before ``first`` and from ``end`` on."""
    return ExtraSamples(max(first - samples[0], 0), max(samples[1] - end, 0))


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


def equal_blocks(left: Iterator[Samples], right: Iterator[Samples]) -> Iterator[tuple[Samples, Samples]]:
    """The samples of both, divided into blocks of equal length, up to the end of the shorter one."""
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
    """``events`` without those that ``others`` has too."""
    matches = Counter(map(_effect, others))
    rest = []
    for event in events:
        if matches[_effect(event)]:
            matches[_effect(event)] -= 1
        else:
            rest.append(event)
    return rest


def _effect(event: OperatorEvent) -> str:
    """Sample, kind and effect of an event, as text to compare."""
    return json.dumps([event.sample, event.kind, dict(event.parameters), dict(event.checkpoint)])
