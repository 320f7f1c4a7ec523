"""Printed and computed numbers side by side, each with a verdict, and how many agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from gear_dynamics_ros.paper.claims import CLAIMS, MIXED, Claim, Judgement, judge
from gear_dynamics_ros.paper.measures import MEASURES
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS, Comparability, PrintedNumber
from gear_dynamics_ros.paper.results import PaperResults

AGREEMENT: Final = 0.1  # relative difference up to which two numbers agree
MAGNITUDE: Final = 10.0  # factor up to which they are of one order of magnitude
AGREES: Final = "within 10 %"
DIFFERS: Final = "differs"
SAME_MAGNITUDE: Final = "same order of magnitude"
OTHER_MAGNITUDE: Final = "other order of magnitude"
NONE_FOUND: Final = "none found"
NOT_COMPARABLE: Final = "not comparable"


class ComparedNumber(NamedTuple):
    """A printed number beside ours, both in its unit."""

    number: PrintedNumber
    ours: float | None  # None where the runs do not show what is asked for

    @property
    def difference(self) -> float | None:
        """Ours less the printed one."""
        return None if self.ours is None else self.ours - self.number.printed

    @property
    def relative(self) -> float | None:
        """The difference in parts of the printed number, or of its scale."""
        if self.difference is None:
            return None
        return self.difference / abs(self.number.scale or self.number.printed)

    @property
    def verdict(self) -> str:
        """One of the words above."""
        if self.number.comparable is Comparability.NO:
            return NOT_COMPARABLE
        if self.ours is None or self.relative is None:
            return NONE_FOUND
        if self.number.comparable is Comparability.ORDER_OF_MAGNITUDE:
            ratio = self.ours / self.number.printed
            return SAME_MAGNITUDE if 1.0 / MAGNITUDE <= ratio <= MAGNITUDE else OTHER_MAGNITUDE
        return AGREES if abs(self.relative) <= AGREEMENT else DIFFERS


class JudgedClaim(NamedTuple):
    """A claim of the paper and its judgement."""

    claim: Claim
    judgement: Judgement


class Totals(NamedTuple):
    """How many numbers agree, and how many claims hold."""

    comparable: int
    agreeing: int
    claims: int
    true: int
    mixed: int


class PaperComparison(NamedTuple):
    """Everything that the paper says, beside what the runs under one set of parameters gave."""

    results: PaperResults
    numbers: Sequence[ComparedNumber]
    claims: Sequence[JudgedClaim]

    @property
    def totals(self) -> Totals:
        """The counts of both."""
        verdicts = [found.verdict for found in self.numbers if found.number.comparable is Comparability.YES]
        holds = [found.judgement.holds for found in self.claims]
        true = sum(value is True for value in holds)
        return Totals(len(verdicts), verdicts.count(AGREES), len(holds), true, holds.count(MIXED))


def compare(results: PaperResults) -> PaperComparison:
    """Every printed number and every claim beside ``results``."""
    return PaperComparison(
        results,
        [ComparedNumber(number, _known(MEASURES[number.id](results))) for number in PRINTED_NUMBERS],
        [JudgedClaim(claim, judge(claim.checks(results))) for claim in CLAIMS],
    )


def _known(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)
