"""Analysis against closed forms, and ``analyze`` on a real recording."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import shutil
import signal
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from gear_dynamics_ros.analysis import figures, ledger, sections, spectra
from gear_dynamics_ros.analysis.statistics import Envelope, Quantities, Statistics, derived_quantities
from gear_dynamics_ros.analysis.summary import TimeSpan, steady_window
from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import base_radii
from gear_dynamics_ros.system.processes import Interruption
from support.recordings import following, record
from support.terminal import error_line

INTERVAL = 1e-5
FIGURES = (
    *("overview", "meshing_shares", "time_series", "pressure_angle", "spectrum", "phase_portrait"),
    *("orbits", "bearing_force"),
)


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.mod(angle, 2.0 * np.pi)


# Spectrum


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.5, 0.9])
def test_amplitude_and_frequency_of_a_sine_wherever_it_lies_between_bins(offset: float) -> None:
    count, amplitude = 20_000, 3.7e-6
    frequency = (2000.0 + offset) / (count * INTERVAL)
    values = 2.5e-5 + amplitude * np.cos(2.0 * np.pi * frequency * INTERVAL * np.arange(count) + 0.3)
    line = spectra.strongest_lines(spectra.amplitude_spectrum(values, INTERVAL), 1)[0]
    assert line.amplitude == pytest.approx(amplitude, rel=1e-3)
    assert line.frequency == pytest.approx(frequency, abs=0.05 / (count * INTERVAL))


def test_lines_come_in_order_of_height_and_a_weak_one_beside_a_strong_one_is_found() -> None:
    time = INTERVAL * np.arange(30_000)
    parts = {10_333.3: 1.0e-5, 5_166.65: 1.6e-6, 10_533.3: 4.0e-9}
    values = sum(a * np.sin(2.0 * np.pi * f * time) for f, a in parts.items())
    lines = spectra.strongest_lines(spectra.amplitude_spectrum(np.asarray(values), INTERVAL), 3)
    for line, (frequency, amplitude) in zip(lines, parts.items(), strict=True):
        assert line.frequency == pytest.approx(frequency, abs=0.5)
        assert line.amplitude == pytest.approx(amplitude, rel=1e-3 if amplitude > 1e-8 else 0.02)


def test_a_constant_has_no_lines() -> None:
    spectrum = spectra.amplitude_spectrum(np.full(1000, 2.0**-15), INTERVAL)
    assert spectra.strongest_lines(spectrum, 3) == []


def test_too_short_for_a_spectrum() -> None:
    with pytest.raises(ValueError, match="at least 40"):
        spectra.amplitude_spectrum(np.zeros(39), INTERVAL)


# Sections


@pytest.mark.parametrize("rate", [0.647, -0.647])
def test_poincare_points_of_a_motion_locked_to_the_mesh_coincide(rate: float) -> None:
    phase = 0.2 + rate * np.arange(5000)
    motion = np.column_stack([np.cos(phase + 0.4), -np.sin(phase + 0.4)])
    points = sections.poincare_points(wrapped(phase), motion)
    expected = np.array([[math.cos(0.4), -math.sin(0.4)]])
    assert len(points) == pytest.approx(abs(rate) * 5000 / (2.0 * np.pi), abs=2)
    # Error bound of the cubic: 0.0234 rate^4 of the amplitude.
    np.testing.assert_allclose(points, np.broadcast_to(expected, points.shape), atol=0.0235 * rate**4)


def test_poincare_points_of_a_subharmonic_are_two() -> None:
    phase = 0.05 * np.arange(20_000)
    points = sections.poincare_points(wrapped(phase), np.cos(0.5 * phase + 0.3)[:, None])[:, 0]
    np.testing.assert_allclose(points[0::2], points[0], atol=1e-6)
    np.testing.assert_allclose(points[1::2], -points[0], atol=1e-6)


def test_poincare_points_lie_where_the_phase_wraps() -> None:
    phase = 1.0 + 0.013 * np.arange(3000)
    instants = sections.poincare_points(wrapped(phase), np.arange(3000.0)[:, None])[:, 0]
    expected = (2.0 * np.pi * np.arange(1, 7) - 1.0) / 0.013
    np.testing.assert_allclose(instants, expected, atol=1e-9)


def test_standing_gears_give_no_points() -> None:
    assert sections.poincare_points(np.full(100, 0.5), np.zeros((100, 2))).shape == (0, 2)


@pytest.mark.parametrize("frequency", [10_333.3, -4_000.0])
def test_mesh_frequency(frequency: float) -> None:
    phase = wrapped(2.0 * np.pi * frequency * INTERVAL * np.arange(1000))
    assert sections.mesh_frequency(phase, INTERVAL) == pytest.approx(frequency, rel=1e-12)


def test_meshing_shares() -> None:
    states = np.repeat([1.0, 0.0, -1.0], [60, 30, 10])
    shares = sections.MeshingShares.of(sections.flank_counts(states))
    assert shares == pytest.approx((0.6, 0.3, 0.1))


# Statistics and envelope


def stretch(first: int, values: NDArray[np.float64], names: tuple[str, ...]) -> Samples:
    return Samples(first, INTERVAL, names, values)


def test_totals_do_not_depend_on_the_pieces() -> None:
    names = ("time", "dte", "meshing_state", "load_torque")
    time = INTERVAL * np.arange(10_000)
    state = np.where(np.arange(10_000) < 2_500, -1.0, 1.0)
    values = np.column_stack([time, np.sin(2.0 * np.pi * 1000.0 * time), state, np.full(10_000, -30.0)])
    found = Statistics()
    for first, end in ((0, 1), (1, 4000), (4000, 10_000)):
        samples = stretch(first, values[first:end], names)
        found.add(samples, derived_quantities(samples))
    dte = found.totals()["dte"]
    assert (dte.minimum, dte.maximum) == (values[:, 1].min(), values[:, 1].max())
    assert dte.mean == pytest.approx(0.0, abs=1e-12)
    assert dte.rms == pytest.approx(math.sqrt(0.5), rel=1e-12)
    assert found.meshing_shares() == pytest.approx((0.75, 0.0, 0.25))
    assert found.mean_load_torque() == pytest.approx(30.0)


def test_bearing_force_is_that_of_contact_and_film_together() -> None:
    names = tuple(name for name in CHANNEL_NAMES if name.startswith("driving_") and "force" in name)
    assert names[0] == "driving_contact_force_x"
    samples = stretch(0, np.array([[3.0, 1.0, 0.0, 3.0]]), names)
    assert samples.bearing_force("driving").tolist() == [5.0]
    assert derived_quantities(samples).names[-1] == "driving_bearing_force"
    assert not samples.has_bearing_force("driven")


def test_envelope_holds_every_peak_of_a_run_longer_than_its_capacity() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(30_011, 1))
    envelope = Envelope(capacity=64)
    first = 700
    for begin in range(0, len(values), 997):
        piece = values[begin : begin + 997]
        envelope.add(stretch(first + begin, piece, ("dte",)), Quantities(("dte",), piece))
    low, high = envelope.bounds("dte")
    width = 512
    blocks = [values[begin : begin + width, 0] for begin in range(0, len(values), width)]
    np.testing.assert_array_equal(low, [block.min() for block in blocks])
    np.testing.assert_array_equal(high, [block.max() for block in blocks])
    assert envelope.times()[0] == pytest.approx((first + (width - 1) / 2) * INTERVAL)


# Window


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([], (9.8, 10.0)),
        ([5.0], (9.8, 10.0)),
        ([5.0, 9.75], (9.55, 9.75)),
        ([9.9], (9.7, 9.9)),
        ([0.05 * k for k in range(200)], (9.8, 10.0)),
    ],
)
def test_default_window_keeps_clear_of_changes(changes: list[float], expected: tuple[float, float]) -> None:
    assert steady_window(TimeSpan(0.0, 10.0), changes) == pytest.approx(expected)


def test_a_short_run_is_its_own_window() -> None:
    assert steady_window(TimeSpan(0.0, 0.05), [0.02]) == TimeSpan(0.0, 0.05)


# The command


def loaded(path: Path, parameters: Parameters, chunks: int) -> Path:
    """Recording of a run whose load rises to 45 N m after a quarter."""
    commands: list[Commands | None] = [None] * chunks
    commands[chunks // 4] = Commands(30.0, 45.0, 1623.156)
    return record(path, parameters, chunks, following(commands)).path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return loaded(
        tmp_path_factory.mktemp("analysis") / "bag", Parameters.from_flat({"solver.step": 1e-6}), 240
    )


class Analysed(NamedTuple):
    """What one call of analyze wrote and said."""

    output: Path
    said: str
    warned: str


@pytest.fixture(scope="module")
def analysed(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Analysed:
    output = tmp_path_factory.mktemp("analysed") / "new" / "figures"
    with redirect_stdout(io.StringIO()) as said, redirect_stderr(io.StringIO()) as warned:
        assert analyze_main([str(bag), "--output", str(output)]) == 0
    return Analysed(output, said.getvalue(), warned.getvalue())


def test_analyze_draws_and_counts(analysed: Analysed) -> None:
    output = analysed.output
    pictures = [f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg")]
    files = ["report.html", "summary.json", "impacts.csv", *pictures]
    assert analysed.said.splitlines() == [str(output / name) for name in files]
    assert analysed.warned.startswith("analyze: no order_map: no run-up: ")
    assert analysed.warned.count("\n") == 1
    for name in FIGURES:
        picture = imread(output / f"{name}.png")
        assert picture.shape[0] > 500
        assert picture[:, :, :3].std() > 0.03
        assert 10_000 < (output / f"{name}.svg").stat().st_size < 300_000, name
    found = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert found["samples"] == 48_000
    assert found["duration"] == pytest.approx(0.48)
    assert found["commands"] == 2
    assert (found["window"]["from"], found["window"]["to"]) == pytest.approx((0.28, 0.48))
    assert sum(found["run"]["meshing_shares"].values()) == pytest.approx(1.0)
    window = found["window"]
    assert window["samples"] == 20_000
    assert window["channels"]["driving_speed"]["unit"] == "rad/s"
    static = 45.0 / base_radii(Parameters())[1]
    assert window["static_mesh_force"] == pytest.approx(static)
    assert window["ldmf"] == pytest.approx(window["channels"]["mesh_force"]["max"] / static)
    speed = window["channels"]["driving_speed"]["mean"]
    assert window["mesh_frequency"] == pytest.approx(40 * speed / (2.0 * math.pi), rel=1e-4)
    assert window["poincare"]["points"] == pytest.approx(0.2 * window["mesh_frequency"], abs=2)


def test_analyze_balances_the_energy_and_lists_the_impacts(analysed: Analysed) -> None:
    found = json.loads((analysed.output / "summary.json").read_text(encoding="utf-8"))
    energy, impacts = found["energy"], found["impacts"]
    assert (energy["from"], energy["to"]) == pytest.approx((0.002, 0.48))
    assert energy["mesh_loss"] > 0.0
    assert energy["stored"] == pytest.approx(energy["kinetic_energy"] + energy["elastic_energy"])
    assert abs(energy["residual"]) < 1e-6 * energy["exchanged"]
    with (analysed.output / impacts["list"]).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ledger.CSV_HEADER.split(",")
    for gear in ("driving", "driven"):
        mine = [row for row in rows if row["bearing"] == gear]
        assert impacts[gear]["count"] == len(mine) > 0
        assert impacts[gear]["max_peak_force"] == max(float(row["peak_force"]) for row in mine)


def test_a_recording_without_the_ledger_has_none_and_no_other_analysis_remains_beside(
    analysed: Analysed, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    shutil.copytree(analysed.output, output)
    (output / "notes.txt").write_text("mine")
    few = Parameters.from_flat(
        {"recording.topics": ["waveform"], "waveform_channels": ("time", "dte", "dte_rate", "mesh_force")}
    )
    loaded(tmp_path / "bag", few, 8)
    assert analyze_main([str(tmp_path / "bag"), "--output", str(output)]) == 0
    found = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert (found["energy"], found["impacts"]) == (None, None)
    assert sorted(os.listdir(output)) == [
        *("notes.txt", "overview.png", "overview.svg", "phase_portrait.png", "phase_portrait.svg"),
        "report.html",
        *("spectrum.png", "spectrum.svg", "summary.json", "time_series.png", "time_series.svg"),
    ]


def test_an_analysis_that_fails_leaves_the_earlier_one(
    bag: Path, analysed: Analysed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "out"
    shutil.copytree(analysed.output, output)
    before = {path.name: path.read_bytes() for path in output.iterdir()}

    def interrupt(*_: object) -> None:
        raise Interruption(signal.SIGTERM)

    monkeypatch.setattr(figures, "write_png", interrupt)
    assert analyze_main([str(bag), "--output", str(output), "--to", "0.1"]) == 128 + signal.SIGTERM
    assert {path.name: path.read_bytes() for path in output.iterdir()} == before
    monkeypatch.undo()
    (output / ".new.part").mkdir()  # as a killed process leaves it
    assert analyze_main([str(bag), "--output", str(output), "--to", "0.1"]) == 0
    assert not (output / ".new.part").exists()


def test_a_recording_without_waveform_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loaded(tmp_path / "bag", Parameters.from_flat({"recording.topics": ["dte"]}), 8)
    assert analyze_main([str(tmp_path / "bag"), "--output", str(tmp_path / "out")]) == 2
    assert "has no waveform, which was not among recording.topics" in error_line(capsys, "analyze")


def test_analyze_takes_energies_as_channels(tmp_path: Path) -> None:
    loaded(tmp_path / "bag", Parameters.from_flat({"waveform_channels": tuple(COLUMN)}), 8)
    assert analyze_main([str(tmp_path / "bag"), "--output", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert found["run"]["channels"]["kinetic_energy"]["unit"] == "J"


def test_analyze_takes_the_window_asked_for(bag: Path, tmp_path: Path) -> None:
    assert analyze_main([str(bag), "--output", str(tmp_path), "--from", "0.1", "--to", "0.15"]) == 0
    window = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["window"]
    assert (window["from"], window["to"], window["samples"]) == (
        pytest.approx(0.1),
        pytest.approx(0.15),
        5000,
    )


def test_analyze_draws_what_a_subset_of_channels_allows(tmp_path: Path) -> None:
    parameters = Parameters.from_flat({"waveform_channels": ("time", "dte", "mesh_force")})
    loaded(tmp_path / "bag", parameters, 8)
    assert analyze_main([str(tmp_path / "bag"), "--output", str(tmp_path / "out")]) == 0
    drawn = {path.stem for path in (tmp_path / "out").glob("*.png")}
    assert drawn == {"overview", "time_series", "spectrum"}
    found = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert found["window"]["meshing_shares"] is None
    assert found["window"]["ldmf"] is None
    assert found["window"]["mesh_frequency"] is None
    assert found["window"]["dte_spectrum"]["lines"][0]["order"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--from", "0.4", "--to", "9"], "--from 0.4 --to 9 s leaves the recording"),
        (["--from", "0.4", "--to", "0.3"], "--from 0.4 --to 0.3 s holds 0 samples"),
        (["--from", "nan"], "give finite times"),
    ],
)
def test_windows_that_cannot_be_meant(
    bag: Path, tmp_path: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert analyze_main([str(bag), "--output", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_output_that_is_a_file_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    assert analyze_main([str(bag), "--output", str(file)]) == 2
    assert "is a file: name a folder" in capsys.readouterr().err
    assert file.read_text(encoding="utf-8") == "kept"


def test_no_recording_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analyze_main([str(tmp_path / "none"), "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith("analyze: error: no recording at")
