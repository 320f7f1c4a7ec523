"""Chooses what is drawn of many samples: every peak of a curve, pictures as under a strobe light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def extreme_indices(values: NDArray[np.float64], width: int, first: int = 0) -> NDArray[np.intp]:
    """Ascending indices of the minimum and maximum of every ``width`` consecutive ``values``, shape (n,).

    Blocks begin at multiples of ``width``, where ``first`` is the number of the first value; those at both
    ends may be shorter. A constant block gives one index. NaN count as extremes, so that they are shown.
    """
    head = min(-first % width, len(values))
    whole = (len(values) - head) // width * width
    blocks = values[head : head + whole].reshape(-1, width)
    starts = head + np.arange(0, whole, width)
    picked = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)] if whole else []
    for begin, part in ((0, values[:head]), (head + whole, values[head + whole :])):
        if len(part):
            picked.append(begin + np.array([part.argmin(), part.argmax()]))
    return np.unique(np.concatenate(picked)) if picked else np.empty(0, dtype=np.intp)


def strobe_indices(
    phase: NDArray[np.float64], frame_ends: NDArray[np.intp], targets: NDArray[np.float64], reach: int
) -> NDArray[np.intp]:
    """A sample for each frame, as under a strobe light: shape (frames,).

    Of the ``reach`` samples before each of ``frame_ends``, the one whose ``phase`` (rad, shape (n,)) is
    nearest to the frame's of ``targets`` (rad). Where less than a whole turn of the phase lies in them, the
    motion is slow enough for the eye: the last one.
    """
    chosen = []
    for end, target in zip(frame_ends.tolist(), targets.tolist(), strict=True):
        begin = max(0, end - reach)
        distance = np.abs(np.mod(phase[begin:end] - target + np.pi, 2.0 * np.pi) - np.pi)
        turned = np.count_nonzero(np.abs(np.diff(phase[begin:end])) > np.pi)
        chosen.append(begin + int(distance.argmin()) if turned > 1 else end - 1)
    return np.array(chosen, dtype=np.intp)


class Density:
    """How far apart the drawn points of a long run are: each time it has doubled, twice as far.

    So each doubling takes half of what the time at full density takes, and no peak is lost: wider blocks keep
    their extremes.
    """

    def __init__(self, full_span: float) -> None:
        """``full_span`` is the time in s, of the run, that is drawn at full density."""
        self._full_span = full_span

    def spacing(self, elapsed: float) -> int:
        """Factor by which points are further apart after ``elapsed`` s: 1, 2, 4 and so on."""
        factor = 1
        while elapsed >= factor * self._full_span:
            factor *= 2
        return factor
