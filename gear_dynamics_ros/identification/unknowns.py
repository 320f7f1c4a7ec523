"""What a fit varies: parameters with bounds, each on a scale from 0 to 1."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, Specification, specifications, updated
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.hints import shortened
from gear_dynamics_ros.parameters.tree import specification_of

# From this ratio of its bounds on, an unknown is varied by its logarithm.
LOGARITHMIC_RATIO: Final = 10.0
_ENTRY: Final = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<index>\d+)\])?")


class Entry(NamedTuple):
    """A parameter, or one number of a parameter that is a list."""

    name: str  # dotted
    place: int | None  # in the list, from 0

    def __str__(self) -> str:
        return self.name if self.place is None else f"{self.name}[{self.place}]"

    def of(self, parameters: Parameters) -> float:
        """Its value."""
        value: Any = parameters.to_flat()[self.name]
        return float(value if self.place is None else value[self.place])


class Unknown(NamedTuple):
    """One number that a fit looks for, between its bounds; several entries that have it are tied together."""

    label: str  # as the user named it
    entries: tuple[Entry, ...]
    low: float
    high: float
    unit: str

    @property
    def logarithmic(self) -> bool:
        """Whether equal steps of the coordinate are equal ratios of the value."""
        return self.low > 0.0 and self.high >= LOGARITHMIC_RATIO * self.low

    @property
    def width(self) -> float:
        """Distance of the bounds, in the unit of the value."""
        return self.high - self.low

    def value(self, coordinate: float) -> float:
        """Value at a coordinate, which is 0 at the lower and 1 at the upper bound."""
        if self.logarithmic:
            value = self.low * math.exp(coordinate * math.log(self.high / self.low))
        else:
            value = self.low + coordinate * self.width
        return min(max(value, self.low), self.high)

    def coordinate(self, value: float) -> float:
        """Inverse of ``value``, for values within the bounds."""
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / self.width

    def slope(self, value: float) -> float:
        """Change of the value by one unit of the coordinate, at ``value``."""
        return value * math.log(self.high / self.low) if self.logarithmic else self.width

    def start(self, parameters: Parameters) -> float:
        """Coordinate of the value in ``parameters``, or 0.5 if that is out of bounds."""
        value = self.entries[0].of(parameters)
        return self.coordinate(value) if self.low <= value <= self.high else 0.5


def read_unknowns(options: Iterable[str], parameters: Parameters) -> tuple[Unknown, ...]:
    """The unknowns of options ``NAME=LOW:HIGH``.

    NAME may have ``*`` for any one part of a dotted name, and several names with commas between them; an
    index in brackets names one number of a list. Raises UsageError on an unknown name, one that is no real
    number or is named twice, and on bounds that are reversed or not allowed for the parameter.
    """
    unknowns = tuple(_read_unknown(option, parameters) for option in options)
    if not unknowns:
        raise UsageError("nothing to fit: give at least one --vary NAME=LOW:HIGH")
    seen: set[Entry] = set()
    for entry in (entry for unknown in unknowns for entry in unknown.entries):
        if entry in seen:
            raise UsageError(f"{entry} is varied twice: name it in one --vary")
        seen.add(entry)
    return unknowns


def trial_parameters(
    base: Parameters, unknowns: Sequence[Unknown], coordinates: NDArray[np.float64]
) -> Parameters:
    """``base`` with the values at ``coordinates`` (n,), one for each unknown.

    Raises UsageError if the values don't fit each other.
    """
    flat = base.to_flat()
    changed: dict[str, Any] = {}
    for unknown, coordinate in zip(unknowns, coordinates, strict=True):
        value = unknown.value(float(coordinate))
        for name, place in unknown.entries:
            if place is None:
                changed[name] = value
            else:
                entries = list(changed.get(name, flat[name]))
                entries[place] = value
                changed[name] = entries
    return updated(base, changed)


def _read_unknown(option: str, parameters: Parameters) -> Unknown:
    label, separator, bounds = option.partition("=")
    low_text, colon, high_text = bounds.partition(":")
    if not (separator and label and colon):
        raise UsageError(f"--vary {shortened(option)} can't be read: write NAME=LOW:HIGH")
    low, high = _number(label, low_text), _number(label, high_text)
    if not low < high:
        raise UsageError(
            f"--vary {label}: the lower bound {exact_text(low)} must be less than the upper bound "
            f"{exact_text(high)}: swap or change them"
        )
    entries = tuple(entry for name in label.split(",") for entry in _entries(name.strip(), parameters))
    rows = [specification_of(entry.name) for entry in entries]
    for row in rows:
        _require_allowed(row, low)
        _require_allowed(row, high)
    units = {row.unit for row in rows}
    if len(units) > 1:
        raise UsageError(
            f"--vary {label} ties parameters in {' and '.join(sorted(unit or '1' for unit in units))}: "
            "tie only those of one unit"
        )
    return Unknown(label, entries, low, high, rows[0].unit)


def _number(label: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(
            f"--vary {label}: the bound {shortened(text)!r} is not a finite number: write LOW:HIGH"
        )
    return number


def _entries(pattern: str, parameters: Parameters) -> list[Entry]:
    found = _ENTRY.fullmatch(pattern)
    if found is None:
        raise UsageError(
            f"--vary {shortened(pattern)!r} is not the name of a parameter: write it as group.name"
        )
    names = _matching(found["name"])
    index = None if found["index"] is None else int(found["index"])
    return [_checked_entry(name, index, parameters) for name in names]


def _matching(pattern: str) -> list[str]:
    """Names that match; a ``*`` stands for a whole part between dots, or for some of its letters."""
    if "*" not in pattern:
        return [specification_of(pattern).name]
    parts = pattern.split(".")
    names = [
        name
        for name in specifications()
        if len(name.split(".")) == len(parts) and all(map(fnmatchcase, name.split("."), parts))
    ]
    if not names:
        raise UsageError(
            f"--vary {shortened(pattern)}: no parameter has such a name: docs/parameters.md lists them"
        )
    return names


def _checked_entry(name: str, index: int | None, parameters: Parameters) -> Entry:
    row = specification_of(name)
    if row.element is not float:
        raise UsageError(
            f"--vary {name}: it is not a real number, which alone can be fitted: fix it with --set"
        )
    value = parameters.to_flat()[name]
    if isinstance(value, tuple):
        if index is None:
            raise UsageError(f"--vary {name}: it is a list: name one of its numbers, such as {name}[0]")
        if index >= len(value):
            raise UsageError(
                f"--vary {name}[{index}]: the list has {len(value)} numbers, counted from 0: "
                f"add some with --set {name}=[...]"
            )
    elif index is not None:
        raise UsageError(f"--vary {name}[{index}]: it is not a list: leave [{index}] out")
    return Entry(name, index)


def _require_allowed(row: Specification, bound: float) -> None:
    below = row.minimum is not None and (
        bound < row.minimum or (row.exclusive_minimum and bound == row.minimum)
    )
    above = row.maximum is not None and (
        bound > row.maximum or (row.exclusive_maximum and bound == row.maximum)
    )
    if below or above:
        unit = f" {row.unit}" if row.unit else ""
        raise UsageError(f"--vary {row.name}: the bound {exact_text(bound)}{unit} must be {row.limits}")
