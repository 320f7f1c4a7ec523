"""Computes trials of a fit on several threads, in batches that the journal keeps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Outcome, Searched

LOOK_ROUND: Final = 0.2  # s of wall time between two looks whether to stop


class FitStopped(Exception):
    """Somebody asked the fit to stop; the message is the reason."""


class Failures(NamedTuple):
    """Trials that could not be computed, of one kind."""

    number: int
    example: str  # the first reason


class ComputedTrial(NamedTuple):
    """A trial that could be computed."""

    coordinates: NDArray[np.float64]
    cost: float
    regarded: int  # residuals in the cost


class Trials:
    """Outcomes of the points that a search asks for: from the journal if they are there, else computed."""

    def __init__(
        self, problem: Searched, journal: FitJournal, workers: int, stopped: Callable[[], str]
    ) -> None:
        """``stopped`` returns why to stop, empty to go on; it is called on the thread of the search."""
        self._problem = problem
        self._journal = journal
        self._stopped = stopped
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="identify")
        self.evaluated = 0
        self.failures: dict[str, Failures] = {}  # by kind of reason
        self._computed: list[ComputedTrial] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def failed(self) -> int:
        """Number of trials that could not be computed."""
        return sum(failures.number for failures in self.failures.values())

    @property
    def best(self) -> ComputedTrial | None:
        """The best trial of the latest stage, the first of several; None if none could be computed."""
        return min(self._computed, key=lambda trial: (-trial.regarded, trial.cost), default=None)

    def best_apart(self, most: int, distance: float) -> list[NDArray[np.float64]]:
        """Points of the best trials, at most ``most``, each farther than ``distance`` from the better ones.

        The distance is that of the coordinate in which two points differ most.
        """
        chosen: list[NDArray[np.float64]] = []
        for trial in sorted(self._computed, key=lambda trial: trial.cost):
            if len(chosen) == most:
                break
            if all(np.abs(trial.coordinates - other).max() > distance for other in chosen):
                chosen.append(trial.coordinates)
        return chosen

    def costs(self, points: NDArray[np.float64], regarded: int) -> NDArray[np.float64]:
        """Cost of each of ``points`` (k, n) by its first ``regarded`` residuals, shape (k,).

        Raises FitStopped.
        """
        if self._journal.replaying:
            batch = self._journal.recall(points)
            costs, reasons = np.asarray(batch["costs"], dtype=np.float64), batch["failures"].tolist()
        else:
            outcomes = self._compute(points)
            costs = np.array([outcome.cost(regarded) for outcome in outcomes])
            reasons = [outcome.failure for outcome in outcomes]
            self._journal.append({"points": points, "costs": costs, "failures": np.array(reasons)})
        self._count(points, costs, reasons, regarded)
        return costs

    def outcomes(self, points: NDArray[np.float64], regarded: int) -> list[Outcome]:
        """Outcome of each of ``points`` (k, n), for a stage that regards that many residuals.

        Raises FitStopped.
        """
        if self._journal.replaying:
            batch = self._journal.recall(points)
            pairs = zip(batch["residuals"], batch["failures"].tolist(), strict=True)
            found = [Outcome(residuals, failure) for residuals, failure in pairs]
        else:
            found = self._compute(points)
            residuals = np.stack([outcome.residuals for outcome in found])
            failures = np.array([outcome.failure for outcome in found])
            self._journal.append({"points": points, "residuals": residuals, "failures": failures})
        costs = [outcome.cost(regarded) for outcome in found]
        self._count(points, costs, [outcome.failure for outcome in found], regarded)
        return found

    def _compute(self, points: NDArray[np.float64]) -> list[Outcome]:
        futures = [self._pool.submit(self._problem.outcome, point) for point in points]
        try:
            return [self._wait(future) for future in futures]
        finally:
            for future in futures:
                future.cancel()

    def _wait(self, future: Future[Outcome]) -> Outcome:
        while True:
            if reason := self._stopped():
                raise FitStopped(reason)
            try:
                return future.result(LOOK_ROUND)
            except NotYet:
                pass

    def _count(
        self,
        points: NDArray[np.float64],
        costs: Iterable[float],
        failures: Iterable[str],
        regarded: int,
    ) -> None:
        for point, cost, failure in zip(points, costs, failures, strict=True):
            self.evaluated += 1
            if failure:
                kind = failure.split(":")[0].split(" = ")[0]  # without values, which differ
                known = self.failures.get(kind, Failures(0, failure))
                self.failures[kind] = known._replace(number=known.number + 1)
            else:
                self._computed.append(ComputedTrial(point.copy(), float(cost), regarded))
