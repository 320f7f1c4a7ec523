"""The report of a run of the test harness, of profiles played to a made waveform."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.outcome import ProfileOutcome
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile, parse_profile
from gear_dynamics_ros.harness.results import unreached
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.reporting.drive_report import DriveReport
from support.pages import Element, parse_page

INTERVAL = 1e-5
CHUNK = 100
CHANNELS = ("time", "dte", "driving_speed", "meshing_state", "load_torque")
HOSTILE = "<script>alert('x')</script>"
PROFILE: dict[str, Any] = {
    "description": HOSTILE,
    "duration": 0.02,
    "parameters": {"operation.control": "speed"},
    "commands": {"load_torque": [{"at": 0.0, "value": 20.0}, {"at": 0.005, "value": 45.0}]},
    "expectations": [
        {"name": "calm", "largest": "dte", "from": 0.002, "to": 0.01, "maximum": 2.0},
        {"name": HOSTILE, "mean": "driving_speed", "from": 0.0, "to": 0.02, "minimum": 500.0},
        {"name": "flank", "share": "drive", "from": 0.01, "to": 0.02, "minimum": 0.4},
        {"name": "settles", "settling": "driving_speed", "from": 0.0, "to": 0.01, "target": 400.0,
         "tolerance": 5.0, "within": 0.005},
        {"name": "rises", "monotone": "driving_speed", "direction": "rising", "from": 0.0, "to": 0.02},
        {"name": "rms", "rms": "dte", "from": 0.0, "to": 0.02, "maximum": 1.0},
    ],
}  # fmt: skip
GEARBOX = {
    "version": "0.0.9",
    "kernel_hash": "cafe",
    "model_hash": "beef",
    "parameters": Parameters.from_flat({"oil.viscosity": 0.05}).to_flat(),
}
PEAK = 777  # the sample with the peak of DTE
LATE = 30  # samples by which commands act after the chunk edge


def waveform(first: int, count: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    index = np.arange(first, first + count)
    dte = np.where(index == PEAK + CHUNK, 1.5, 0.1 * np.sin(0.3 * index))
    speed = np.full(count, 400.0)
    state = np.where(index % 2 == 0, 1.0, 0.0)
    return np.column_stack([index * INTERVAL, dte, speed, state, np.full(count, 20.0)])


def played(samples: int, failure: str = "", signal: int = 0, data: Any = PROFILE) -> ProfileOutcome:
    """Outcome of a run of which ``samples`` arrived after profile time 0."""
    profile = parse_profile(data, Path())
    player = Player(profile, CHANNELS)
    player.feed(waveform(0, CHUNK))
    given: dict[str, float] = {}
    for first in range(CHUNK, samples + CHUNK, CHUNK):
        if player.commands() != given:
            given = player.commands()
            player.acted(first + LATE, Commands(30.0, given["load_torque"], 400.0))
        player.feed(waveform(first, CHUNK))
    return ProfileOutcome(
        player.results(), 2, player.lateness, 0.9, "", failure, signal, player.samples(), GEARBOX
    )


def page_of(path: Path, outcome: ProfileOutcome, data: Any = PROFILE) -> Element:
    report = DriveReport(
        path, profile_of(data), Path("some/load_step.yaml"), "/gearbox", "by hand", {"a": HOSTILE}
    )
    report.write(outcome)
    return parse_page(path.read_text(encoding="utf-8"))


def profile_of(data: Any) -> Profile:
    return parse_profile(data, Path())


@pytest.fixture
def page(tmp_path: Path) -> Element:
    return page_of(tmp_path / "report.html", played(2200))


def test_each_expectation_has_its_result_and_its_plot(page: Element, tmp_path: Path) -> None:
    outcome = played(2200)
    rows = [row for row in page.all("tr") if list(row.all("a"))]
    assert [row.one("a").text for row in rows] == ["calm", HOSTILE, "flank", "settles", "rises", "rms"]
    for number, result in enumerate(outcome.results, start=1):
        assert result.measured() in rows[number - 1].text
        assert result.expectation.limits() in rows[number - 1].text
        figure = page.one("figure", id=f"window-{number}")
        assert result.expectation.name in figure.one("h3").text
        assert len(list(figure.all("svg"))) == 1
        assert any(figure.all("polyline")) or any(figure.all("polygon"))
    assert page.one(class_="verdict bad").text == "FAILED: 1 of 6 expectations do not hold."


def test_limits_and_peaks_are_drawn(page: Element) -> None:
    calm = page.one("figure", id="window-1").one("svg")
    (limit,) = (box for box in calm.all("rect") if box.attributes.get("stroke", "").startswith("#009E73"))
    top = float(limit.attributes["y"])
    (curve,) = calm.all("polygon")
    heights = [float(point.split(",")[1]) for point in curve.attributes["points"].split()]
    frame = next(box for box in calm.all("rect") if box.attributes.get("fill") == "none")
    bottom = float(frame.attributes["y"]) + float(frame.attributes["height"])
    # The peak of 1.5 m lies at three quarters of the limit of 2 m, with -0.1 m as the least value.
    assert (bottom - min(heights)) / (bottom - top) == pytest.approx(1.6 / 2.1, abs=0.05)


def test_how_late_commands_acted_is_told(page: Element) -> None:
    outcome = played(2200)
    assert [acted.value for acted in outcome.samples.acted] == [20.0, 45.0] if outcome.samples else False
    late = [float(each.attributes["value"]) for each in page.one("section").all("data")]
    assert late == [pytest.approx(np.median(outcome.lateness)), pytest.approx(max(outcome.lateness))]
    # The second is due between two chunks, given at the end of the first and acts in the next.
    assert outcome.lateness == pytest.approx([LATE * INTERVAL, CHUNK * INTERVAL])


def test_hostile_names_are_text_and_nothing_comes_from_elsewhere(page: Element) -> None:
    assert list(page.all("script")) == []
    assert page.text.count(HOSTILE) >= 4
    targets = {e.attributes[k] for e in page.all() for k in ("href", "src") if k in e.attributes}
    assert all(target.startswith("#") for target in targets)
    identities = [element.attributes["id"] for element in page.all() if "id" in element.attributes]
    assert len(identities) == len(set(identities))
    assert {target.removeprefix("#") for target in targets} <= set(identities)


def test_the_gearbox_and_the_environment_are_named(page: Element) -> None:
    facts = page.one("h2", id="environment")
    assert facts.text == "Environment"
    text = page.text
    for part in ("0.0.9", "cafe", "beef", "oil.viscosity", "50 mPa s", "by hand", "load_step.yaml"):
        assert part.replace("50 mPa s", "0.05 Pa s") in text


@pytest.mark.parametrize(
    ("failure", "signal", "words"),
    [("/gearbox disappeared at 0.008 s", 0, "BROKE OFF: "), ("interrupted by SIGINT", 2, "INTERRUPTED: ")],
)
def test_a_run_that_broke_off_says_so_and_shows_what_came(
    tmp_path: Path, failure: str, signal: int, words: str
) -> None:
    page = page_of(tmp_path / "report.html", played(800, failure, signal))
    assert page.one(class_="verdict bad").text == words + failure
    statuses = [cell.text for cell in page.all("td") if "status" in cell.attributes.get("class", "")]
    assert statuses == ["open"] * 6
    assert any(page.one("figure", id="window-1").all("svg"))
    assert "No sample of this window arrived." in page.one("figure", id="window-3").text


def test_a_report_stands_from_the_start_on(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    report = DriveReport(path, profile_of(PROFILE), Path("p.yaml"), "/gearbox", "by hand", {})
    report.write_unfinished()
    page = parse_page(path.read_text(encoding="utf-8"))
    assert "BROKE OFF: drive did not end by itself" in page.one(class_="verdict bad").text
    assert "not yet" in page.text


def test_a_gearbox_that_was_never_heard_of_is_reported(tmp_path: Path) -> None:
    expectations = profile_of(PROFILE).expectations
    outcome = ProfileOutcome(unreached(expectations), 0, [], 0.0, "", "no gearbox was seen", 0)
    page = page_of(tmp_path / "report.html", outcome)
    assert "no gearbox was seen" in page.one(class_="verdict bad").text
    assert "nothing was received" in page.text


def test_a_place_that_cannot_be_written_is_refused_and_an_earlier_report_stays(tmp_path: Path) -> None:
    report = DriveReport(tmp_path / "none" / "r.html", profile_of(PROFILE), Path("p"), "/g", "", {})
    with pytest.raises(UsageError, match=r"--report: can't write '.*r\.html': No such file or directory"):
        report.write_unfinished()
