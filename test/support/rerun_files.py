"""What stands in a Rerun file, and Rerun's own command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rerun = Callable[..., str]


class Rows(NamedTuple):
    """Values of a component over simulated time, in order of time."""

    times_ns: NDArray[np.int64]
    values: list[Any]


def rows_of(path: Path, entity: str, component: str, timeline: str) -> Rows:
    """Every value of a component of an entity, as Rerun's own reader gives them; static ones left out."""
    from rerun.chunk import RrdReader

    times: list[int] = []
    values: list[Any] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path != entity or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        if component not in batch.schema.names:
            continue
        times.extend(batch.column(timeline).cast("int64").to_pylist())
        values.extend(batch.column(component).to_pylist())
    order = np.argsort(times, kind="stable")
    return Rows(np.array(times, dtype=np.int64)[order], [values[index] for index in order])
