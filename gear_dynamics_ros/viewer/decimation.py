"""Fewer points of a waveform, with every peak kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def extremes(values: NDArray[np.float64], width: int) -> NDArray[np.intp]:
    """Ascending indices of the lowest and highest of every ``width`` consecutive ``values``, shape (n,).

    A last block that is shorter counts as a block; a constant block gives one index. Not-a-number values
    count as extremes, so that they show.
    """
    whole = len(values) // width * width
    blocks = values[:whole].reshape(-1, width)
    starts = np.arange(0, whole, width)
    picked = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)] if whole else []
    tail = values[whole:]
    if len(tail):
        picked.append(whole + np.array([tail.argmin(), tail.argmax()]))
    return np.unique(np.concatenate(picked)) if picked else np.empty(0, dtype=np.intp)
