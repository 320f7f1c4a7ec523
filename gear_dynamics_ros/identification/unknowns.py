"""What a fit varies: parameters with bounds, each on a scale from 0 to 1."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, Specification
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.entries import Entry, entries_named, with_entries
from gear_dynamics_ros.parameters.hints import shortened
from gear_dynamics_ros.parameters.tree import specification_of

# From this ratio of its bounds on, an unknown is varied by its logarithm.
LOGARITHMIC_RATIO: Final = 10.0


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
        value = float(self.entries[0].value(parameters))
        return self.coordinate(value) if self.low <= value <= self.high else 0.5


def read_unknowns(options: Iterable[str], parameters: Parameters) -> tuple[Unknown, ...]:
    """The unknowns of options ``NAME=LOW:HIGH``.

    NAME is what ``entries_named`` reads, or several of these with commas between them, which are tied. Raises
    UsageError on an unknown name, one that is no real number or is named twice, and on bounds that are
    reversed or not allowed for the parameter.
    """
    unknowns = tuple(_read_unknown(option) for option in options)
    if not unknowns:
        raise UsageError("nothing to fit: give at least one --vary NAME=LOW:HIGH")
    seen: set[Entry] = set()
    for entry in (entry for unknown in unknowns for entry in unknown.entries):
        if entry in seen:
            raise UsageError(f"{entry} is varied twice: name it in one --vary")
        entry.value(parameters)
        seen.add(entry)
    return unknowns


def trial_parameters(
    base: Parameters, unknowns: Sequence[Unknown], coordinates: NDArray[np.float64]
) -> Parameters:
    """``base`` with the values at ``coordinates`` (n,), one for each unknown.

    Raises UsageError if the values don't fit each other.
    """
    values: dict[Entry, Any] = {}
    for unknown, coordinate in zip(unknowns, coordinates, strict=True):
        values |= dict.fromkeys(unknown.entries, unknown.value(float(coordinate)))
    return with_entries(base, values)


def _read_unknown(option: str) -> Unknown:
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
    entries = tuple(entry for name in label.split(",") for entry in entries_named(name.strip()))
    rows = [specification_of(entry.name) for entry in entries]
    for row in rows:
        if row.element is not float:
            raise UsageError(f"--vary {row.name}: only real numbers can be fitted: fix it with --set")
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
        raise UsageError(f"--vary {label}: the bound {shortened(text)!r} is not a finite number")
    return number


def _require_allowed(row: Specification, bound: float) -> None:
    low, high = row.minimum, row.maximum
    below = low is not None and (bound < low or (row.exclusive_minimum and bound == low))
    above = high is not None and (bound > high or (row.exclusive_maximum and bound == high))
    if below or above:
        unit = f" {row.unit}" if row.unit else ""
        raise UsageError(f"--vary {row.name}: the bound {exact_text(bound)}{unit} must be {row.limits}")
