"""A command over time from a CSV file, and the value between its rows."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.decimals import exact_text

TIME_COLUMN = "time"


class CommandSeries(NamedTuple):
    """``times`` in s, ascending from 0, and ``values`` in the command's unit; shape (n,) each."""

    times: NDArray[np.float64]
    values: NDArray[np.float64]


def interpolate_linear(series: CommandSeries, time: float) -> float:
    """Value at ``time`` (s, >= 0), interpolated linearly between the rows."""
    return float(np.interp(time, series.times, series.values))


def hold_last_value(series: CommandSeries, time: float) -> float:
    """Value of the last row at or before ``time`` (s, >= 0)."""
    return float(series.values[np.searchsorted(series.times, time, side="right") - 1])


Interpolation: TypeAlias = Callable[[CommandSeries, float], float]
INTERPOLATIONS: Mapping[str, Interpolation] = {"linear": interpolate_linear, "held": hold_last_value}


def load_series(path: Path, column: str) -> CommandSeries:
    """The columns ``time`` and ``column`` of a CSV file whose first line names its columns.

    Raises UsageError in one line naming file, line, value and limit.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            pairs = list(_pairs(csv.reader(file, strict=True), column))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; name a readable CSV file") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: not CSV text: {error}") from error
    except UsageError as error:
        raise UsageError(f"{path}, {error}") from error
    if not pairs:
        raise UsageError(f"{path}: no rows below the line of column names: add at least one")
    times, values = zip(*pairs, strict=True)
    return CommandSeries(np.array(times), np.array(values))


def _pairs(rows: Iterator[Sequence[str]], column: str) -> Iterator[tuple[float, float]]:
    names = [name.strip() for name in next(rows, [])]
    for name in (TIME_COLUMN, column):
        if names.count(name) != 1:
            raise UsageError(
                f"line 1: {names.count(name)} columns {name!r} in {', '.join(names)!r}, must be one"
            )
    earlier = -math.inf
    for line, row in enumerate(rows, start=2):
        if not row:
            continue
        if len(row) != len(names):
            raise UsageError(f"line {line}: {len(row)} columns, must be {len(names)} as in line 1")
        time = _finite(row[names.index(TIME_COLUMN)], TIME_COLUMN, line)
        _require_later(time, earlier, line)
        earlier = time
        yield time, _finite(row[names.index(column)], column, line)


def _require_later(time: float, earlier: float, line: int) -> None:
    if math.isinf(earlier) and time != 0.0:
        raise UsageError(
            f"line {line}: the first time is {exact_text(time)} s, must be 0: count it from the entry's start"
        )
    if time <= earlier:
        raise UsageError(
            f"line {line}: time is {exact_text(time)} s, must be later than {exact_text(earlier)} s above"
        )


def _finite(text: str, name: str, line: int) -> float:
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"line {line}: {name} is {text!r}, must be a finite number")
    return value
