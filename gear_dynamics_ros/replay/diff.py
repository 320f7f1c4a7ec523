"""Compares two recordings in all common channels, sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.comparison import ANGLES, ChannelDifference, Comparison, absolute_difference
from gear_dynamics_ros.analysis.statistics import Envelope, Quantities
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.replay.pairing import Pair

SAMPLES_BEFORE: Final = 40  # of a window around a sample
SAMPLES_AFTER: Final = 120


class RecordingDifference(NamedTuple):
    """Result of one pass through the common samples of two recordings."""

    pair: Pair
    differences: dict[str, ChannelDifference]  # by channel
    envelope: Envelope  # of |A - B|

    @property
    def samples(self) -> int:
        """Number of samples compared."""
        return self.pair.end - self.pair.first

    def same(self) -> bool:
        """Whether both have the same samples and channels with the same bits."""
        more = any(self.pair.extra_channels) or any(map(any, self.pair.extra))
        return not more and not any(found.differing_samples for found in self.differences.values())


def compare_recordings(
    both: Pair, progress: Callable[[int], None] = lambda samples: None
) -> RecordingDifference:
    """Read the common samples of both once, block by block.

    ``progress`` is called with the number of samples compared so far. Raises GearboxError if a recording is
    damaged or has a gap.
    """
    names = both.channels
    comparison, envelope = Comparison(names), Envelope()
    for a, b in both.blocks(names):
        distances = comparison.add(a.first, a.values, b.values)
        envelope.add(a, Quantities(names, distances))
        progress(comparison.samples)
    return RecordingDifference(both, comparison.differences(), envelope)


def first_above(both: Pair, name: str, threshold: float) -> int:
    """Index in A of the first sample with |A - B| >= ``threshold`` in channel ``name``.

    The end of the common samples if there is none. Raises GearboxError as ``compare_recordings`` does.
    """
    for a, b in both.blocks([name]):
        reached = absolute_difference(a.values, b.values, [0] if name in ANGLES else []) >= threshold
        if reached.any():
            return a.first + int(reached.argmax())
    return both.end


def window_around(both: Pair, name: str, sample: int) -> tuple[Samples, NDArray[np.float64]]:
    """Channel ``name`` around the index ``sample`` of A: the samples of A, and the values of B, shape (n,).

    Raises GearboxError as ``compare_recordings`` does.
    """
    near = both._replace(
        first=max(sample - SAMPLES_BEFORE, both.first), end=min(sample + SAMPLES_AFTER, both.end)
    )
    ours, theirs = zip(*near.blocks([name]), strict=True)
    values = np.concatenate([samples.values for samples in ours])
    others = np.concatenate([samples.values[:, 0] for samples in theirs])
    return Samples(near.first, near.interval, (name,), values), others
