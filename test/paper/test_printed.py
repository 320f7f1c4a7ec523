"""The paper's numbers as data: complete, each with a run and a measure."""

from __future__ import annotations

import pytest

from gear_dynamics_ros.paper.cases import FULL, NAMED_CASES, QUICK, SCANS, needed_cases, scan_cases
from gear_dynamics_ros.paper.measures import MEASURES, is_chaotic, onset_of_chaos
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS, Comparability
from gear_dynamics_ros.paper.results import CaseResult
from gear_dynamics_ros.paper.verdicts import AGREES, DIFFERS, NONE_FOUND, ComparedNumber, compare
from gear_dynamics_ros.sweeps.point import REGIMES
from support.paper_world import world

TABLE = (
    *("5a-t", "5a-c", "5a-i"),
    *(f"5c-{number}" for number in range(1, 8)),
    *(f"6-{number}" for number in range(1, 6)),
    *("7-1", "7-2", "7-3", "8-1"),
    *(f"9-{number}" for number in range(1, 6)),
)
BY_ID = {number.id: number for number in PRINTED_NUMBERS}


def test_every_row_of_the_table_has_numbers_of_its_own() -> None:
    assert len(BY_ID) == len(PRINTED_NUMBERS)
    assert {number.id.split("/")[0] for number in PRINTED_NUMBERS} == set(TABLE)


def test_every_number_has_a_measure_and_a_run() -> None:
    assert set(MEASURES) == set(BY_ID)
    assert {number.case for number in PRINTED_NUMBERS} <= {*NAMED_CASES, *SCANS}


def test_what_can_not_be_compared_says_why() -> None:
    for number in PRINTED_NUMBERS:
        assert bool(number.reason) == (number.comparable is not Comparability.YES), number.id
    impossible = [number.id for number in PRINTED_NUMBERS if number.comparable is Comparability.NO]
    assert impossible == ["6-3/compared"]


@pytest.mark.parametrize("effort", [QUICK, FULL], ids=lambda effort: effort.name)
def test_scans_hold_the_named_speeds_and_no_case_twice(effort) -> None:
    cases = needed_cases(effort)
    assert len(set(cases)) == len(cases)
    for model in ("traditional", "compared", "improved"):
        speeds = [case.speed for case in scan_cases(f"{model} over speed", effort)]
        assert speeds == sorted(set(speeds))
        assert {2520, 3575, 5340, 8740} <= set(speeds)
        assert (speeds[0], speeds[-1]) == (2000, 18000)


@pytest.mark.parametrize(
    "number",
    [
        *("5a-t", "5a-c", "5a-i", "5c-4/traditional", "5c-4/compared", "5c-4/improved", "5c-5/traditional"),
        *("5c-6/compared/share", "5c-6/improved/share", "5c-6/improved/speed", "8-1/largest", "8-1/mean"),
        *("6-1/min", "6-1/max", "6-2/compared/min", "6-2/compared/max", "6-2/improved/max"),
        *("6-5/penetration",),
    ],
)
def test_a_measure_finds_the_printed_number_where_the_results_are_the_papers(number: str) -> None:
    assert MEASURES[number](world()) == pytest.approx(BY_ID[number].printed)


def changed(result: CaseResult, **scalars: float) -> CaseResult:
    return result._replace(point=result.point._replace(scalars={**result.point.scalars, **scalars}))


def test_chaos_begins_where_it_lasts() -> None:
    scan = world().scan("compared over speed")
    calm = [changed(result, regime=REGIMES.index("periodic")) for result in scan]
    single = [
        new if result.case.speed == 4000 else old for result, new, old in zip(scan, scan, calm, strict=True)
    ]
    assert sum(map(is_chaotic, single)) == 1
    assert onset_of_chaos(single) is None
    assert onset_of_chaos(calm) is None
    assert onset_of_chaos([changed(result, section_spread=1e-6) for result in scan]) is None


@pytest.mark.parametrize(
    ("number", "ours", "verdict"),
    [
        ("5a-t", 5340.0 * 1.09, AGREES),
        ("5a-t", 5340.0 * 0.89, DIFFERS),
        ("5a-t", None, NONE_FOUND),
        ("5c-5/compared", 0.014, "same order of magnitude"),
        ("5c-5/compared", 0.016, "other order of magnitude"),
        ("5c-7/9940", 0.0, "other order of magnitude"),
        ("6-2/compared/min", 0.2, AGREES),
        ("6-2/compared/min", 0.3, DIFFERS),
        ("6-3/compared", 374.1, "not comparable"),
    ],
)
def test_verdicts(number: str, ours: float | None, verdict: str) -> None:
    assert ComparedNumber(BY_ID[number], ours).verdict == verdict


def test_totals_count_the_comparable_numbers_alone() -> None:
    totals = compare(world()).totals
    assert totals.comparable == sum(n.comparable is Comparability.YES for n in PRINTED_NUMBERS)
    assert 0 < totals.agreeing < totals.comparable
    assert (totals.claims, totals.true) == (14, 14)
