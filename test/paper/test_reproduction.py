"""All runs, the page, its data and the figures, with a coarse grid and short runs."""

from __future__ import annotations

import json
import subprocess

import pytest

from gear_dynamics_ros.paper.cases import Effort
from gear_dynamics_ros.paper.claims import CLAIMS
from gear_dynamics_ros.paper.momentum import momentum_balances
from gear_dynamics_ros.paper.parameter_sets import PARAMETER_FILE
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS
from gear_dynamics_ros.paper.reproduction import Reproduction, write_report
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.sweeps.point import Measurement
from support.paths import ROOT
from support.processes import executable

COARSE = Effort("coarse", 8000, 0.5, Measurement(transient=100, keep=160, steps_per_period=60))
PNG = b"\x89PNG\r\n"


@pytest.fixture(scope="module")
def report():
    done: list[int] = []
    work = Reproduction(load_parameters(ROOT / PARAMETER_FILE), COARSE, 2)
    made = work.report(lambda: done.append(1))
    assert len(done) == work.runs
    return made


@pytest.fixture(scope="module")
def folder(report, tmp_path_factory):
    made = tmp_path_factory.mktemp("paper")
    write_report(report, made, lambda done, total: None)
    return made


def test_the_data_hold_every_number_and_every_claim(folder) -> None:
    entries = json.loads((folder / "paper.json").read_text(encoding="utf-8"))
    numbers, claims = entries[: len(PRINTED_NUMBERS)], entries[len(PRINTED_NUMBERS) :]
    assert [entry["id"] for entry in numbers] == [number.id for number in PRINTED_NUMBERS]
    keys = {"id", "quantity", "printed", "ours", "difference", "comparable", "verdict"}
    for entry in numbers:
        assert keys <= entry.keys()
        assert entry["comparable"] in ("yes", "order of magnitude", "no")
        if entry["ours"] is not None:
            assert entry["difference"] == entry["ours"] - entry["printed"]
    assert [entry["claim"] for entry in claims] == [claim.number for claim in CLAIMS]
    for entry in claims:
        assert entry["holds"] in (True, False, "mixed")
        assert entry["evidence"]


def test_the_page_names_all_and_shows_every_figure(folder) -> None:
    page = (folder / "paper.md").read_text(encoding="utf-8")
    assert all(f"| {number.id} |" in page for number in PRINTED_NUMBERS)
    assert all(claim.text in page for claim in CLAIMS)
    pictures = sorted(folder.glob("*.png"))
    assert len(pictures) == 13
    for picture in pictures:
        assert picture.read_bytes().startswith(PNG)
        assert f"]({picture.name})" in page


def test_bearings_carry_the_mean_mesh_force_and_no_less(report) -> None:
    for balance in momentum_balances(report.one_set.results):
        assert balance.vector == pytest.approx(balance.limit, rel=0.01)
        assert balance.bearing_force >= balance.limit * 0.99


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((), "--output"), (("--output", "made", "--workers", "0"), "--workers = 0: must be 1 to 1024")],
)
def test_bad_usage_is_told(arguments, words, tmp_path) -> None:
    command = [executable("reproduce"), *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert words in done.stderr
