"""How far two runs are apart, channel by channel, collected over stretches of any length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import TURN

# A step from just below a turn to just above 0 is a small one.
ANGLES: Final = ("driving_angle", "mesh_phase")


class Difference(NamedTuple):
    """How A and B differ in one channel; values in its own unit.

    NaN and NaN count as the same, 0.0 and -0.0 as different bits of the same value. Samples where the
    difference is no finite number, as where one alone is NaN, are counted in ``undefined`` and left out of
    ``greatest`` and ``rms``.
    """

    first: int | None  # sample at which the bits first differ
    unlike: int  # samples at which they do
    greatest: float  # |A - B|
    greatest_at: int | None  # sample; None where the values never differ
    rms: float  # of A - B
    scale: float  # RMS of A where it is finite
    undefined: int


class Comparison:
    """Collects the difference of every channel; feed it all stretches in order."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self.samples = 0
        self._angles = [i for i, name in enumerate(names) if name in ANGLES]
        count = len(self.names)
        self._first, self._greatest_at = (np.full(count, -1, dtype=np.int64) for _ in range(2))
        self._unlike, self._undefined, self._scaled = (np.zeros(count, dtype=np.int64) for _ in range(3))
        self._greatest, self._squares, self._scale = (np.zeros(count) for _ in range(3))

    def add(self, first: int, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """One more stretch from sample ``first`` on, a column each name, shape (n, names), n > 0.

        Returns |A - B| of it, 0 where that is undefined.
        """
        unlike = unlike_bits(a, b)
        apart = distance(a, b, self._angles)
        undefined = ~np.isfinite(apart)
        apart[undefined] = 0.0
        self.samples += len(a)
        self._note_first(first, unlike)
        self._unlike += unlike.sum(axis=0)
        self._undefined += undefined.sum(axis=0)
        self._squares += np.einsum("ij,ij->j", apart, apart)
        self._note_greatest(first, apart)
        finite = np.isfinite(a)
        ours = np.where(finite, a, 0.0)
        self._scale += np.einsum("ij,ij->j", ours, ours)
        self._scaled += finite.sum(axis=0)
        return apart

    def _note_first(self, first: int, unlike: NDArray[np.bool_]) -> None:
        fresh = (self._first < 0) & unlike.any(axis=0)
        self._first[fresh] = first + unlike.argmax(axis=0)[fresh]

    def _note_greatest(self, first: int, apart: NDArray[np.float64]) -> None:
        rows = apart.argmax(axis=0)
        found = np.take_along_axis(apart, rows[None, :], axis=0)[0]
        greater = found > self._greatest
        self._greatest[greater] = found[greater]
        self._greatest_at[greater] = first + rows[greater]

    @property
    def differences(self) -> dict[str, Difference]:
        """What was found, by channel."""
        defined = np.maximum(self.samples - self._undefined, 1)
        rms = np.sqrt(self._squares / defined)
        scale = np.sqrt(self._scale / np.maximum(self._scaled, 1))
        return {
            name: Difference(
                first=_sample(self._first[i]),
                unlike=int(self._unlike[i]),
                greatest=float(self._greatest[i]),
                greatest_at=_sample(self._greatest_at[i]),
                rms=float(rms[i]),
                scale=float(scale[i]),
                undefined=int(self._undefined[i]),
            )
            for i, name in enumerate(self.names)
        }


def unlike_bits(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where the bits differ, of the shape of ``a`` and ``b``; one NaN is like another."""
    bits: NDArray[np.bool_] = np.ascontiguousarray(a).view(np.int64) != np.ascontiguousarray(b).view(np.int64)
    return bits & ~(np.isnan(a) & np.isnan(b))


def distance(
    a: NDArray[np.float64], b: NDArray[np.float64], angles: Sequence[int] = ()
) -> NDArray[np.float64]:
    """|A - B|, columns ``angles`` in rad by the shorter way around; shape (n, k).

    0 where both are NaN or the same infinity; not finite where no number can say.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        apart = a - b
        for column in angles:
            apart[:, column] -= TURN * np.rint(apart[:, column] / TURN)
        apart = np.abs(apart)
    apart[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
    return apart


def _sample(number: np.int64) -> int | None:
    return None if number < 0 else int(number)
