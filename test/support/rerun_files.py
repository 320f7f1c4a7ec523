"""What stands in a Rerun file, and Rerun's own command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rerun = Callable[..., str]


class Rows(NamedTuple):
    """Values of a component over a timeline, in order of time."""

    times_ns: NDArray[np.int64]
    values: list[Any]


def rows_of(path: Path, entity: str, component: str, timeline: str) -> Rows:
    """Every value of a component of an entity on a timeline, as Rerun's own reader gives them."""
    from rerun.chunk import RrdReader

    times: list[int] = []
    values: list[Any] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path != entity or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        if not {component, timeline} <= set(batch.schema.names):
            continue
        times.extend(batch.column(timeline).cast("int64").to_pylist())
        values.extend(batch.column(component).to_pylist())
    order = np.argsort(times, kind="stable")
    return Rows(np.array(times, dtype=np.int64)[order], [values[index] for index in order])


def fixed_value(path: Path, entity: str, component: str) -> Any:
    """The last static value of a component of an entity."""
    from rerun.chunk import RrdReader

    found = None
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity and chunk.is_static:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                found = batch.column(component).to_pylist()[-1]
    assert found is not None, f"{entity} has no {component}"
    return found
