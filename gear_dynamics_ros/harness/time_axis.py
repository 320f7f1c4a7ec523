"""The time axis of a profile: the time in the profile of each sample, by the commands that acted."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from typing import NamedTuple

from gear_dynamics_ros.chunk import Commands


class Stretch(NamedTuple):
    """Consecutive samples [first, end) of the gearbox, counted from profile time 0 on.

    Their positions on the axis are ``position`` and following, or all ``position`` if the axis stands
    still, waiting for a command that is due there.
    """

    first: int
    end: int
    position: int
    moves: bool

    def part(self, start: int, end: int) -> Stretch:
        """Its samples ``start`` to before ``end``, counted from its first."""
        position = self.position + (start if self.moves else 0)
        return Stretch(self.first + start, self.first + end, position, self.moves)


class _Awaited(NamedTuple):
    """A value that was sent and has not acted yet."""

    name: str
    value: float
    position: int  # at which it is due
    sample: int  # at which that position was reached


class _Anchor(NamedTuple):
    """The sample at which a command acted, and the position for which it was meant."""

    sample: int
    position: int


class ActedValue(NamedTuple):
    """A value that has acted."""

    name: str
    value: float
    position: int  # for which it was meant
    late: int  # samples from the one at which it was due to the one at which it acted


class TimeAxis:
    """Positions of samples on the axis of a profile; both count samples from profile time 0 on.

    At the sample at which a command acts, the position is the one for which it was meant. From there it
    advances with the samples, but never past a command that is due and does not act yet, and never back.
    """

    def __init__(self) -> None:
        self._awaited: list[_Awaited] = []  # by position
        self._anchors: list[_Anchor] = [_Anchor(0, 0)]
        self._resolved = 0  # samples with a position
        self._position = 0  # of the next sample
        self.values_acted: list[ActedValue] = []
        self.left_out: list[int] = []  # positions of values that later ones overtook before they acted

    @property
    def position(self) -> int:
        """Position up to which all samples are known."""
        return self._position

    @property
    def awaiting(self) -> dict[str, float]:
        """The commands that were sent and have not acted, with their newest values, by name."""
        return {awaited.name: awaited.value for awaited in self._awaited}

    def expect(self, name: str, value: float, position: int, sample: int) -> None:
        """Note that the command ``name`` is due with ``value`` at ``position``, reached at ``sample``."""
        self._awaited.append(_Awaited(name, value, position, sample))

    def acted(self, sample: int, commands: Commands) -> None:
        """Note that ``commands`` are in force from ``sample`` on."""
        confirmed: list[_Awaited] = []
        for name, value in zip(Commands._fields, commands, strict=True):
            sent = [awaited for awaited in self._awaited if awaited.name == name]
            # The newest: of several equal values in flight only the last is sure to have acted.
            count = next((k for k in range(len(sent), 0, -1) if sent[k - 1].value == value), 0)
            if count:
                confirmed.append(sent[count - 1])
                self.left_out.extend(awaited.position for awaited in sent[: count - 1])
                self._awaited = [awaited for awaited in self._awaited if awaited not in sent[:count]]
        if confirmed:
            self.values_acted.extend(
                ActedValue(awaited.name, awaited.value, awaited.position, max(0, sample - awaited.sample))
                for awaited in confirmed
            )
            last = max(confirmed, key=lambda awaited: awaited.position)
            self._anchors.append(_Anchor(max(sample, last.sample), last.position))
            self._anchors.sort()

    def position_at(self, sample: int) -> int:
        """Position of ``sample`` if no command is awaited before it."""
        anchor = self._anchors[self._anchor_before(sample)]
        return max(self._position, anchor.position + sample - anchor.sample)

    def resolve(self, end: int) -> Iterator[Stretch]:
        """The samples before ``end`` whose positions have become known since the last call, in order."""
        while self._resolved < end:
            stretch = self._next(end)
            if stretch is None:
                return
            self._resolved = stretch.end
            self._position = stretch.position + (stretch.end - stretch.first if stretch.moves else 0)
            del self._anchors[: self._anchor_before(self._resolved)]
            yield stretch

    def _next(self, end: int) -> Stretch | None:
        """The next samples that share one anchor and move or stand alike; None while they must wait."""
        first, position = self._resolved, self._position
        index = self._anchor_before(first)
        anchor, later = self._anchors[index], self._anchors[index + 1 :]
        if later:
            end = min(end, later[0].sample)
        by_anchor = anchor.position + first - anchor.sample
        if by_anchor < position:
            return Stretch(first, min(end, first + position - by_anchor), position, moves=False)
        due = min((awaited.position for awaited in self._awaited), default=None)
        coming = min((other.position for other in later), default=None)
        limit = min((bound for bound in (due, coming) if bound is not None), default=None)
        if limit is None or by_anchor < limit:
            count = end - first if limit is None else min(end - first, limit - by_anchor)
            return Stretch(first, first + count, by_anchor, moves=True)
        if due is not None and (coming is None or due < coming):
            return None
        return Stretch(first, end, max(position, limit), moves=False)

    def _anchor_before(self, sample: int) -> int:
        return bisect_right(self._anchors, sample, key=lambda anchor: anchor.sample) - 1
