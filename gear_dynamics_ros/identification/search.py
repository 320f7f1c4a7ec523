"""Looks for the least cost: first everywhere within the bounds, then downhill from the best point."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.identification.objective import Outcome, Problem
from gear_dynamics_ros.identification.trials import Trials

# The search everywhere ends when its trials lie this close together, in coordinates of the unknowns.
GATHERED: Final = 0.01
TOLERANCE: Final = 1e-10  # of least_squares: relative change of the cost and of the coordinates
MOST_STEPS: Final = 60


class SearchSettings(NamedTuple):
    """How long to search."""

    generations: int = 60  # at most; 0: downhill from the start values alone
    population: int = 15  # trials a generation, for each unknown
    seed: int = 0


class Standing(NamedTuple):
    """How far a fit has come."""

    stage: str  # "search" or "refinement"
    done: int  # generations, or steps
    most: int
    evaluated: int  # trials
    failed: int
    cost: float  # least so far; infinite if every trial failed


class Optimum(NamedTuple):
    """Where the search ended."""

    coordinates: NDArray[np.float64]  # (n,)
    outcome: Outcome
    jacobian: NDArray[np.float64]  # (m, n), of the residuals by the coordinates
    ending: str  # why the last stage ended


def find_optimum(
    problem: Problem, settings: SearchSettings, trials: Trials, progress: Callable[[Standing], None]
) -> Optimum:
    """Point of least cost within the bounds; the same for any number of workers.

    Raises FitStopped, and GearboxError if no trial could be computed.
    """
    start = np.array([unknown.start(problem.base) for unknown in problem.unknowns])
    _evolve(start, settings, trials, progress)
    if trials.best is None:
        reasons = "; ".join(failures.example for failures in trials.failures.values())
        raise GearboxError(
            f"none of the {trials.evaluated} trials could be computed: {reasons}: change the bounds"
        )
    return _Descent(problem, trials, progress).run(trials.best.coordinates)


def _evolve(
    start: NDArray[np.float64], settings: SearchSettings, trials: Trials, progress: Callable[[Standing], None]
) -> None:
    """Differential evolution; without generations, the start alone."""
    from scipy.optimize import differential_evolution

    if not settings.generations:
        trials.costs(start[None, :])
        return
    done = 0
    gathered = False

    def costs(points: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal done, gathered
        points = np.ascontiguousarray(points.T)
        found = trials.costs(points)
        gathered = bool((points.std(axis=0) < GATHERED).all())
        done += 1
        progress(_standing("search", done, settings.generations + 1, trials))
        return found

    differential_evolution(
        costs,
        [(0.0, 1.0)] * len(start),
        maxiter=settings.generations,
        popsize=settings.population,
        tol=0.0,
        seed=np.random.default_rng(settings.seed),
        callback=lambda *_: gathered,
        polish=False,
        updating="deferred",
        vectorized=True,  # a whole generation at once, which the threads share
        x0=start,
    )


class _Descent:
    """Least squares within the bounds."""

    def __init__(self, problem: Problem, trials: Trials, progress: Callable[[Standing], None]) -> None:
        self._objective = problem.objective
        self._trials = trials
        self._progress = progress
        self._known: dict[bytes, Outcome] = {}
        self._steps = 0

    def run(self, start: NDArray[np.float64]) -> Optimum:
        from scipy.optimize import least_squares

        # Coordinates all have the same range, so they need no other scale.
        result: Any = least_squares(
            lambda point: self._outcome(point).residuals,
            start,
            jac=self._jacobian,
            bounds=(0.0, 1.0),
            method="trf",
            x_scale=1.0,
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            max_nfev=MOST_STEPS,
        )
        point = np.asarray(result.x)
        return Optimum(point, self._outcome(point), np.asarray(result.jac), str(result.message))

    def _outcome(self, point: NDArray[np.float64]) -> Outcome:
        key = point.tobytes()
        if key not in self._known:
            (self._known[key],) = self._trials.outcomes(point[None, :])
            self._steps += 1
            self._progress(_standing("refinement", self._steps, MOST_STEPS, self._trials))
        return self._known[key]

    def _jacobian(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differences to both sides, or to one where the other is out of bounds or can't be computed."""
        step = self._objective.difference
        n = len(point)
        lower, upper = np.maximum(point - step, 0.0), np.minimum(point + step, 1.0)
        points = np.repeat(point[None, :], 2 * n, axis=0)
        points[range(n), range(n)] = lower
        points[range(n, 2 * n), range(n)] = upper
        outcomes = self._trials.outcomes(points)
        here = self._outcome(point)
        columns = []
        for k in range(n):
            (low, below), (high, above) = (
                (place, outcome) if not outcome.failure else (point[k], here)
                for place, outcome in ((lower[k], outcomes[k]), (upper[k], outcomes[n + k]))
            )
            change = above.residuals - below.residuals
            columns.append(change / (high - low) if high > low else np.zeros_like(change))
        return np.stack(columns, axis=1)


def _standing(stage: str, done: int, most: int, trials: Trials) -> Standing:
    cost = trials.best.cost if trials.best is not None else float("inf")
    return Standing(stage, done, most, trials.evaluated, trials.failed, cost)
