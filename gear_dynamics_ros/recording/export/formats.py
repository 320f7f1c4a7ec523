"""Writes tables as CSV, NumPy and Parquet files, without loss of precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.recording.export.tables import (
    INTEGER,
    NUMBER,
    TEXT,
    TableColumn,
    row_type,
)

# A reader decompresses a whole row group for one row, and opening a group takes time.
ROW_GROUP: Final = 60_000
# Numbers as text and as Python objects take ten times the memory.
CSV_ROWS: Final = 1_000


class TableFile(Protocol):
    """A table that is written to an open file. Methods raise OSError if a write fails."""

    def write(self, rows: NDArray[Any]) -> None:
        """Append ``rows``, a structured array with a field for each column."""

    def finish(self) -> None:
        """Write rows that are still in memory, and the end of the file."""

    def abandon(self) -> None:
        """Stop writing: the file will be discarded."""


# Makes a TableFile from an open file, the columns, and texts about the origin of the table.
TableFactory = Callable[[BinaryIO, Sequence[TableColumn], Mapping[str, str]], TableFile]


class CsvFile:
    """CSV: names of the columns in the first line; numbers as the shortest decimals that give the same bits.

    Every NaN is ``nan``.
    """

    def __init__(self, stream: BinaryIO, columns: Sequence[TableColumn], _: Mapping[str, str]) -> None:
        self._stream = stream
        self._lines([[column.name for column in columns]])

    def write(self, rows: NDArray[Any]) -> None:
        for first in range(0, len(rows), CSV_ROWS):
            self._lines(rows[first : first + CSV_ROWS].tolist())

    def finish(self) -> None:
        pass

    def abandon(self) -> None:
        pass

    def _lines(self, rows: Sequence[Sequence[Any]]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        self._stream.write(text.getvalue().encode())


class NpyFile:
    """NPY: one structured array. Raises UsageError if a column holds text.

    Written row by row, not by a memory map: there a full disk would kill the process.
    """

    def __init__(self, stream: BinaryIO, columns: Sequence[TableColumn], _: Mapping[str, str]) -> None:
        texts = [column.name for column in columns if column.type == TEXT]
        if texts:
            raise UsageError(
                f"npy holds numbers, and {', '.join(texts)} are text: export this table as parquet or csv"
            )
        self._stream = stream
        self._type = row_type(columns)
        self._count = 0
        self._write_header()

    def write(self, rows: NDArray[Any]) -> None:
        self._stream.write(rows.tobytes())
        self._count += len(rows)

    def finish(self) -> None:
        self._stream.seek(0)
        self._write_header()

    def abandon(self) -> None:
        pass

    def _write_header(self) -> None:
        # NumPy reserves space for a larger count, so the length of the header does not change.
        header = {
            "descr": npy.dtype_to_descr(self._type),
            "fortran_order": False,
            "shape": (self._count,),
        }
        npy.write_array_header_1_0(self._stream, header)


class ParquetFile:
    """Parquet: with unit and meaning in the metadata of each column, and ``about`` in that of the schema.

    Raises UsageError if pyarrow can't be imported.
    """

    def __init__(self, stream: BinaryIO, columns: Sequence[TableColumn], about: Mapping[str, str]) -> None:
        try:
            import pyarrow as pa
            from pyarrow import parquet
        except ImportError as error:
            raise UsageError(
                f"parquet needs pyarrow, which can't be imported ({error}): "
                "pip install pyarrow, or export as csv or npy"
            ) from error
        types = {NUMBER: pa.float64(), INTEGER: pa.int64(), TEXT: pa.string()}
        fields = [
            pa.field(
                column.name,
                types[column.type],
                nullable=False,
                metadata={"unit": column.unit, "meaning": column.meaning},
            )
            for column in columns
        ]
        self._pa = pa
        self._schema = pa.schema(fields, metadata=dict(about))
        texts = [column.name for column in columns if column.type == TEXT]
        self._waiting: list[NDArray[Any]] = []
        self._held = 0
        self._writer = parquet.ParquetWriter(
            stream,
            self._schema,
            compression="zstd",
            use_dictionary=texts,
            # Stores bytes of equal significance together: a third smaller, and faster than a dictionary.
            use_byte_stream_split=[column.name for column in columns if column.type != TEXT],
        )

    def write(self, rows: NDArray[Any]) -> None:
        self._waiting.append(rows)
        self._held += len(rows)
        if self._held >= ROW_GROUP:
            self._write_group()

    def finish(self) -> None:
        if self._held:
            self._write_group()
        self._writer.close()

    def abandon(self) -> None:
        # Otherwise its destructor would try to complete the file.
        self._writer.is_open = False

    def _write_group(self) -> None:
        rows = np.concatenate(self._waiting)
        self._waiting, self._held = [], 0
        arrays = [
            self._pa.array(np.ascontiguousarray(rows[field.name]), type=field.type) for field in self._schema
        ]
        self._writer.write_table(
            self._pa.Table.from_arrays(arrays, schema=self._schema), row_group_size=len(rows)
        )


FORMATS: Final[Mapping[str, TableFactory]] = {
    "parquet": ParquetFile,
    "csv": CsvFile,
    "npy": NpyFile,
}
