"""Looks for the sets of open parameters that agree with most of what the paper says."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.trials import Trials
from gear_dynamics_ros.paper.claims import CLAIMS
from gear_dynamics_ros.paper.search_space import COMPARABLE, PaperSearchSpace

POPULATION: Final = 2  # trials a generation, for each unknown


class PaperTrial(NamedTuple):
    """What one set of the open parameters agrees with."""

    coordinates: NDArray[np.float64]  # (n,)
    numbers: frozenset[str]  # ids of the comparable numbers within the limit of agreement
    claims: frozenset[int]  # that hold
    missing: float  # how much does not agree

    @property
    def agreeing(self) -> int:
        """How many numbers and claims agree."""
        return len(self.numbers) + len(self.claims)


def search_paper(
    space: PaperSearchSpace,
    trials: Trials,
    generations: int,
    seed: int,
    progress: Callable[[int], object],
) -> list[PaperTrial]:
    """All trials of a differential evolution that begins with ``space.start``, in their order.

    The start comes first, and then sets spread over the whole space. ``progress`` is called after each
    generation with the number of generations. The same for any number of workers. Raises FitStopped.
    """
    from scipy.optimize import differential_evolution

    found: list[PaperTrial] = []
    done = itertools.count(1)

    def missing(points: NDArray[np.float64]) -> NDArray[np.float64]:
        coordinates = np.ascontiguousarray(points.T)
        if not found:
            coordinates[0] = space.start  # to the bit, which its way through scipy's units may change
        outcomes = trials.outcomes(coordinates, len(COMPARABLE) + len(CLAIMS))
        found.extend(
            _trial(point, outcome.residuals) for point, outcome in zip(coordinates, outcomes, strict=True)
        )
        progress(next(done))
        return np.array([trial.missing for trial in found[-len(coordinates) :]])

    differential_evolution(
        missing,
        [(0.0, 1.0)] * len(space.start),
        maxiter=generations - 1,
        popsize=POPULATION,
        init="sobol",
        tol=0.0,
        seed=np.random.default_rng(seed),
        polish=False,
        updating="deferred",
        vectorized=True,
        x0=space.start,
    )
    return found


def _trial(coordinates: NDArray[np.float64], residuals: NDArray[np.float64]) -> PaperTrial:
    agrees = residuals == 0.0
    return PaperTrial(
        coordinates.copy(),
        frozenset(name for name, agreed in zip(COMPARABLE, agrees[: len(COMPARABLE)], strict=True) if agreed),
        frozenset(
            claim.number for claim, agreed in zip(CLAIMS, agrees[len(COMPARABLE) :], strict=True) if agreed
        ),
        0.5 * float(residuals @ residuals),
    )
