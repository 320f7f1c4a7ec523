"""What a fit makes small: residuals of one set of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.identification.unknowns import Unknown, trial_parameters
from gear_dynamics_ros.parameters import Parameters

# Each residual of a trial that could not be computed: far worse than any that could, and finite.
FAILED_RESIDUAL: Final = 1e3


class Objective(Protocol):
    """Residuals as a function of the parameters; without dimension, about 1 where the data are met badly."""

    @property
    def count(self) -> int:
        """Number of residuals."""

    @property
    def stages(self) -> Sequence[int]:
        """How many of the first residuals each stage of a search regards; rising, the last is ``count``."""

    @property
    def difference(self) -> float:
        """Half the step of numerical derivatives, in coordinates of the unknowns."""

    def residuals(self, parameters: Parameters) -> NDArray[np.float64]:
        """Residuals, shape (count,). Raises GearboxError, with the reason, where the run ends early."""

    def identity(self) -> Mapping[str, Any]:
        """What makes this objective another one than that of another fit, as JSON holds it."""

    def summary(self, residuals: NDArray[np.float64]) -> Mapping[str, Any]:
        """What the residuals say in the units of the data, as JSON holds it."""

    def table(self, residuals: NDArray[np.float64]) -> tuple[Sequence[str], Sequence[Sequence[object]]]:
        """Header and rows of all data beside what the fit gives."""


class Outcome(NamedTuple):
    """Residuals of one trial."""

    residuals: NDArray[np.float64]
    failure: str  # why it could not be computed; empty if it could

    def cost(self, regarded: int) -> float:
        """Half the sum of squares of the first ``regarded`` residuals, as in scipy's least_squares."""
        first = self.residuals[:regarded]
        return 0.5 * float(first @ first)


class Searched(Protocol):
    """What gives an outcome for each point of a space."""

    def outcome(self, coordinates: NDArray[np.float64]) -> Outcome:
        """Residuals at ``coordinates`` (n,), each from 0 to 1, for any thread."""


class Problem(NamedTuple):
    """A fit to make: which numbers to look for, from which parameters, to which data."""

    base: Parameters
    unknowns: tuple[Unknown, ...]
    objective: Objective

    def outcome(self, coordinates: NDArray[np.float64]) -> Outcome:
        """Residuals at ``coordinates`` (n,), for any thread."""
        try:
            parameters = trial_parameters(self.base, self.unknowns, coordinates)
            residuals = self.objective.residuals(parameters)
        except GearboxError as error:
            return Outcome(np.full(self.objective.count, FAILED_RESIDUAL), str(error))
        if not np.isfinite(residuals).all():
            return Outcome(np.full(self.objective.count, FAILED_RESIDUAL), "a residual is not finite")
        return Outcome(residuals, "")
