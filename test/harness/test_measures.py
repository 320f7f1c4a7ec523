"""Every running measure, fed in chunks of any length, against NumPy on the whole array."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gear_dynamics_ros.harness.measures import (
    STATISTICS,
    FlankShare,
    Measure,
    Reversal,
    SettlingTime,
    Statistic,
)

Samples: TypeAlias = NDArray[np.float64]
INTERVAL_NS = 10_000

# Few different values, so that ties and limits met exactly are common, or any at all.
entries = st.one_of(st.integers(-3, 3).map(float), st.floats(-1e9, 1e9))
arrays = st.lists(entries, min_size=1, max_size=60).map(np.array)
cuts = st.lists(st.integers(1, 59), max_size=8)


def measured(measure: Measure, samples: Samples, edges: Sequence[int]) -> tuple[float, ...]:
    running = measure.begin(INTERVAL_NS)
    for chunk in np.split(samples, sorted(set(edges))):
        if len(chunk):
            running.add(chunk)
    return running.values()


def settling_of_the_whole(samples: Samples) -> float:
    inside = np.abs(samples) <= 1.0
    for first in range(len(samples)):
        if inside[first:].all():
            return first * INTERVAL_NS / 1e9
    return math.inf


def way_back_of_the_whole(samples: Samples) -> float:
    return float(max((samples[: i + 1].max() - samples[i] for i in range(len(samples))), default=0.0))


EXACT: list[tuple[Measure, Callable[[Samples], tuple[float, ...]]]] = [
    (Statistic("every"), lambda samples: (samples.min(), samples.max())),
    (Statistic("smallest"), lambda samples: (samples.min(),)),
    (Statistic("largest"), lambda samples: (samples.max(),)),
    (FlankShare("apart"), lambda samples: (np.mean(samples == 0.0),)),
    (FlankShare("back"), lambda samples: (np.mean(samples == -1.0),)),
    (SettlingTime(-1.0, 1.0, "m"), lambda samples: (settling_of_the_whole(samples),)),
    (Reversal("rising"), lambda samples: (way_back_of_the_whole(samples),)),
    (Reversal("falling"), lambda samples: (way_back_of_the_whole(-samples),)),
]


@pytest.mark.parametrize(
    ("measure", "whole"), EXACT, ids=lambda case: getattr(case, "describe", lambda _: "")("x")
)
@given(samples=arrays, edges=cuts)
def test_chunks_change_nothing(
    measure: Measure, whole: Callable[[Samples], tuple[float, ...]], samples: Samples, edges: list[int]
) -> None:
    assert measured(measure, samples, edges) == whole(samples)


@given(samples=arrays, edges=cuts)
def test_sums_are_exact_to_rounding(samples: Samples, edges: list[int]) -> None:
    rounding = 1e-14 * len(samples) * float(np.abs(samples).max())
    assert measured(Statistic("mean"), samples, edges) == pytest.approx(
        (samples.mean(),), rel=0, abs=rounding
    )
    rms = np.sqrt(np.mean(samples**2))
    assert measured(Statistic("rms"), samples, edges) == pytest.approx((rms,), rel=1e-12)


@given(samples=arrays, edges=cuts, place=st.integers(0, 59))
def test_a_nan_is_never_overlooked(samples: Samples, edges: list[int], place: int) -> None:
    samples = samples.copy()
    samples[place % len(samples)] = math.nan
    for name in STATISTICS:
        assert all(math.isnan(value) for value in measured(Statistic(name), samples, edges))
    for direction in ("rising", "falling"):
        assert all(math.isnan(value) for value in measured(Reversal(direction), samples, edges))
    (settled,) = measured(SettlingTime(-math.inf, math.inf, ""), samples, edges)
    last = place % len(samples) + 1
    assert settled == (math.inf if last == len(samples) else last * INTERVAL_NS / 1e9)


def test_a_long_window_takes_no_memory() -> None:
    chunk = np.random.default_rng(1).normal(size=200)
    running = [measure.begin(INTERVAL_NS) for measure, _ in EXACT]

    def feed(chunks: int) -> None:
        for _ in range(chunks):
            for measure in running:
                measure.add(chunk)

    feed(10)
    tracemalloc.start()
    try:
        feed(2000)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < chunk.nbytes * 10
