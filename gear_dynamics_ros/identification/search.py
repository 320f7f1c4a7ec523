"""Looks for the least cost: first everywhere within the bounds, then downhill from the best points.

An objective may have stages, which regard more and more of its residuals. The search regards those of the
first stage, and so do the first descents. Each later stage descends from the best point of the one before and
from the best of a cloud around it, as wide as its errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.identification.objective import Outcome, Problem
from gear_dynamics_ros.identification.trials import Trials

# The search everywhere ends when its trials lie this close together, in coordinates of the unknowns.
GATHERED: Final = 0.01
TOLERANCE: Final = 1e-8  # of least_squares: relative change of the cost and of the coordinates
MOST_STEPS: Final = 30
# Residuals of impacts have many small valleys: downhill from this many points, this far apart in coordinates.
DESCENTS: Final = 4
APART: Final = 0.02
CLOUD: Final = 10  # points for each unknown that a later stage tries
LATER_DESCENTS: Final = 3
# Of the derivatives at the optimum: steps in coordinates, the smallest as a part of those of the search.
LARGEST_STEP: Final = 0.05
SMALLEST_STEP: Final = 0.1
STEP_TOLERANCE: Final = 0.3
STEP_ROUNDS: Final = 6


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
    jacobian: NDArray[np.float64]  # (m, n), of the residuals by the coordinates, over a standard error
    ending: str  # why the last stage ended


class _LocalErrors(NamedTuple):
    """What the residuals say about the coordinates of a point."""

    jacobian: NDArray[np.float64]  # (m, n)
    steps: NDArray[np.float64]  # (n, n), rows: standard errors along directions that are independent


class _Valley(NamedTuple):
    """Where a descent ended."""

    coordinates: NDArray[np.float64]  # (n,)
    outcome: Outcome
    ending: str


def find_optimum(
    problem: Problem, settings: SearchSettings, trials: Trials, progress: Callable[[Standing], None]
) -> Optimum:
    """Point of least cost within the bounds; the same for any number of workers.

    Raises FitStopped, and GearboxError if no trial could be computed.
    """
    start = np.array([unknown.start(problem.base) for unknown in problem.unknowns])
    first, *later = problem.objective.stages
    _evolve(start, settings, trials, first, progress)
    if trials.best is None:
        reasons = "; ".join(failures.example for failures in trials.failures.values())
        raise GearboxError(
            f"none of the {trials.evaluated} trials could be computed: {reasons}: change the bounds"
        )
    descent = _Descent(problem, trials, progress)
    valleys = [descent.run(point, first) for point in trials.best_apart(DESCENTS, APART)]
    valley, before = min(valleys, key=lambda valley: valley.outcome.cost(first)), first
    chance = np.random.default_rng(settings.seed)
    for regarded in later:
        cloud = _cloud(valley.coordinates, descent.errors_at(valley, before), chance)
        costs = trials.costs(cloud, regarded)
        starts = [valley.coordinates, *cloud[np.argsort(costs, kind="stable")[: LATER_DESCENTS - 1]]]
        valleys = [descent.run(point, regarded) for point in starts]
        valley, before = min(valleys, key=lambda valley: valley.outcome.cost(regarded)), regarded
    jacobian = descent.errors_at(valley, before).jacobian
    return Optimum(valley.coordinates, valley.outcome, jacobian, valley.ending)


def _cloud(
    centre: NDArray[np.float64], errors: _LocalErrors, chance: np.random.Generator
) -> NDArray[np.float64]:
    """Points as the errors scatter them about ``centre``, shape (k, n)."""
    n = len(centre)
    scattered = chance.normal(size=(CLOUD * n, n)) @ errors.steps
    return np.asarray(np.clip(centre + scattered, 0.0, 1.0), dtype=np.float64)


def _evolve(
    start: NDArray[np.float64],
    settings: SearchSettings,
    trials: Trials,
    regarded: int,
    progress: Callable[[Standing], None],
) -> None:
    """Differential evolution; without generations, the start alone."""
    from scipy.optimize import differential_evolution

    if not settings.generations:
        trials.costs(start[None, :], regarded)
        return
    done = 0
    gathered = False

    def costs(points: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal done, gathered
        points = np.ascontiguousarray(points.T)
        found = trials.costs(points, regarded)
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
        self._most_steps = MOST_STEPS * (DESCENTS + LATER_DESCENTS * (len(problem.objective.stages) - 1))

    def run(self, start: NDArray[np.float64], regarded: int) -> _Valley:
        """Valley below ``start``, of the first ``regarded`` residuals."""
        from scipy.optimize import least_squares

        # Coordinates all have the same range, so they need no other scale.
        result: Any = least_squares(
            lambda point: self._outcome(point, regarded).residuals[:regarded],
            start,
            jac=lambda point: self._jacobian(point, regarded),
            bounds=(0.0, 1.0),
            method="trf",
            x_scale=1.0,
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            max_nfev=MOST_STEPS,
        )
        point = np.asarray(result.x)
        return _Valley(point, self._outcome(point, regarded), str(result.message))

    def _outcome(self, point: NDArray[np.float64], regarded: int) -> Outcome:
        key = point.tobytes()
        if key not in self._known:
            (self._known[key],) = self._trials.outcomes(point[None, :], regarded)
            self._steps += 1
            self._progress(_standing("refinement", self._steps, self._most_steps, self._trials))
        return self._known[key]

    def errors_at(self, valley: _Valley, regarded: int) -> _LocalErrors:
        """Errors from a Jacobian over steps of a standard error, along directions that are independent.

        Where an impact begins to appear, residuals change like a square root: a derivative along the axes of
        the unknowns would take that for a slope.
        """
        point, residuals = valley.coordinates, valley.outcome.residuals[:regarded]
        noise = math.sqrt(residual_variance(residuals, len(point)))
        smallest = SMALLEST_STEP * self._objective.difference
        jacobian = self._jacobian(point, regarded)
        for _ in range(STEP_ROUNDS):
            singular, directions = independent_directions(jacobian)
            with np.errstate(divide="ignore"):
                lengths = np.clip(noise / singular, smallest, LARGEST_STEP)
            steps = directions * lengths[:, None]
            before, jacobian = jacobian, self._differences(point, regarded, steps)
            changes = np.linalg.norm((jacobian - before) @ steps.T, axis=0)
            if (changes < STEP_TOLERANCE * noise).all():
                break
        return _LocalErrors(jacobian, steps)

    def _jacobian(self, point: NDArray[np.float64], regarded: int) -> NDArray[np.float64]:
        return self._differences(point, regarded, self._objective.difference * np.eye(len(point)))

    def _differences(
        self, point: NDArray[np.float64], regarded: int, steps: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Jacobian (regarded, n) from differences between both ends of each of ``steps`` (n, n), rows.

        An end that is out of bounds is moved to them; one that can't be computed is replaced by ``point``.
        """
        ends = np.concatenate([np.clip(point - steps, 0.0, 1.0), np.clip(point + steps, 0.0, 1.0)])
        outcomes = self._trials.outcomes(ends, regarded)
        here = self._outcome(point, regarded)
        failed = [bool(outcome.failure) for outcome in outcomes]
        ends[failed] = point
        values = [here if outcome.failure else outcome for outcome in outcomes]
        rows = np.stack([outcome.residuals[:regarded] for outcome in values])
        n = len(point)
        # Of the columns that no end reached, the pseudoinverse makes zeros.
        inverse = np.linalg.pinv(ends[n:] - ends[:n], rcond=1e-9)
        return np.asarray((inverse @ (rows[n:] - rows[:n])).T, dtype=np.float64)


def independent_directions(
    jacobian: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All n singular values of ``jacobian`` (m, n), falling, and their directions (n, n), rows."""
    m, n = jacobian.shape
    padded = np.concatenate([jacobian, np.zeros((max(n - m, 0), n))])
    _, singular, directions = np.linalg.svd(padded, full_matrices=False)
    return singular, directions


def residual_variance(residuals: NDArray[np.float64], fitted: int) -> float:
    """Variance of the noise in residuals after ``fitted`` values were fitted; 1 if there are no more of them.

    Without more data than unknowns, the scales of the data have to count as standard deviations.
    """
    degrees = len(residuals) - fitted
    return float(residuals @ residuals) / degrees if degrees > 0 else 1.0


def _standing(stage: str, done: int, most: int, trials: Trials) -> Standing:
    cost = trials.best.cost if trials.best is not None else float("inf")
    return Standing(stage, done, most, trials.evaluated, trials.failed, cost)
