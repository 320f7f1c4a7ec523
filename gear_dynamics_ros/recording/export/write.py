"""Exports a table of a recording to a new file, which appears whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.recording.export import tables
from gear_dynamics_ros.recording.export.formats import FORMATS, TableFactory
from gear_dynamics_ros.recording.export.tables import ExportTable
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.system.files import new_file


class Exported(NamedTuple):
    """Size of an exported table."""

    rows: int
    columns: int
    size: int  # bytes


def export_table(
    recording: Recording,
    path: Path,
    table: str = "waveform",
    *,
    format: str | None = None,
    channels: Sequence[str] | None = None,
    start: float | None = None,
    end: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Exported:
    """Write ``table``, one of TABLE_NAMES, at times in [start, end) s to the new file ``path``.

    ``format`` is one of FORMATS, by default the suffix of ``path``; ``channels`` are those of the waveform.
    Holds a few blocks of rows in memory. Writes to ``path`` with ``.part`` behind its name; renames that file
    when it is complete on the disk, and removes it if anything fails. ``progress`` is called with the index
    of the sample up to which all rows are written. Raises UsageError if the file exists or the request is
    invalid, GearboxError if the recording is damaged or the file can't be written.
    """
    make = FORMATS[format or _suffix(path)]
    chosen = _select(recording, table, channels, start, end)
    with new_file(path) as stream:
        rows = _write(stream, chosen, make, _about(recording, table), progress)
    return Exported(rows, len(chosen.columns), path.stat().st_size)


def _suffix(path: Path) -> str:
    suffix = path.suffix.removeprefix(".")
    if suffix not in FORMATS:
        raise UsageError(
            f"the suffix of '{path}' names no format: end it in .{', .'.join(FORMATS)}, or name the format"
        )
    return suffix


def _select(
    recording: Recording,
    table: str,
    channels: Sequence[str] | None,
    start: float | None,
    end: float | None,
) -> ExportTable:
    if table == tables.WAVEFORM:
        return tables.waveform_table(recording, start, end, channels)
    if channels is not None:
        raise UsageError(
            f"channels are columns of the table {tables.WAVEFORM}, not of {table}: leave them out"
        )
    return tables.OTHER_TABLES[table](recording, start, end)


def _about(recording: Recording, table: str) -> dict[str, str]:
    """Texts about the origin of the table, for formats that can store them."""
    return {
        "table": table,
        "recording": recording.path.name,
        "version": recording.version,
        "kernel_hash": recording.kernel_hash,
        "model_hash": recording.run.provenance.model_hash,
        "node": recording.node,
        "epoch_ns": str(recording.epoch_ns),
        "sample_interval_ns": str(recording.sample_interval_ns),
        "parameters": recording.parts[0].parameters,
    }


def _write(
    stream: BinaryIO,
    table: ExportTable,
    make: TableFactory,
    about: Mapping[str, str],
    progress: Callable[[int], None] | None,
) -> int:
    """Write the whole table; returns the number of rows."""
    file = make(stream, table.columns, about)
    rows = 0
    try:
        for block in table.blocks:
            file.write(block.rows)
            rows += len(block.rows)
            if progress is not None:
                progress(block.end_sample)
        file.finish()
    except BaseException:
        file.abandon()
        raise
    return rows
