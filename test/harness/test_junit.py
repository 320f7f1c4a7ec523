"""JUnit reports: what each testcase says, and that colcon, a reader of others, counts the same."""

from __future__ import annotations

import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from gear_dynamics_ros.cli import drive
from gear_dynamics_ros.harness.junit import PLAYED, JunitReport
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile, parse_profile
from gear_dynamics_ros.harness.results import Result, unreached
from support.processes import executable

INTERVAL = 1e-5


def profile() -> Profile:
    entries = [
        {"name": "calm", "largest": "dte", "from": 0.0, "to": 0.001, "maximum": 2.0},
        {"name": "loud <&> \x01", "largest": "dte", "from": 0.0, "to": 0.001, "minimum": 2.0},
        {"name": "later", "mean": "dte", "from": 0.001, "to": 0.0035, "minimum": 2.0},
    ]
    return parse_profile({"expectations": entries}, Path())


def results(samples: int) -> tuple[Result, ...]:
    player = Player(profile(), ("time", "dte"))
    for first in range(0, samples + 100, 100):
        times = np.arange(first, first + 100) * INTERVAL
        player.feed(np.column_stack([times, np.ones(100)]))
    return player.results()


@pytest.fixture
def report(tmp_path: Path) -> Path:
    return tmp_path / "results" / "drive.xml"


def written(report: Path, results: tuple[Result, ...], failure: str) -> ElementTree.Element:
    report.parent.mkdir()
    JunitReport(report, "load_step").write(results, failure)
    (suite,) = ElementTree.parse(report).getroot().iter("testsuite")
    return suite


def colcon(report: Path) -> list[str]:
    """The counts of colcon test-result: tests, errors, failures, skipped."""
    logs, place = ("--log-base", "/dev/null"), ("--test-result-base", str(report.parent))
    command = [executable("colcon"), *logs, "test-result", *place, "--all"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return done.stdout.splitlines()


def test_a_failure_has_its_numbers(report: Path) -> None:
    suite = written(report, results(400), "")
    calm, loud, later = suite
    assert [case.get("name") for case in suite] == ["calm", "loud <&> \ufffd", "later"]
    assert {case.get("classname") for case in suite} == {"load_step"}
    assert [case.get("time") for case in suite] == ["0.001", "0.001", "0.0025"]
    assert len(calm) == 0
    (failure,) = loud
    assert failure.tag == "failure"
    assert str(failure.get("message")).endswith("is 1 m, expected >= 2 m")
    assert later[0].tag == "failure"
    counts = {key: suite.get(key) for key in ("name", "tests", "failures", "errors", "skipped", "time")}
    assert counts == {
        "name": "drive", "tests": "3", "failures": "2", "errors": "0", "skipped": "0", "time": "0.0045",
    }  # fmt: skip


def test_a_run_that_broke_off_is_an_error(report: Path) -> None:
    suite = written(report, results(200), "/gearbox vanished at 0.002 s")
    assert [[child.tag for child in case] for case in suite] == [[], ["failure"], ["skipped"], ["error"]]
    assert suite[-1].get("name") == PLAYED
    assert suite[-1][0].get("message") == "/gearbox vanished at 0.002 s"
    assert "was not reached" in str(suite[2][0].get("message"))


@pytest.mark.parametrize(
    ("samples", "failure", "counted"),
    [
        (400, "", "3 tests, 0 errors, 2 failures, 0 skipped"),
        (200, "interrupted", "4 tests, 1 error, 1 failure, 1 skipped"),
    ],
)
def test_colcon_counts_the_same(report: Path, samples: int, failure: str, counted: str) -> None:
    written(report, results(samples), failure)
    assert any(line.endswith(counted) for line in colcon(report)), colcon(report)


def test_a_profile_without_expectations_still_tells_how_it_went(report: Path) -> None:
    (case,) = written(report, (), "no gearbox")
    assert case[0].tag == "error"


def test_an_older_report_does_not_outlive_the_start(report: Path) -> None:
    suite = written(report, unreached(profile().expectations), "drive did not end by itself")
    assert [[child.tag for child in case] for case in suite] == [["skipped"]] * 3 + [["error"]]


@pytest.mark.parametrize("path", ["none/results.xml", "."])
def test_an_unwritable_report_is_refused_before_anything_is_played(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str
) -> None:
    (tmp_path / "profile.yaml").write_text("duration: 1.0")
    assert drive.drive_main([str(tmp_path / "profile.yaml"), "--junit", str(tmp_path / path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert line.startswith(f"drive: error: --junit {tmp_path / path}: ")
