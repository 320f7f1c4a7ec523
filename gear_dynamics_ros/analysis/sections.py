"""Poincaré sections at mesh phase 0, and shares of the meshing states."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

TURN: Final = 2.0 * np.pi
FLANKS: Final = (1.0, 0.0, -1.0)  # meshing states: drive flank, apart, back flank


class MeshingShares(NamedTuple):
    """Shares of the samples in each meshing state; their sum is 1."""

    drive: float
    apart: float
    back: float

    @classmethod
    def of(cls, counts: NDArray[np.int64]) -> MeshingShares:
        """Shares from the numbers of samples ``counts``, shape (3,) in the order of FLANKS, not all 0."""
        drive, apart, back = (float(share) for share in counts / counts.sum())
        return cls(drive, apart, back)


def flank_counts(states: NDArray[np.float64]) -> NDArray[np.int64]:
    """How many of the meshing ``states`` (n,) are equal to each of FLANKS, shape (3,)."""
    return np.array([np.count_nonzero(states == flank) for flank in FLANKS], dtype=np.int64)


def mesh_frequency(phase: NDArray[np.float64], interval: float) -> float:
    """Mean mesh frequency in Hz, negative in reverse rotation.

    ``phase`` is the mesh phase in rad, 0 to 2 pi, shape (n,), n > 1, every ``interval`` s; it must advance by
    less than pi from sample to sample.
    """
    unwrapped = np.unwrap(phase)
    return float((unwrapped[-1] - unwrapped[0]) / (TURN * (len(phase) - 1) * interval))


def poincare_points(phase: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """``values``, shape (n, k), interpolated to where ``phase`` (rad), shape (n,), wraps; shape (points, k).

    The instant is interpolated linearly in the phase, the values by the cubic through the two samples before
    and the two after; a wrap in the first or last interval is left out. Both senses of rotation count.
    """
    turns = np.unwrap(phase) / TURN
    whole = np.floor(turns)
    before = np.flatnonzero(np.diff(whole) != 0.0)
    before = before[(before >= 1) & (before + 2 < len(phase))]
    level = np.maximum(whole[before], whole[before + 1])
    fraction = (level - turns[before]) / (turns[before + 1] - turns[before])
    points: NDArray[np.float64] = sum(
        (
            weight[:, None] * values[before + offset]
            for offset, weight in zip((-1, 0, 1, 2), lagrange_weights(fraction), strict=True)
        ),
        start=np.zeros((len(before), values.shape[1])),
    )
    return points


def lagrange_weights(fraction: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Weights of the samples at -1, 0, 1, 2 in a cubic's value at ``fraction`` (0 to 1), shape (n,) each."""
    s = fraction
    return (
        -s * (s - 1.0) * (s - 2.0) / 6.0,
        (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0,
        -(s + 1.0) * s * (s - 2.0) / 2.0,
        (s + 1.0) * s * (s - 1.0) / 6.0,
    )
