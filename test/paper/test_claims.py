"""The paper's claims, judged on results that agree with them and on their opposite."""

from __future__ import annotations

import math

import pytest

from gear_dynamics_ros.paper.claims import CLAIMS, MIXED, ClaimCheck, judge
from gear_dynamics_ros.paper.momentum import momentum_balances
from gear_dynamics_ros.paper.waveforms import apart_share, lifts_per_period, loop_area, mesh_periods
from support.paper_world import opposite, world

OF_THE_SURFACE_ALONE = 14  # its results do not depend on runs


def test_there_are_fourteen() -> None:
    assert [claim.number for claim in CLAIMS] == list(range(1, 15))


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: str(claim.number))
def test_a_claim_holds_where_the_results_are_the_papers(claim) -> None:
    judgement = judge(claim.checks(world()))
    assert judgement.holds is True, judgement.evidence


@pytest.mark.parametrize(
    "claim", [c for c in CLAIMS if c.number != OF_THE_SURFACE_ALONE], ids=lambda claim: str(claim.number)
)
def test_a_claim_does_not_hold_where_they_are_the_opposite(claim) -> None:
    judgement = judge(claim.checks(world(opposite)))
    assert judgement.holds is not True, judgement.evidence
    assert ": no" in judgement.evidence


@pytest.mark.parametrize("number", [1, 10])
def test_a_claim_is_false_where_nothing_of_it_is_so(number: int) -> None:
    assert judge(CLAIMS[number - 1].checks(world(opposite))).holds is False


def test_a_claim_of_which_a_part_is_so_is_mixed() -> None:
    judgement = judge([ClaimCheck("first", True), ClaimCheck("second", False)])
    assert judgement.holds == MIXED
    assert judgement.evidence == "first: yes; second: no"


def test_loops_and_lifts_of_a_known_motion() -> None:
    samples = world().waveforms["restitution 0.2"]
    assert mesh_periods(samples) == pytest.approx(20.0, rel=1e-3)
    # Force 40 N cos against penetration 1 um sin: an ellipse.
    assert loop_area(samples, "driving") == pytest.approx(math.pi * 40.0 * 1e-6, rel=2e-3)
    assert apart_share(samples, "driving") == pytest.approx(0.5, abs=0.01)
    assert lifts_per_period(samples, "driving") == pytest.approx(1.0, rel=0.06)


def test_the_balance_of_momentum_forbids_what_the_paper_prints_without_a_film() -> None:
    balances = {balance.model: balance for balance in momentum_balances(world())}
    assert balances["compared"].limit == pytest.approx(532.0889, abs=1e-4)
    assert {model: balance.possible for model, balance in balances.items()} == {
        "traditional": False,
        "compared": False,
        "improved": True,
    }
