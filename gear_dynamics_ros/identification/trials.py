"""Computes trials of a fit on several threads, in batches that the journal keeps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Outcome, Problem

LOOK_ROUND: Final = 0.2  # s of wall time between two looks whether to stop


class FitStopped(Exception):
    """Somebody asked the fit to stop; the message is the reason."""


class Failures(NamedTuple):
    """Trials that could not be computed, of one kind."""

    number: int
    example: str  # the first reason


class BestTrial(NamedTuple):
    """The best point so far."""

    coordinates: NDArray[np.float64]
    cost: float


class Trials:
    """Outcomes of the points that a search asks for: from the journal if they are there, else computed."""

    def __init__(
        self, problem: Problem, journal: FitJournal, workers: int, stopped: Callable[[], str]
    ) -> None:
        """``stopped`` returns why to stop, empty to go on; it is called on the thread of the search."""
        self._problem = problem
        self._journal = journal
        self._stopped = stopped
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="identify")
        self.evaluated = 0
        self.failures: dict[str, Failures] = {}  # by kind of reason
        self.best: BestTrial | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def failed(self) -> int:
        """Number of trials that could not be computed."""
        return sum(failures.number for failures in self.failures.values())

    def costs(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cost of each of ``points`` (k, n), shape (k,). Raises FitStopped."""
        if self._journal.replaying:
            batch = self._journal.recall(points)
            costs, reasons = np.asarray(batch["costs"], dtype=np.float64), batch["failures"].tolist()
        else:
            outcomes = self._compute(points)
            costs = np.array([outcome.cost for outcome in outcomes])
            reasons = [outcome.failure for outcome in outcomes]
            self._journal.append({"points": points, "costs": costs, "failures": np.array(reasons)})
        self._count(points, costs, reasons)
        return costs

    def outcomes(self, points: NDArray[np.float64]) -> list[Outcome]:
        """Outcome of each of ``points`` (k, n). Raises FitStopped."""
        if self._journal.replaying:
            batch = self._journal.recall(points)
            pairs = zip(batch["residuals"], batch["failures"].tolist(), strict=True)
            found = [Outcome(residuals, failure) for residuals, failure in pairs]
        else:
            found = self._compute(points)
            residuals = np.stack([outcome.residuals for outcome in found])
            failures = np.array([outcome.failure for outcome in found])
            self._journal.append({"points": points, "residuals": residuals, "failures": failures})
        self._count(points, [outcome.cost for outcome in found], [outcome.failure for outcome in found])
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

    def _count(self, points: NDArray[np.float64], costs: Iterable[float], failures: Iterable[str]) -> None:
        for point, cost, failure in zip(points, costs, failures, strict=True):
            self.evaluated += 1
            if failure:
                kind = failure.split(":")[0].split(" = ")[0]  # without values, which differ
                known = self.failures.get(kind, Failures(0, failure))
                self.failures[kind] = known._replace(number=known.number + 1)
            elif self.best is None or cost < self.best.cost:
                self.best = BestTrial(point.copy(), float(cost))
