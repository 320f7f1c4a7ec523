"""Content of a recording as tables of named columns, block by block."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import (
    CHANNELS,
    ENERGIES,
    IMPACTS,
    Channel,
)
from gear_dynamics_ros.chunk import Commands, Counters
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.recording.reader import BLOCK_SAMPLES, Recording

NUMBER: Final = "<f8"
INTEGER: Final = "<i8"
TEXT: Final = "O"


class TableColumn(NamedTuple):
    """One column: its name, unit and meaning, and the NumPy type of its entries."""

    name: str
    unit: str
    meaning: str
    type: str  # NUMBER, INTEGER or TEXT


class RowBlock(NamedTuple):
    """Consecutive rows of a table."""

    rows: NDArray[Any]  # structured, a field for each column
    end_sample: int  # all rows before this sample are in this block or in an earlier one


class ExportTable(NamedTuple):
    """Columns, and blocks of rows in order, each read when it is needed."""

    columns: tuple[TableColumn, ...]
    blocks: Iterator[RowBlock]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Type of a row."""
        return row_type(self.columns)


def row_type(columns: Sequence[TableColumn]) -> np.dtype[np.void]:
    """Structured NumPy type with a field for each column."""
    return np.dtype([(column.name, column.type) for column in columns])


def waveform_table(
    recording: Recording, start: float | None, end: float | None, channels: Sequence[str] | None
) -> ExportTable:
    """Every sample at times in [start, end) s: its index, its time, then ``channels`` (default: all).

    Raises UsageError on an unknown channel, one that is named twice, and a window without samples;
    GearboxError if the recording has no samples.
    """
    recording.require_topic("waveform")
    first, end_sample = recording.require_window(start, end)
    if first == end_sample:
        raise GearboxError(f"{recording.path} holds no samples: nothing to export")
    selected = recording.channel_names if channels is None else tuple(channels)
    for name in selected:
        if selected.count(name) > 1:
            raise UsageError(f"the channel '{name}' is named {selected.count(name)} times: name it once")
    names = ("time", *(name for name in selected if name != "time"))
    recording.columns(names)
    known = {channel.name: channel for channel in (*CHANNELS, *ENERGIES)}
    columns = (SAMPLE, *(_number(known[name]) for name in names))
    return ExportTable(columns, _waveform_blocks(recording, first, end_sample, names, row_type(columns)))


def impacts_table(recording: Recording, start: float | None, end: float | None) -> ExportTable:
    """Bearing contacts that ended at times in [start, end) s. Raises UsageError as ``waveform_table``."""
    recording.require_topic("impacts")
    recording.require_window(start, end)
    columns = tuple(map(_number, IMPACTS))
    low, high = -math.inf if start is None else start, math.inf if end is None else end
    return ExportTable(columns, _impact_blocks(recording, low, high, row_type(columns)))


def energy_table(recording: Recording, start: float | None, end: float | None) -> ExportTable:
    """Work, losses and stored energies after each chunk in [start, end) s; ``sample`` is the next one."""
    recording.require_topic("energy")
    columns = (SAMPLE, TIME, *map(_number, ENERGIES))
    return ExportTable(columns, _energy_blocks(recording, _inside(recording, start, end), row_type(columns)))


def commands_table(recording: Recording, start: float | None, end: float | None) -> ExportTable:
    """Commands at times in [start, end) s, each in force from its sample on."""
    columns = (SAMPLE, TIME, *COMMANDS)
    inside = _inside(recording, start, end)
    rows = ((sample, _time(recording, sample), *values) for sample, values in recording.commands)
    return ExportTable(
        columns, _listed(recording, (row for row in rows if inside(row[0])), row_type(columns))
    )


def events_table(recording: Recording, start: float | None, end: float | None) -> ExportTable:
    """Operator events at times in [start, end) s, without the checkpoint of a restore."""
    inside = _inside(recording, start, end)
    events = [event for event in recording.events if inside(event.sample)]
    columns = (SAMPLE, TIME, *EVENT, *COUNTERS)
    rows = (_event_row(event) for event in events)
    return ExportTable(columns, _listed(recording, rows, row_type(columns)))


SAMPLE: Final = TableColumn("sample", "", "index of the sample, counted from the start of the run", INTEGER)
TIME: Final = TableColumn("time", "s", "simulated time", NUMBER)
COMMANDS: Final = tuple(
    TableColumn(name, unit, "commanded", NUMBER)
    for name, unit in zip(Commands._fields, ("N m", "N m", "rad/s"), strict=True)
)
EVENT: Final = (
    TableColumn("event", "", "what happened before the sample was made", TEXT),
    TableColumn("message", "", "why", TEXT),
    TableColumn("parameters", "", "JSON: parameters that changed, by dotted name", TEXT),
)
COUNTERS: Final = tuple(
    TableColumn(f"counted_{name}", "", f"{name} since the start of the run", INTEGER)
    for name in Counters._fields
)
OTHER_TABLES: Final[Mapping[str, Callable[[Recording, float | None, float | None], ExportTable]]] = {
    "impacts": impacts_table,
    "commands": commands_table,
    "events": events_table,
    "energy": energy_table,
}
WAVEFORM: Final = "waveform"
TABLE_NAMES: Final = (WAVEFORM, *OTHER_TABLES)


def _number(channel: Channel) -> TableColumn:
    return TableColumn(*channel, NUMBER)


def _time(recording: Recording, sample: int) -> float:
    return sample * recording.sample_interval_ns / 1e9


def _inside(recording: Recording, start: float | None, end: float | None) -> Callable[[int], bool]:
    """A function that says whether a sample is at a time in [start, end) s; it may be the end sample."""
    recording.require_window(start, end)
    low = -sys.maxsize if start is None else recording.sample_at(start)
    high = sys.maxsize if end is None else recording.sample_at(end)
    return lambda sample: low <= sample < high


def _waveform_blocks(
    recording: Recording, first: int, end_sample: int, names: Sequence[str], dtype: np.dtype[np.void]
) -> Iterator[RowBlock]:
    for samples in recording.pieces(first, end_sample, names):
        end = samples.first + len(samples)
        yield RowBlock(_rows(np.arange(samples.first, end), samples.values, dtype), end)


def _impact_blocks(
    recording: Recording, low: float, high: float, dtype: np.dtype[np.void]
) -> Iterator[RowBlock]:
    for time_ns, values in recording.rows("impacts"):
        ends = values[:, 1]
        kept = np.ascontiguousarray(values[(ends >= low) & (ends < high)])
        yield RowBlock(kept.view(dtype)[:, 0], recording.sample_of(time_ns) + 1)


def _energy_blocks(
    recording: Recording, inside: Callable[[int], bool], dtype: np.dtype[np.void]
) -> Iterator[RowBlock]:
    for time_ns, values in recording.rows("energy"):
        sample = recording.sample_of(time_ns) + 1
        if inside(sample):
            timed = np.column_stack([[_time(recording, sample)], values])
            yield RowBlock(_rows(np.array([sample]), timed, dtype), sample)


def _rows(
    samples: NDArray[np.int64], values: NDArray[np.float64], dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    """Rows from indexes (n,) and values (n, k), all of eight bytes."""
    rows = np.empty((len(values), 1 + values.shape[1]))
    rows.view(np.int64)[:, 0] = samples
    rows[:, 1:] = values
    return rows.view(dtype)[:, 0]


def _listed(
    recording: Recording, rows: Iterable[tuple[Any, ...]], dtype: np.dtype[np.void]
) -> Iterator[RowBlock]:
    waiting: list[tuple[Any, ...]] = []
    for row in rows:
        waiting.append(row)
        if len(waiting) == BLOCK_SAMPLES:
            yield RowBlock(np.array(waiting, dtype=dtype), row[0])
            waiting = []
    yield RowBlock(np.array(waiting, dtype=dtype), recording.end_sample)


def _event_row(event: OperatorEvent) -> tuple[Any, ...]:
    changed = json.dumps(dict(event.parameters)) if event.parameters else ""
    return event.sample, event.time, event.kind, event.message, changed, *event.counters
