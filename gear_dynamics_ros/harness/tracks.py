"""One command over time: steps, ramps, sines, chirps and replayed series, one after the other."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness import fields
from gear_dynamics_ros.harness.series import INTERPOLATIONS, Interpolation, Series, load_series

_STEP_KEYS = ("at", "value")
_SPAN_KEYS = ("from", "to", "value", "amplitude", "frequency", "end_frequency")
_SERIES_KEYS = ("from", "csv", "column", "interpolation")


class Piece(Protocol):
    """What sets a command from ``start`` on, until the next piece starts. Times in s."""

    @property
    def start(self) -> float:
        """Time of the first value."""

    @property
    def end(self) -> float:
        """Time from which the value stays."""

    @property
    def final(self) -> float:
        """The value that stays."""

    @property
    def highest_frequency(self) -> float:
        """Highest frequency asked for, Hz; 0 without sines."""

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A ramp from ``initial`` to ``final`` with a sine or a linear chirp on top; then it stays at ``final``.

    ``start`` and ``end`` in s (equal for a step), frequencies in Hz, the rest in the command's unit.
    """

    start: float
    end: float
    initial: float
    final: float
    amplitude: float = 0.0
    frequency: float = 0.0
    end_frequency: float = 0.0

    @property
    def highest_frequency(self) -> float:
        """Highest frequency asked for, Hz; 0 without sines."""
        return max(self.frequency, self.end_frequency)

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""
        if time >= self.end:
            return self.final
        length = self.end - self.start
        since = time - self.start
        level = self.initial + (self.final - self.initial) * since / length
        cycles = since * (self.frequency + 0.5 * (self.end_frequency - self.frequency) * since / length)
        return level + self.amplitude * math.sin(2.0 * math.pi * cycles)


@dataclass(frozen=True, slots=True)
class Replay:
    """A series of values from ``start`` (s) on; then it stays at the last."""

    start: float
    series: Series
    interpolation: Interpolation
    highest_frequency: float = 0.0

    @property
    def end(self) -> float:
        """Time from which the value stays, s."""
        return self.start + float(self.series.times[-1])

    @property
    def final(self) -> float:
        """The last value."""
        return float(self.series.values[-1])

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""
        return self.interpolation(self.series, time - self.start)


@dataclass(frozen=True, slots=True)
class Track:
    """The pieces of one command, in order of time."""

    pieces: tuple[Piece, ...]

    def value(self, time: float) -> float | None:
        """Value at ``time`` in s, None before the first piece."""
        position = bisect_right(self.pieces, time, key=lambda piece: piece.start)
        return self.pieces[position - 1].value(time) if position else None

    @property
    def end(self) -> float:
        """Time from which the value stays, s."""
        return self.pieces[-1].end

    @property
    def highest_frequency(self) -> float:
        """Highest frequency asked for, Hz; 0 without sines."""
        return max(piece.highest_frequency for piece in self.pieces)


def parse_track(command: str, entries: object, folder: Path) -> Track:
    """The track of ``command`` from its list in the profile; CSV files are looked for below ``folder``.

    Raises UsageError in one line naming entry (and file), value and limit.
    """
    pieces: list[Piece] = []
    for position, entry in enumerate(fields.sequence(entries, f"commands.{command}")):
        where = f"commands.{command}[{position}]"
        piece = _piece(where, entry, pieces[-1].final if pieces else None, command, folder)
        if pieces:
            _require_order(where, piece, pieces[-1])
        pieces.append(piece)
    if not pieces:
        raise UsageError(f"commands.{command} is empty: give it at least one entry {{at: 0.0, value: X}}")
    return Track(tuple(pieces))


def _require_order(where: str, piece: Piece, previous: Piece) -> None:
    if piece.start < previous.end or piece.start == previous.start:
        raise UsageError(
            f"{where} starts at {piece.start:g} s, before the entry above is over "
            f"({previous.start:g} to {previous.end:g} s): put the times in order"
        )


def _piece(where: str, entry: object, level: float | None, command: str, folder: Path) -> Piece:
    """One entry; ``level`` is the value in force before it."""
    if isinstance(entry, Mapping) and "at" in entry:
        return _step(where, fields.mapping(entry, where, _STEP_KEYS))
    if isinstance(entry, Mapping) and "csv" in entry:
        return _replay(where, fields.mapping(entry, where, _SERIES_KEYS), command, folder)
    return _span(where, fields.mapping(entry, where, _SPAN_KEYS), level)


def _step(where: str, tree: Mapping[str, Any]) -> Segment:
    start, value = fields.time(tree, "at", where), fields.number(tree, "value", where)
    return Segment(start, start, value, value)


def _replay(where: str, tree: Mapping[str, Any], command: str, folder: Path) -> Replay:
    start = fields.time(tree, "from", where)
    way = "linear"
    if "interpolation" in tree:
        way = fields.choice(tree, "interpolation", where, tuple(INTERPOLATIONS))
    column = fields.text(tree, "column", where, command)
    try:
        series = load_series(folder / fields.text(tree, "csv", where, ""), column)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    return Replay(start, series, INTERPOLATIONS[way])


def _span(where: str, tree: Mapping[str, Any], level: float | None) -> Segment:
    start, end = fields.window(tree, where)
    if level is None:
        raise UsageError(f"{where} starts from no known value: put {{at: {start:g}, value: X}} before it")
    if "value" not in tree and "amplitude" not in tree:
        raise UsageError(
            f"{where} has neither value nor amplitude: give a ramp its value, a sine its amplitude"
        )
    final = fields.number(tree, "value", where) if "value" in tree else level
    if "amplitude" not in tree:
        spare = [key for key in ("frequency", "end_frequency") if key in tree]
        if spare:
            raise UsageError(f"{where}.{spare[0]} has no amplitude beside it: add one or drop it")
        return Segment(start, end, level, final)
    frequency = fields.number(tree, "frequency", where)
    end_frequency = fields.number(tree, "end_frequency", where) if "end_frequency" in tree else frequency
    for key, hertz in (("frequency", frequency), ("end_frequency", end_frequency)):
        if hertz <= 0.0:
            raise UsageError(f"{where}.{key} is {hertz:g} Hz, must be > 0")
    return Segment(
        start, end, level, final, fields.number(tree, "amplitude", where), frequency, end_frequency
    )
