"""Damping factor of an impact that is to deliver a given coefficient of restitution."""

from __future__ import annotations

import math

from scipy.optimize import brentq

SMALLEST_SERIES_ARGUMENT = 1e-2
SERIES_TERMS = 12


def _log_defect(x: float) -> float:
    """(x - ln(1 + x)) / x^2, finite at 0, for x > -1."""
    if abs(x) < SMALLEST_SERIES_ARGUMENT:
        return math.fsum((-x) ** k / (k + 2) for k in range(SERIES_TERMS))
    return (x - math.log1p(x)) / (x * x)


def exact_damping_factor(restitution: float) -> float:
    """Factor a (dimensionless) with which F = k d^n (1 + a v/v0) gives back ``restitution`` exactly.

    Integrating m v dv = -F dd over the impact gives a - ln(1 + a) = -a eta - ln(1 - a eta), whatever k, n
    and the mass; a is the non-zero root in (0, 1/eta), and 0 for an elastic impact.
    """
    if restitution == 1.0:
        return 0.0

    def mismatch(a: float) -> float:
        return _log_defect(a) - restitution**2 * _log_defect(-a * restitution)

    return float(brentq(mismatch, 0.0, math.nextafter(1.0 / restitution, 0.0), xtol=1e-16, rtol=1e-15))


def damping_factor(restitution: float, law: str) -> float:
    """Factor a (dimensionless) of (3) and (6) under ``law``: ``exact`` or ``lankarani_nikravesh``."""
    if law == "exact":
        return exact_damping_factor(restitution)
    return 0.75 * (1.0 - restitution**2)
