"""One command over time: steps, ramps, sines, chirps and values from a file, one after the other."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness import fields
from gear_dynamics_ros.harness.series import INTERPOLATIONS, CommandSeries, Interpolation, load_series
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.mappings import require_mapping

_STEP_KEYS = ("at", "value")
_RAMP_KEYS = ("from", "to", "value", "amplitude", "frequency", "end_frequency")
_SERIES_KEYS = ("from", "csv", "column", "interpolation")


class TrackPiece(Protocol):
    """Sets a command from ``start`` on, until the next piece starts. Times in s."""

    @property
    def start(self) -> float:
        """Time of the first value."""

    @property
    def end(self) -> float:
        """Time from which the value is constant."""

    @property
    def final(self) -> float:
        """The value from ``end`` on."""

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of its sines, Hz; 0 without any."""

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""

    def since(self, time: float) -> float:
        """Time from which the value at ``time`` >= start holds; ``time`` itself where it changes."""


@dataclass(frozen=True, slots=True)
class RampPiece:
    """A ramp from ``initial`` to ``final``, plus a sine or a linear chirp; constant ``final`` after it.

    ``start`` and ``end`` in s (equal for a step), frequencies in Hz, all others in the command's unit.
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
        """Highest frequency of its sines, Hz; 0 without any."""
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

    def since(self, time: float) -> float:
        """Time from which the value at ``time`` >= start holds."""
        return min(time, self.end)


@dataclass(frozen=True, slots=True)
class SeriesPiece:
    """The values of a series from ``start`` (s) on; constant after the last one."""

    start: float
    series: CommandSeries
    interpolation: Interpolation
    highest_frequency: float = 0.0

    @property
    def end(self) -> float:
        """Time from which the value is constant, s."""
        return self.start + float(self.series.times[-1])

    @property
    def final(self) -> float:
        """The last value."""
        return float(self.series.values[-1])

    def value(self, time: float) -> float:
        """Value at ``time`` >= start."""
        return self.interpolation(self.series, time - self.start)

    def since(self, time: float) -> float:
        """Time from which the value at ``time`` >= start holds."""
        return min(time, self.end)


@dataclass(frozen=True, slots=True)
class CommandTrack:
    """The pieces of one command, in order of time."""

    pieces: tuple[TrackPiece, ...]

    def value(self, time: float) -> float | None:
        """Value at ``time`` in s, None before the first piece."""
        position = bisect_right(self.pieces, time, key=lambda piece: piece.start)
        return self.pieces[position - 1].value(time) if position else None

    def since(self, time: float) -> float:
        """Time from which the value at ``time`` in s holds, not before the first piece."""
        position = bisect_right(self.pieces, time, key=lambda piece: piece.start)
        return self.pieces[position - 1].since(time)

    @property
    def end(self) -> float:
        """Time from which the value is constant, s."""
        return self.pieces[-1].end

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of its sines, Hz; 0 without any."""
        return max(piece.highest_frequency for piece in self.pieces)


def parse_track(command: str, entries: object, folder: Path) -> CommandTrack:
    """The track of ``command`` from its list in the profile; paths of CSV files are relative to ``folder``.

    Raises UsageError in one line naming entry (and file), value and limit.
    """
    pieces: list[TrackPiece] = []
    for position, entry in enumerate(fields.require_list(entries, f"commands.{command}")):
        where = f"commands.{command}[{position}]"
        piece = _piece(where, entry, pieces[-1].final if pieces else None, command, folder)
        if pieces:
            _require_order(where, piece, pieces[-1])
        pieces.append(piece)
    if not pieces:
        raise UsageError(f"commands.{command} is empty: give it at least one entry {{at: 0.0, value: X}}")
    return CommandTrack(tuple(pieces))


def _require_order(where: str, piece: TrackPiece, previous: TrackPiece) -> None:
    if piece.start < previous.end or piece.start == previous.start:
        raise UsageError(
            f"{where} starts at {exact_text(piece.start)} s, before the entry above ends "
            f"({exact_text(previous.start)} to {exact_text(previous.end)} s): put the times in order"
        )


def _piece(where: str, entry: object, level: float | None, command: str, folder: Path) -> TrackPiece:
    """The piece of one entry; ``level`` is the value before it, None for the first."""
    if isinstance(entry, Mapping) and "at" in entry:
        return _step(where, require_mapping(entry, where, _STEP_KEYS))
    if isinstance(entry, Mapping) and "csv" in entry:
        return _series(where, require_mapping(entry, where, _SERIES_KEYS), command, folder)
    return _ramp(where, require_mapping(entry, where, _RAMP_KEYS), level)


def _step(where: str, tree: Mapping[str, Any]) -> RampPiece:
    start, value = fields.require_time(tree, "at", where), fields.require_number(tree, "value", where)
    return RampPiece(start, start, value, value)


def _series(where: str, tree: Mapping[str, Any], command: str, folder: Path) -> SeriesPiece:
    start = fields.require_time(tree, "from", where)
    interpolation = "linear"
    if "interpolation" in tree:
        interpolation = fields.require_choice(tree, "interpolation", where, tuple(INTERPOLATIONS))
    column = fields.optional_text(tree, "column", where, command)
    try:
        series = load_series(folder / fields.optional_text(tree, "csv", where, ""), column)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    return SeriesPiece(start, series, INTERPOLATIONS[interpolation])


def _ramp(where: str, tree: Mapping[str, Any], level: float | None) -> RampPiece:
    start, end = fields.require_window(tree, where)
    if level is None:
        raise UsageError(f"{where} has no value to start from: put {{at: {start:g}, value: X}} before it")
    if "value" not in tree and "amplitude" not in tree:
        raise UsageError(
            f"{where} has neither value nor amplitude: give a ramp its value, a sine its amplitude"
        )
    final = fields.require_number(tree, "value", where) if "value" in tree else level
    if "amplitude" not in tree:
        spare = [key for key in ("frequency", "end_frequency") if key in tree]
        if spare:
            raise UsageError(f"{where}.{spare[0]} has no amplitude: add one, or remove it")
        return RampPiece(start, end, level, final)
    frequency = fields.require_number(tree, "frequency", where)
    end_frequency = (
        fields.require_number(tree, "end_frequency", where) if "end_frequency" in tree else frequency
    )
    for key, hertz in (("frequency", frequency), ("end_frequency", end_frequency)):
        if hertz <= 0.0:
            raise UsageError(f"{where}.{key} is {exact_text(hertz)} Hz, must be > 0")
    return RampPiece(
        start, end, level, final, fields.require_number(tree, "amplitude", where), frequency, end_frequency
    )
