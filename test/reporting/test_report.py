"""The report of a recording: what it says, that it says what summary.json says, and that it prints."""

from __future__ import annotations

import base64
import json
import math
import re
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from matplotlib.image import imread

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis import figures
from gear_dynamics_ros.analysis.energy_flow import energy_flow
from gear_dynamics_ros.chunk import Commands, Counters
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.events import END, OperatorEvent
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.reporting.charts import (
    LEFT,
    RIGHT,
    WIDTH,
    Curve,
    Lane,
    draw_chart,
    nice_ticks,
    thin_out,
    tick_text,
)
from gear_dynamics_ros.reporting.findings import searches_finding
from gear_dynamics_ros.reporting.rendering import percent, quantity
from gear_dynamics_ros.reporting.windows import MOST_WINDOWS, change_times, choose_windows
from support.chromium import needs_chromium, pdf_pages, print_to_pdf, screenshot
from support.pages import Element, parse_page
from support.recordings import following, record

HOSTILE = "<script>alert('x')</script> & \"quoted\""
LIGHT, HEAVY = Commands(30.0, 30.0, 1623.156), Commands(30.0, 45.0, 1623.156)
SECTION = 160  # chunks, of 2 ms: a window of 0.2 s after 0.1 s to settle


class Report(NamedTuple):
    """An analysis on disk."""

    folder: Path
    page: Element
    text: str
    summary: dict[str, Any]


def analyzed(bag: Path, folder: Path, *options: str) -> Report:
    assert analyze_main([str(bag), "--output", str(folder), *options]) == 0
    text = (folder / "report.html").read_text(encoding="utf-8")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return Report(folder, parse_page(text), text, summary)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Light, heavy and light load in turn."""
    deeds: list[Commands | None] = [None] * (3 * SECTION)
    deeds[SECTION], deeds[2 * SECTION] = HEAVY, LIGHT
    path = tmp_path_factory.mktemp("report") / HOSTILE.replace("/", "")
    return record(path, Parameters.from_flat({"rerun.path": HOSTILE}), 3 * SECTION, following(deeds)).path


@pytest.fixture(scope="module")
def report(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    return analyzed(bag, tmp_path_factory.mktemp("out"))


def entry(summary: Any, path: str) -> Any:
    for key in path.split("."):
        summary = summary[int(key)] if isinstance(summary, list) else summary[key]
    return summary


# Self-contained, and safe


def test_the_page_needs_nothing_from_elsewhere(report: Report) -> None:
    for element in report.page.all():
        for name in ("src", "href", "data", "srcset", "action"):
            target = element.attributes.get(name, "#")
            assert target.startswith(("#", "data:image/png;base64,")), target[:80]
    assert not re.search(r"url\((?!#history)|@import", report.text)
    assert set(re.findall(r"https?://[\w./]+", report.text)) == {"http://www.w3.org/2000/svg"}


def test_links_within_the_page_lead_somewhere(report: Report) -> None:
    identities = [element.attributes["id"] for element in report.page.all() if "id" in element.attributes]
    assert len(identities) == len(set(identities))
    targets = {link.attributes["href"].removeprefix("#") for link in report.page.all("a")}
    assert {"provenance", "window_1", "window_2"} <= targets <= set(identities)


def test_hostile_names_are_text(report: Report, bag: Path) -> None:
    assert list(report.page.all("script")) == []
    assert not any(name.startswith("on") for element in report.page.all() for name in element.attributes)
    assert bag.name in report.page.one("h1").text
    assert HOSTILE in report.page.text  # the value of rerun.path


# Numbers


def test_every_number_is_that_of_the_summary(report: Report) -> None:
    shown = {
        element.attributes["data-path"]: element
        for element in report.page.all("data")
        if "data-path" in element.attributes
    }
    assert len(shown) > 60
    for path, element in shown.items():
        value = entry(report.summary, path)
        assert float(element.attributes["value"]) == value, path
        assert re.fullmatch(r"(< )?-?\d[\d.]*(e-?\d+)?", element.text), path
    assert {"run.ldmf", "windows.0.ldmf", "windows.1.meshing_time.back"} <= shown.keys()


def test_a_number_is_shown_with_a_prefix_of_its_unit(report: Report) -> None:
    force = report.summary["windows"][0]["channels"]["mesh_force"]["max"]
    (cell,) = report.page.all("data", data_path="windows.0.channels.mesh_force.max")
    assert float(cell.text) == pytest.approx(1e-3 * force, rel=1e-3)
    assert (percent(0.0), percent(2e-5), percent(0.6576)) == ("0.00", "< 0.01", "65.76")
    assert str(quantity(999.96, "N")) == "1 kN"
    assert str(quantity(-2.5e-5, "m")) == "-25 µm"
    assert str(quantity(1623.156, "rad/s", 6)) == "1623.16 rad/s"
    assert (str(quantity(0.0, "m")), str(quantity(3.0e8, "N/m"))) == ("0 m", "3e+08 N/m")


def test_energies_add_up_to_what_was_put_in(report: Report) -> None:
    flow = report.summary["energy_flow"]
    into, out = (sum(flow[side].values()) for side in ("put_in", "went_to"))
    assert into == pytest.approx(flow["total"], rel=1e-12)
    assert out == pytest.approx(flow["total"], rel=1e-9)
    tables = [table for table in report.page.all("table", class_="energies")]
    assert len(tables) == 2
    for table in tables:
        total = float(table.one("tfoot").one("data").attributes["value"])
        energies = [
            float(cell.attributes["value"])
            for cell in table.all("data")
            if cell.attributes.get("data-path", "").count(".") == 2
        ]
        assert math.fsum(energies) == pytest.approx(flow["total"], rel=1e-9)
        assert total == pytest.approx(flow["total"], rel=1e-9)
    balance = report.summary["energy"]
    assert flow["went_to"]["mesh_loss"] == balance["mesh_loss"]


def test_each_energy_is_on_the_side_of_its_sign() -> None:
    names = ("shaft_work", "excitation_work", "driving_film_work", "driven_film_work", "mesh_loss")
    balance = dict.fromkeys(names, 0.0) | {
        "shaft_work": 10.0, "driving_film_work": -3.0, "mesh_loss": 8.0, "driving_contact_loss": 1.0,
        "driven_contact_loss": 0.0, "kinetic_energy": -2.5, "elastic_energy": 0.25, "residual": -0.25,
    }  # fmt: skip
    flow = energy_flow(balance)
    assert flow.put_in == {"shaft_work": 10.0, "kinetic_energy": 2.5}
    assert sum(flow.went_to.values()) == flow.total == 12.5


# Windows and figures


def test_each_set_of_commands_has_its_latest_steady_window(report: Report) -> None:
    windows = report.summary["windows"]
    assert [window["commands"]["load_torque"] for window in windows] == [45.0, 30.0]
    assert [window["name"] for window in windows] == ["window_1", "window_2"]
    assert [window["from"] for window in windows] == pytest.approx([0.44, 0.76])
    assert report.summary["window"] == {
        key: value for key, value in windows[-1].items() if key in report.summary["window"]
    }


def test_no_more_windows_than_the_bound(tmp_path: Path) -> None:
    short = Parameters.from_flat(
        {"solver.step": 1e-5, "model": "traditional", "recording.topics": ["waveform"]}
    )
    deeds: list[Commands | None] = [None] * (8 * SECTION)
    for number in range(1, 8):
        deeds[number * SECTION] = Commands(30.0, 30.0 + number, 1623.156)
    bag = record(tmp_path / "bag", short, 8 * SECTION, following(deeds))
    windows = choose_windows(bag, change_times(bag), None, None)
    assert len(windows) == MOST_WINDOWS
    assert [w.commands.load_torque for w in windows if w.commands] == [32.0, 33.0, 34.0, 35.0, 36.0, 37.0]


@pytest.mark.parametrize(
    ("change", "starts"),
    [({"mesh.damping_ratio": 0.2}, [0.12, 0.44]), ({"pacing.real_time_factor": 0.5}, [0.44])],
)
def test_a_change_of_the_model_makes_another_window_and_one_of_the_pace_none(
    tmp_path: Path, change: dict[str, float], starts: list[float]
) -> None:
    quick = Parameters.from_flat({"solver.step": 1e-5, "model": "traditional"})
    deeds: list[dict[str, float] | None] = [None] * (2 * SECTION)
    deeds[SECTION] = change
    bag = record(tmp_path / "bag", quick, 2 * SECTION, following(deeds))
    windows = choose_windows(bag, change_times(bag), None, None)
    assert [window.span.start for window in windows] == pytest.approx(starts)


def test_each_window_has_its_figures_with_captions(report: Report) -> None:
    for place, window in enumerate(report.summary["windows"]):
        assert set(window["figures"]) == set(figures.FIGURE_NAMES) - set(figures.RUN_FIGURES)
        assert all((report.folder / file).is_file() for file in window["figures"].values())
        for name in window["figures"]:
            figure = report.page.one("figure", id=f"window_{place + 1}-{name}")
            assert figures.CAPTIONS[name] in figure.one("figcaption").text
    assert report.summary["windows"][-1]["figures"]["spectrum"] == "spectrum.png"
    assert report.summary["windows"][0]["figures"]["spectrum"] == "window_1_spectrum.png"


def test_embedded_pictures_are_those_of_the_files(report: Report, tmp_path: Path) -> None:
    source = report.page.one("figure", id="window_1-spectrum").one("img").attributes["src"]
    embedded = tmp_path / "embedded.png"
    embedded.write_bytes(base64.b64decode(source.removeprefix("data:image/png;base64,")))
    shown, drawn = imread(embedded)[..., :3], imread(report.folder / "window_1_spectrum.png")[..., :3]
    assert shown.shape == drawn.shape
    assert np.abs(shown - drawn).mean() < 0.01


# Time line


def test_commands_and_events_are_listed_and_marked(report: Report) -> None:
    rows = [row.text for table in report.page.all("table", class_="times") for row in table.all("tr")]
    assert "0.320000 load torque 30 to 45 N m" in rows
    assert "0.640000 load torque 45 to 30 N m" in rows
    assert "0.960000 end as asked" in rows
    chart = next(report.page.all("svg"))
    texts = [element.text for element in chart.all("text")]
    assert {"load 45 N m", "load 30 N m", "simulated time (s)", "set-point"} <= set(texts)


def test_a_chart_keeps_peaks_and_corners() -> None:
    time = np.arange(10_000) * 1e-3
    high = np.zeros(10_000)
    high[4321] = 7.0
    _, low, thinned = thin_out(time, np.zeros(10_000), high, 100)
    assert (len(low), thinned.max(), np.count_nonzero(thinned)) == (100, 7.0, 1)
    steps = np.repeat([0.0, 1.0, 0.0], 1000)
    curve = Curve("", "#000", np.arange(3000.0), steps, steps)
    (polygon,) = draw_chart("", [Lane("", curves=[curve])], 0.0, 3000.0, "c", "").lanes[0].curves
    points = [tuple(map(float, point.split(","))) for point in polygon.points.split()]
    left = [x for x, y in points if y == min(y for _, y in points)]
    assert max(left) - min(left) == pytest.approx((WIDTH - LEFT - RIGHT) / 3.0, abs=2.0)


def test_ticks_are_round_numbers_that_can_be_told_apart() -> None:
    for low, high in ((0.0, 10.36), (-68.5, 72.7), (1623.1, 1623.2), (0.0, 3e-5), (999.0, 1001.0)):
        ticks = nice_ticks(low, high, 10)
        assert 4 <= len(ticks) <= 11
        assert len({tick_text(tick, ticks) for tick in ticks}) == len(ticks)
        assert all(low - 1e-9 <= tick <= high + 1e-9 for tick in ticks)


# What is missing or doubtful


def test_what_was_not_recorded_is_said(tmp_path: Path) -> None:
    few = Parameters.from_flat(
        {"recording.topics": ["waveform"], "waveform_channels": ("time", "dte", "mesh_force")}
    )
    bag = record(tmp_path / "bag", few, 8).path
    (bag / "metadata.yaml").unlink()
    report = analyzed(bag, tmp_path / "out")
    missing = [element.text for element in report.page.all(class_="missing")]
    assert "not recorded: energy is not among recording.topics" in missing
    assert "not recorded: impacts are not among recording.topics" in missing
    assert missing.count("not recorded") > 10
    assert {"run.ldmf", "run.meshing_time.apart"}.isdisjoint(
        element.attributes.get("data-path", "") for element in report.page.all("data")
    )
    findings = {finding["subject"]: finding for finding in report.summary["findings"]}
    assert findings["recording"]["status"] == "warning"
    assert findings["recording"]["lines"] == ["metadata.yaml is missing"]
    assert findings["real time"]["status"] == "unknown"
    assert "recording" in report.page.one(class_="verdict bad").text
    assert report.page.one("figure", id="overview")


def test_a_recording_that_lacks_samples_is_analysed_with_a_warning(tmp_path: Path) -> None:
    few = {"recording.topics": ["waveform"], "waveform_channels": ("time", "mesh_force", "load_torque")}
    parts = Parameters.from_flat({"recording.split_duration": 0.1, **few})
    broken = record(tmp_path / "bag", parts, 200).path
    (broken / "bag_1.mcap").unlink()
    found = recording.open(broken)
    assert [len(gap) for gap in found.coverage.gaps] == [10_000]
    report = analyzed(broken, tmp_path / "out")
    assert report.summary["run"]["samples"] == 30_000
    assert report.summary["windows"][0]["from"] == pytest.approx(0.2)
    assert any(
        "10000 samples are missing" in table.text for table in report.page.all("table", class_="facts")
    )


def test_capped_searches_are_told() -> None:
    def ended(capped: int) -> OperatorEvent:
        return OperatorEvent(100, 1e-3, END, "as asked", Counters(500, 40, capped, 3, 20))

    assert searches_finding([ended(0)]).status == "ok"
    found = searches_finding([ended(0), ended(7)])
    assert found.status == "warning"
    assert found.lines[0].startswith("7 searches or steps of 40 switching events")
    assert searches_finding([]).status == "unknown"


# Printed


@needs_chromium
def test_the_report_prints_to_pages(report: Report, tmp_path: Path) -> None:
    offline = tmp_path / "report.html"
    shutil.copy(report.folder / "report.html", offline)
    print_to_pdf(offline, tmp_path / "report.pdf")
    figures_shown = len(list(report.page.all("img")))
    assert figures_shown / 2 <= pdf_pages(tmp_path / "report.pdf") <= figures_shown + 6


@needs_chromium
def test_a_browser_without_a_network_shows_the_report(report: Report, tmp_path: Path) -> None:
    offline = tmp_path / "report.html"
    shutil.copy(report.folder / "report.html", offline)
    screenshot(offline, tmp_path / "report.png", 1000, 1200)
    picture = imread(tmp_path / "report.png")[..., :3]
    # Text, lines and curves all the way down, on a white page.
    assert picture.shape[:2] == (1200, 1000)
    assert np.median(picture) == 1.0
    assert all(strip.std() > 0.02 for strip in np.array_split(picture, 6))
