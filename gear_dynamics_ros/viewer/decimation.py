"""Reduces the points of a curve and keeps every peak."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def extreme_indices(values: NDArray[np.float64], width: int) -> NDArray[np.intp]:
    """Ascending indices of the minimum and maximum of every ``width`` consecutive ``values``, shape (n,).

    The last block may be shorter; a constant block gives one index. NaN count as extremes, so that they are
    shown.
    """
    whole = len(values) // width * width
    blocks = values[:whole].reshape(-1, width)
    starts = np.arange(0, whole, width)
    picked = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)] if whole else []
    tail = values[whole:]
    if len(tail):
        picked.append(whole + np.array([tail.argmin(), tail.argmax()]))
    return np.unique(np.concatenate(picked)) if picked else np.empty(0, dtype=np.intp)
