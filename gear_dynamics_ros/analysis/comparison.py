"""Differences of two runs, channel by channel, collected block of samples by block of samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import TURN

# Channels in 0..2 pi: their difference is the shorter way around.
ANGLES: Final = ("driving_angle", "mesh_phase")


class ChannelDifference(NamedTuple):
    """How A and B differ in one channel; values in the channel's unit.

    Two NaN count as equal, 0.0 and -0.0 as different bits of the same value. Samples whose difference is not
    finite, as when only one of them is NaN, are counted in ``undefined_samples`` and left out of ``maximum``
    and ``rms``.
    """

    first_difference: int | None  # index of the first sample whose bits differ
    differing_samples: int  # number of samples whose bits differ
    maximum: float  # of |A - B|
    maximum_at: int | None  # index of that sample; None if the values never differ
    rms: float  # of A - B
    rms_a: float  # of A where it is finite
    undefined_samples: int


class Comparison:
    """Collects the differences of every channel over consecutive blocks of samples."""

    def __init__(self, names: Sequence[str]) -> None:
        """``names`` are the channels, one for each column of the blocks."""
        self.names = tuple(names)
        self.samples = 0
        self._angles = [i for i, name in enumerate(names) if name in ANGLES]
        count = len(self.names)
        self._first, self._maximum_at = (np.full(count, -1, dtype=np.int64) for _ in range(2))
        self._differing, self._undefined, self._scaled = (np.zeros(count, dtype=np.int64) for _ in range(3))
        self._maximum, self._squares, self._scale = (np.zeros(count) for _ in range(3))

    def add(self, first: int, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take in the next block of A and B, shape (n, len(names)), n > 0, from sample index ``first`` on.

        Returns |A - B|, of the same shape, 0 where that is undefined.
        """
        differing = bits_differ(a, b)
        apart = absolute_difference(a, b, self._angles)
        undefined = ~np.isfinite(apart)
        apart[undefined] = 0.0
        self.samples += len(a)
        self._update_first(first, differing)
        self._differing += differing.sum(axis=0)
        self._undefined += undefined.sum(axis=0)
        self._squares += np.einsum("ij,ij->j", apart, apart)
        self._update_maximum(first, apart)
        finite = np.isfinite(a)
        ours = np.where(finite, a, 0.0)
        self._scale += np.einsum("ij,ij->j", ours, ours)
        self._scaled += finite.sum(axis=0)
        return apart

    def _update_first(self, first: int, differing: NDArray[np.bool_]) -> None:
        fresh = (self._first < 0) & differing.any(axis=0)
        self._first[fresh] = first + differing.argmax(axis=0)[fresh]

    def _update_maximum(self, first: int, apart: NDArray[np.float64]) -> None:
        rows = apart.argmax(axis=0)
        found = np.take_along_axis(apart, rows[None, :], axis=0)[0]
        greater = found > self._maximum
        self._maximum[greater] = found[greater]
        self._maximum_at[greater] = first + rows[greater]

    def differences(self) -> dict[str, ChannelDifference]:
        """The differences so far, by channel."""
        defined = np.maximum(self.samples - self._undefined, 1)
        rms = np.sqrt(self._squares / defined)
        scale = np.sqrt(self._scale / np.maximum(self._scaled, 1))
        return {
            name: ChannelDifference(
                first_difference=_index(self._first[i]),
                differing_samples=int(self._differing[i]),
                maximum=float(self._maximum[i]),
                maximum_at=_index(self._maximum_at[i]),
                rms=float(rms[i]),
                rms_a=float(scale[i]),
                undefined_samples=int(self._undefined[i]),
            )
            for i, name in enumerate(self.names)
        }


def bits_differ(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where the bits of ``a`` and ``b`` differ, of their shape; all NaN count as equal."""
    bits: NDArray[np.bool_] = np.ascontiguousarray(a).view(np.int64) != np.ascontiguousarray(b).view(np.int64)
    return bits & ~(np.isnan(a) & np.isnan(b))


def absolute_difference(
    a: NDArray[np.float64], b: NDArray[np.float64], angles: Sequence[int] = ()
) -> NDArray[np.float64]:
    """|A - B| of two arrays of shape (n, k); columns ``angles`` hold angles in rad: the shorter way around.

    0 where both are NaN or the same infinity; not finite where only one of them is.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        apart = a - b
        for column in angles:
            apart[:, column] -= TURN * np.rint(apart[:, column] / TURN)
        apart = np.abs(apart)
    apart[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
    return apart


def _index(number: np.int64) -> int | None:
    return None if number < 0 else int(number)
