"""Results of the expectations, as values and text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from gear_dynamics_ros.harness.expectations import Expectation


class Result(NamedTuple):
    """The result of one expectation."""

    expectation: Expectation
    values: tuple[float, ...]  # minimum and maximum for `every`, else one number; empty without samples
    samples: int
    missing: int  # samples of the window that never arrived
    complete: bool  # simulated time has reached the window's end
    left_out: int = 0  # values of a ramp, sine or series before its end that were not in force at any time

    @property
    def passed(self) -> bool:
        """Whether every sample of the window arrived and the measure is within the limits."""
        if not self.complete or self.missing or not self.values:
            return False
        return all(self.expectation.minimum <= value <= self.expectation.maximum for value in self.values)

    @property
    def unjudged(self) -> bool:
        """Whether it did not pass, but was not played as the profile has it: commands came too late."""
        return self.complete and not self.passed and self.left_out > 0

    @property
    def failed(self) -> bool:
        """Whether it did not pass, and the commands were those of the profile."""
        return not (self.passed or self.unjudged)

    @property
    def status(self) -> str:
        """``pass``, ``FAIL``, ``late`` if unjudged, or ``open`` while the window is not over."""
        if not self.complete:
            return "open"
        if self.unjudged:
            return "late"
        return "pass" if self.passed else "FAIL"

    def measured(self) -> str:
        """The measured values as text."""
        if not self.values:
            return "-"
        # Infinite seconds: the channel did not settle.
        if math.inf in self.values and self.expectation.unit == "s":
            return "never"
        return f"{' to '.join(f'{value:.6g}' for value in self.values)} {self.expectation.unit}".rstrip()

    def reason(self) -> str:
        """Why it did not pass: name, window, value and limit."""
        expectation = self.expectation
        head = f"{expectation.name}: {expectation.describe()} in {expectation.window()}"
        if not self.complete:
            return f"{head} was not reached"
        if self.unjudged:
            return f"{head} can't be judged: {self.left_out} values of its commands came too late to act"
        if self.missing:
            return f"{head} lacks {self.missing} of {self.missing + self.samples} samples"
        if not self.values:
            return f"{head} holds no sample: lengthen it"
        return f"{head} is {self.measured()}, expected {expectation.limits()}"


def unreached(expectations: Sequence[Expectation]) -> tuple[Result, ...]:
    """The results of ``expectations`` before anything was played."""
    return tuple(Result(expectation, (), 0, 0, False) for expectation in expectations)


def format_results(results: Sequence[Result]) -> str:
    """A table of the results, one line each, aligned."""
    rows = [
        (
            result.status,
            result.expectation.name,
            result.expectation.window(),
            result.expectation.describe(),
            result.measured(),
            result.expectation.limits(),
        )
        for result in results
    ]
    table = [("", "expectation", "window", "measure", "measured", "expected"), *rows]
    widths = [max(len(row[column]) for row in table) for column in range(6)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
