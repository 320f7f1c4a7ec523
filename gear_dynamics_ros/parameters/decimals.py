"""Exact ratios of decimal numbers: 1e-5 s / 1e-6 s is 10, which binary floats do not say."""

from __future__ import annotations

from fractions import Fraction


def exact_decimal(value: float) -> Fraction:
    """The shortest decimal that reads as ``value``: the number that the user wrote, exact.

    Raises ValueError if ``value`` is not finite.
    """
    return Fraction(repr(value))


def exact_text(value: float) -> str:
    """``value`` in as few characters as read back to it, so that a limit and what exceeds it differ."""
    short = f"{value:.9g}"
    return short if float(short) == value else repr(value)
