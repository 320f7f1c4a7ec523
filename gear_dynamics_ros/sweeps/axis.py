"""What is swept: parameters and start values, over ranges and lists with units."""

from __future__ import annotations

import math
import re
from typing import Final, NamedTuple, TypeVar

import numpy as np

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Specification, specifications
from gear_dynamics_ros.parameters.checks import check_value
from gear_dynamics_ros.parameters.entries import Entry, entries_named

MOST_VALUES: Final = 100_000
# Unit that may be written: the SI unit it stands for, and its size in it.
UNITS: Final = {
    "rpm": ("rad/s", math.pi / 30.0),
    "deg": ("rad", math.pi / 180.0),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "kN": ("N", 1e3),
    "mPas": ("Pa s", 1e-3),
}
# What the start of a run can be varied in, with unit and meaning.
STARTS: Final = {
    "start.dte": ("m", "dynamic transmission error at the start"),
    "start.dte_rate": ("m/s", "its rate at the start"),
}
AxisValue = float | int | str
_T = TypeVar("_T")
_NUMBER: Final = re.compile(r"(?P<number>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)(?P<unit>[A-Za-z]*)")


class Axis(NamedTuple):
    """One swept quantity; the parameters that it sets all get the same value."""

    name: str  # as it was written: a name, a pattern with *, or one of STARTS
    targets: tuple[Entry, ...]  # empty for one of STARTS
    values: tuple[AxisValue, ...]  # SI
    unit: str
    meaning: str


def parse_axis(text: str) -> Axis:
    """Axis from ``NAME=START:STOP:COUNT[UNIT]`` or ``NAME=VALUE,VALUE,...[UNIT]``.

    NAME is a parameter, one entry of a list (``mesh.error_cos[0]``), a pattern that names several
    (``bearings.*.restitution``), or one of STARTS. Raises UsageError that names what is wrong.
    """
    name, separator, written = text.partition("=")
    if not separator or not name or not written:
        raise UsageError(f"{text!r} is not a range: write NAME=START:STOP:COUNT or NAME=VALUE,VALUE")
    if name in STARTS:
        unit, meaning = STARTS[name]
        return Axis(name, (), _numbers(name, written, unit), unit, meaning)
    targets = entries_named(name)
    rows = [specifications()[target.name] for target in targets]
    unit, meaning = rows[0].unit, rows[0].help
    if rows[0].type is bool:
        raise UsageError(f"{name} is true or false, which can't be swept: use --set")
    if any((row.unit, row.element) != (unit, rows[0].element) for row in rows):
        raise UsageError(f"{name} names parameters of different kinds: {', '.join(map(str, targets))}")
    values = _values(name, written, rows[0])
    for value in values:
        for target, row in zip(targets, rows, strict=True):
            if target.place is None:
                check_value(row, value)
    return Axis(name, targets, values, unit, meaning)


def _values(name: str, written: str, row: Specification) -> tuple[AxisValue, ...]:
    if row.element is str:
        return _distinct(name, tuple(written.split(",")))
    numbers = _numbers(name, written, row.unit)
    if row.element is int:
        for number in numbers:
            if number != round(number):
                raise UsageError(f"{name} = {number!r} must be a whole number")
        return tuple(round(number) for number in numbers)
    return numbers


def _numbers(name: str, written: str, unit: str) -> tuple[float, ...]:
    body, factor = _without_unit(name, written, unit)
    if ":" not in body:
        return _distinct(name, tuple(factor * _number(name, entry) for entry in body.split(",")))
    bounds = body.split(":")
    if len(bounds) != 3:
        raise UsageError(f"{name}={written} is not a range: write START:STOP:COUNT")
    start, stop, count = (_number(name, entry) for entry in bounds)
    if not 2 <= count <= MOST_VALUES or count != round(count):
        raise UsageError(f"{name}: COUNT = {bounds[2]} must be a whole number from 2 to {MOST_VALUES}")
    return _distinct(name, tuple(map(float, factor * np.linspace(start, stop, round(count)))))


def _without_unit(name: str, written: str, unit: str) -> tuple[str, float]:
    """The numbers of ``written`` without the unit behind the last, and the size of that unit in ``unit``."""
    last = re.split("[:,]", written)[-1]
    match = _NUMBER.fullmatch(last)
    given = match["unit"] if match else ""
    if not given or given == unit:
        return written.removesuffix(given) if given else written, 1.0
    if given not in UNITS or UNITS[given][0] != unit:
        fitting = [short for short, (meant, _) in UNITS.items() if meant == unit]
        choice = " or ".join([*fitting, f"none for {unit}" if unit else "none"])
        raise UsageError(f"{name}: the unit {given} doesn't fit: write {choice}")
    return written.removesuffix(given), UNITS[given][1]


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise UsageError(f"{name}: {text!r} is not a number") from None
    if not math.isfinite(number):
        raise UsageError(f"{name}: {text} must be finite")
    return number


def _distinct(name: str, values: tuple[_T, ...]) -> tuple[_T, ...]:
    if len(set(values)) < len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise UsageError(f"{name}: {twice!r} is given twice: give each value once")
    return values
