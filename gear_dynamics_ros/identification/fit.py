"""Makes a fit in a folder: search, errors, result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Problem
from gear_dynamics_ros.identification.search import Optimum, SearchSettings, Standing, find_optimum
from gear_dynamics_ros.identification.trials import Failures, FitStopped, Trials
from gear_dynamics_ros.identification.uncertainty import Uncertainty, uncertainty_of
from gear_dynamics_ros.identification.unknowns import trial_parameters
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.provenance import current_provenance


class Fit(NamedTuple):
    """Result of a fit; of one that was stopped, the best trial so far and no errors."""

    problem: Problem
    coordinates: NDArray[np.float64]
    residuals: NDArray[np.float64]
    optimum: Optimum | None  # None if stopped
    uncertainty: Uncertainty | None  # None if stopped
    stopped: str  # why; empty if the fit is complete
    evaluated: int  # trials
    failures: dict[str, Failures]

    @property
    def parameters(self) -> Parameters:
        """The parameters with the fitted values."""
        return trial_parameters(self.problem.base, self.problem.unknowns, self.coordinates)

    @property
    def values(self) -> NDArray[np.float64]:
        """The fitted values, in the order of the unknowns."""
        pairs = zip(self.problem.unknowns, self.coordinates, strict=True)
        return np.array([unknown.value(float(coordinate)) for unknown, coordinate in pairs])


def request_of(problem: Problem, settings: SearchSettings) -> dict[str, Any]:
    """Everything that decides the result, as JSON holds it."""
    return {
        "parameters": {name: _plain(value) for name, value in problem.base.to_flat().items()},
        "unknowns": [
            {"name": unknown.label, "low": unknown.low, "high": unknown.high} for unknown in problem.unknowns
        ],
        "data": dict(problem.objective.identity()),
        "search": settings._asdict(),
        "provenance": current_provenance()._asdict(),
    }


def run_fit(
    problem: Problem,
    settings: SearchSettings,
    journal: FitJournal,
    workers: int,
    progress: Callable[[Standing], None] = lambda standing: None,
    stopped: Callable[[], str] = lambda: "",
) -> Fit:
    """Make the fit, or go on with it; ``stopped`` returns why to stop early, empty to go on.

    Raises UsageError if there are fewer residuals than unknowns, GearboxError if no trial can be computed or
    a file can't be written.
    """
    _require_enough(problem)
    with Trials(problem, journal, workers, stopped) as trials:
        try:
            optimum = find_optimum(problem, settings, trials, progress)
        except FitStopped as stop:
            return _stopped_fit(problem, trials, str(stop))
    return Fit(
        problem=problem,
        coordinates=optimum.coordinates,
        residuals=optimum.outcome.residuals,
        optimum=optimum,
        uncertainty=uncertainty_of(problem.unknowns, optimum),
        stopped="",
        evaluated=trials.evaluated,
        failures=trials.failures,
    )


def _require_enough(problem: Problem) -> None:
    if problem.objective.count < len(problem.unknowns):
        raise UsageError(
            f"{problem.objective.count} data can't determine {len(problem.unknowns)} unknowns: "
            "give more data or vary less"
        )


def _stopped_fit(problem: Problem, trials: Trials, reason: str) -> Fit:
    best = trials.best
    start = np.array([unknown.start(problem.base) for unknown in problem.unknowns])
    coordinates = start if best is None else best.coordinates
    residuals = problem.outcome(coordinates).residuals
    return Fit(problem, coordinates, residuals, None, None, reason, trials.evaluated, trials.failures)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
