"""What the data say about the values of a fit: standard errors, correlations, and what they leave open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.search import (
    Optimum,
    independent_directions,
    residual_variance,
)
from gear_dynamics_ros.identification.unknowns import Unknown

# A direction along which the residuals change less than this, against the best determined one, is flat: such
# a change is lost in the rounding of numerical derivatives.
FLAT: Final = 1e-6
# A direction is weak if one standard error along it is more than this part of the range of an unknown.
WEAK: Final = 0.25
# An unknown this close to a bound, in coordinates, and pressed against it, counts as at the bound.
AT_BOUND: Final = 1e-3
# Unknowns with less than this part in a flat direction are determined without it.
NO_PART: Final = 1e-3
NAMED_PART: Final = 0.05  # unknowns with less are not named in a direction


class Direction(NamedTuple):
    """A common change of several unknowns that hardly changes the residuals."""

    flat: bool  # no change at all, within rounding; otherwise the noise hides it
    ratio: float  # singular value, against the greatest
    changes: Mapping[str, float]  # relative changes by label; the greatest is 1

    @property
    def text(self) -> str:
        """In words."""
        parts = [f"{label} {change:+.3g} %" for label, change in self.changes.items()]
        what = " with ".join(parts)
        if len(parts) == 1:
            label = next(iter(self.changes))
            return f"{label}: the data " + ("don't depend on it" if self.flat else "hardly depend on it")
        return f"{what}: " + ("no change of the residuals" if self.flat else "less change than the noise")


class Uncertainty(NamedTuple):
    """Errors of the fitted values. Arrays have NaN for unknowns that the data don't determine."""

    variance: float  # of a residual
    degrees: int  # residuals less unknowns; 0: the scales of the targets count as standard errors
    standard_errors: NDArray[np.float64]  # (n,), in the units of the unknowns
    covariance: NDArray[np.float64]  # (n, n)
    correlation: NDArray[np.float64]  # (n, n)
    at_bound: tuple[bool, ...]  # held fixed there for the errors of the others
    directions: tuple[Direction, ...]  # flat ones first


def uncertainty_of(unknowns: Sequence[Unknown], optimum: Optimum) -> Uncertainty:
    """Errors from the Jacobian at the optimum, scaled by the variance of the residuals."""
    n = len(unknowns)
    values = np.array([unknown.value(u) for unknown, u in zip(unknowns, optimum.coordinates, strict=True)])
    at_bound = _at_bound(optimum)
    free = [k for k in range(n) if not at_bound[k]]
    degrees = len(optimum.outcome.residuals) - len(free)
    variance = residual_variance(optimum.outcome.residuals, len(free))
    covariance = np.full((n, n), math.nan)
    directions: tuple[Direction, ...] = ()
    if free:
        chosen = [unknowns[k] for k in free]
        part, directions = _free_covariance(chosen, values[free], optimum.jacobian[:, free], variance)
        covariance[np.ix_(free, free)] = part
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    return Uncertainty(variance, max(degrees, 0), errors, covariance, correlation, at_bound, directions)


def _at_bound(optimum: Optimum) -> tuple[bool, ...]:
    gradient = optimum.jacobian.T @ optimum.outcome.residuals
    return tuple(
        bool((u < AT_BOUND and slope > 0.0) or (u > 1.0 - AT_BOUND and slope < 0.0))
        for u, slope in zip(optimum.coordinates, gradient, strict=True)
    )


def _free_covariance(
    unknowns: Sequence[Unknown], values: NDArray[np.float64], jacobian: NDArray[np.float64], variance: float
) -> tuple[NDArray[np.float64], tuple[Direction, ...]]:
    """Covariance of the unknowns, and the directions that the data leave open."""
    slopes = np.array([unknown.slope(value) for unknown, value in zip(unknowns, values, strict=True)])
    widths = np.array([unknown.width for unknown in unknowns])
    # Relative changes, so that a product of two unknowns shows as +1 % with -1 %.
    scales = np.maximum(np.abs(values), 1e-3 * widths)
    singular, rows = independent_directions(jacobian * (scales / slopes))
    greatest = max(float(singular.max()), np.finfo(float).tiny)
    flat = singular <= FLAT * greatest
    directions = []
    undetermined = np.zeros(len(unknowns), dtype=bool)
    relative = np.zeros((len(unknowns), len(unknowns)))
    for value, row, is_flat in zip(singular[::-1], rows[::-1], flat[::-1], strict=True):
        if is_flat:
            undetermined |= np.abs(row) > NO_PART
        else:
            relative += variance / value**2 * np.outer(row, row)
            spread = math.sqrt(variance) / value * np.abs(row) * scales / widths
            if spread.max() <= WEAK:
                continue
        directions.append(_direction(unknowns, row, bool(is_flat), float(value / greatest)))
    covariance = relative * np.outer(scales, scales)
    covariance[undetermined, :] = covariance[:, undetermined] = math.nan
    return covariance, tuple(directions)


def _direction(unknowns: Sequence[Unknown], row: NDArray[np.float64], flat: bool, ratio: float) -> Direction:
    changes = row / row[np.abs(row).argmax()]
    labels = [unknown.label for unknown in unknowns]
    named = {
        label: float(change)
        for label, change in zip(labels, changes, strict=True)
        if abs(change) > NAMED_PART
    }
    return Direction(flat, ratio, named)
