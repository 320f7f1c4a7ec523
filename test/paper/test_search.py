"""The search for what the source paper leaves open, and its page."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.trials import Trials
from gear_dynamics_ros.paper.cases import Effort
from gear_dynamics_ros.paper.claims import CLAIMS
from gear_dynamics_ros.paper.parameter_sets import PARAMETER_FILE
from gear_dynamics_ros.paper.results import run_cases
from gear_dynamics_ros.paper.search import PaperTrial, search_paper
from gear_dynamics_ros.paper.search_page import PaperSearch, search_page
from gear_dynamics_ros.paper.search_space import COMPARABLE, one_restitution, own_restitutions
from gear_dynamics_ros.paper.verdicts import AGREES, compare
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.sweeps.point import Measurement, measure
from support.paths import ROOT

BASE = load_parameters(ROOT / PARAMETER_FILE)
COARSE = Effort("coarse", 8000, 0.5, Measurement(60, 100, 60, exponent_intervals=0))


def test_the_space_holds_the_parameter_file() -> None:
    space = one_restitution(BASE)
    found = space.parameter_set(space.start).parameters.to_flat()
    for name, value in BASE.to_flat().items():
        if isinstance(value, float):
            assert found[name] == pytest.approx(value, rel=1e-12, abs=1e-18), name
        elif not isinstance(value, tuple):
            assert found[name] == value, name


def test_each_section_can_have_its_own_restitution() -> None:
    space = own_restitutions(BASE)
    coordinates = space.start.copy()
    coordinates[-3:] = 0.0, 0.5, 1.0
    found = space.parameter_set(coordinates)
    assert dict(found.restitution_by_section) == pytest.approx({"3.1": 0.15, "3.2": 0.575, "3.4": 1.0})
    assert found.parameters.bearings == space.parameter_set(space.start).parameters.bearings


def test_what_is_missing_is_zero_where_the_comparison_agrees() -> None:
    space = replace(one_restitution(BASE), effort=COARSE)
    outcome = space.outcome(space.start)
    comparison = compare(run_cases(space.parameter_set(space.start), COARSE, measure, 1, lambda: None))
    agree = {found.number.id for found in comparison.numbers if found.verdict == AGREES}
    hold = {judged.claim.number for judged in comparison.claims if judged.judgement.holds is True}
    zero = outcome.residuals == 0.0
    assert {name for name, agreed in zip(COMPARABLE, zero[: len(COMPARABLE)], strict=True) if agreed} == agree
    numbers = (claim.number for claim in CLAIMS)
    assert {n for n, agreed in zip(numbers, zero[len(COMPARABLE) :], strict=True) if agreed} == hold
    assert outcome.residuals.max() <= math.sqrt(2.0)
    assert 0 < len(agree) < len(COMPARABLE)


def trial(numbers: set[str], claims: set[int], missing: float) -> PaperTrial:
    return PaperTrial(np.zeros(15), frozenset(numbers), frozenset(claims), missing)


def test_the_page_tells_what_the_others_lose() -> None:
    space = one_restitution(BASE)
    first = trial({"5a-t", "6-4/improved"}, {1, 2}, 50.0)
    other = trial({"5a-t", "5a-c"}, {1}, 51.0)
    worse = trial({"5a-c"}, set(), 60.0)
    page = search_page([PaperSearch("Chapter", space, [first, other, worse])], "command")
    (row,) = [line for line in page.splitlines() if line.startswith("| 5a-c: ")]
    assert row.endswith("| 2 | 2 numbers, 1 claims | 6-4/improved, claim 2 |")
    (row,) = [line for line in page.splitlines() if line.startswith("| 5a-i: ")]
    assert row.endswith("| 0 | - | - |")
    assert "| claim 2: " not in page and "| claim 3: " in page
    assert "0 agree with more than that set" in page
    assert "`bearings.*.clearance` | 1e-05 to 4.5e-05 m" in page


def test_an_interrupted_search_goes_on_with_the_same_trials(tmp_path: Path) -> None:
    space = replace(one_restitution(BASE), effort=Effort("least", 16000, 1.0, Measurement(2, 100, 20, 0)))

    def search(journal: FitJournal) -> list[PaperTrial]:
        with Trials(space, journal, 2, lambda: "") as trials:
            return search_paper(space, trials, 1, 1, lambda done: None)

    found = search(FitJournal.create(tmp_path / "trials", {}))
    again = search(FitJournal.reopen(tmp_path / "trials", {}))
    assert [t.coordinates.tobytes() for t in again] == [t.coordinates.tobytes() for t in found]
    assert [(t.numbers, t.claims, t.missing) for t in again] == [
        (t.numbers, t.claims, t.missing) for t in found
    ]
    assert np.array_equal(found[0].coordinates, space.start)
    assert len({t.missing for t in found}) > 1
