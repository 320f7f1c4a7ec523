"""identify as a user types it: fits, goes on after Ctrl-C, and says what is wrong."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from gear_dynamics_ros.cli.identify import identify_main
from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.parameters import Parameters, load_parameters, updated
from support.paths import CONFIG
from support.processes import StartProcess, until
from support.sensor_noise import record_with_noise
from support.terminal import error_line

TRUTH = {"bearings.driving.clearance": 31e-6, "bearings.driven.clearance": 31e-6}
VARIED = "bearings.*.clearance=20e-6:40e-6"
RESULTS = {"parameters.yaml", "result.json", "residuals.csv", "report.txt"}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "bag"
    return record_with_noise(path, updated(Parameters(), TRUTH), {"driving_x": 5e-8, "driving_y": 5e-8}, 0.01)


def command(bag: Path, output: Path, *more: str) -> list[str]:
    data = ["--recording", str(bag), "--channels", "driving_x,driving_y", "--to", "0.002"]
    start = ["--params-file", str(CONFIG / "gearbox.yaml"), "--vary", VARIED]
    return [*start, *data, "--output", str(output), "--generations", "6", *more]


def test_a_clearance_is_found_and_simulate_loads_it(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "fit"
    assert identify_main(command(bag, output)) == 0
    shown = capsys.readouterr().out
    assert "Fit by identify, complete" in shown and "bearings.*.clearance" in shown
    result = json.loads((output / "result.json").read_text())
    (clearance,) = result["unknowns"]
    assert result["complete"] is True
    assert abs(clearance["value"] - 31e-6) < 3.0 * clearance["standard_error"] < 1e-7
    assert clearance["parameters"] == list(TRUTH)
    header, first, *_ = (output / "residuals.csv").read_text().splitlines()
    assert header == "time,driving_x_recorded,driving_x_fitted,driving_y_recorded,driving_y_fitted"
    assert len(first.split(",")) == 5
    assert {path.name for path in output.iterdir()} == RESULTS | {"fit.json", "evaluations"}

    bearings = load_parameters(output / "parameters.yaml").bearings
    assert bearings.driving.clearance == bearings.driven.clearance == clearance["value"]
    again = ["--params-file", str(output / "parameters.yaml"), "--duration", "0.002"]
    assert simulate_main([*again, "--output", str(tmp_path / "again")]) == 0


def test_a_fit_starts_from_the_parameters_of_the_recording_if_no_file_is_given(
    bag: Path, tmp_path: Path
) -> None:
    words = command(bag, tmp_path / "fit", "--set", "bearings.driven.clearance=25e-6")[2:]
    assert identify_main([*words, "--workers", "1"]) == 0
    fitted = load_parameters(tmp_path / "fit" / "parameters.yaml")
    assert fitted.bearings.driving.clearance == fitted.bearings.driven.clearance


def test_ctrl_c_leaves_a_result_and_resume_finishes_it_to_the_bit(
    process: StartProcess, bag: Path, tmp_path: Path
) -> None:
    more = ("--vary", "oil.viscosity=0.01:0.06", "--generations", "12", "--population", "8")
    whole, part = tmp_path / "whole", tmp_path / "part"
    assert identify_main(command(bag, whole, *more)) == 0

    fitting = process("identify", *command(bag, part, *more))
    until(lambda: (part / "evaluations" / "000002.npz").exists(), "some batches")
    fitting.signal(signal.SIGINT)
    assert fitting.wait() == 128 + signal.SIGINT
    assert "interrupted by SIGINT" in fitting.stderr and "--resume" in fitting.stderr
    told = json.loads((part / "result.json").read_text())
    assert (told["complete"], told["stopped"]) == (False, "SIGINT")
    assert told["unknowns"][0]["standard_error"] is None

    assert identify_main(command(bag, part, *more, "--resume", "--workers", "1")) == 0
    for name in RESULTS:
        assert (part / name).read_bytes() == (whole / name).read_bytes(), name


def test_targets_are_fitted(tmp_path: Path) -> None:
    table = tmp_path / "table.yaml"
    table.write_text(
        "transient: 20\nkeep: 5\nconditions: {operation.control: torque, operation.speed: 200.0}\n"
        "targets: [{quantity: dte_mean, value: 3.3e-5, scale: 1.0e-7}]\n"
    )
    words = ["--targets", str(table), "--vary", "mesh.stiffness=2e8:4e8", "--generations", "0"]
    assert identify_main([*words, "--output", str(tmp_path / "fit")]) == 0
    result = json.loads((tmp_path / "fit" / "result.json").read_text())
    assert result["fit"]["targets"][0]["fitted"] == pytest.approx(3.3e-5, abs=1e-8)
    assert result["degrees_of_freedom"] == 0
    assert "No more data than unknowns" in (tmp_path / "fit" / "report.txt").read_text()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--vary", "mesh.stiffnes=1:2"), "did you mean mesh.stiffness"),
        (("--vary", "mesh.stiffness=2e8:1e8"), "must be less than"),
        (("--vary", "operation.load_torque=20:40"), "the recording gives it"),
        (("--channels", "dte,speed"), "there is no channel 'speed'"),
        (("--from", "0.003"), "is empty"),
        (("--set", "solver.step=3e-6"), "whole number"),
    ],
)
def test_bad_requests_are_refused_before_anything_is_made(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], told: str
) -> None:
    assert identify_main(command(bag, tmp_path / "fit", *words)) == 2
    assert told in error_line(capsys, "identify")
    assert not (tmp_path / "fit").exists()


def test_options_that_do_not_belong_together_are_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["--output", str(tmp_path / "fit"), "--vary", VARIED]
    assert identify_main([*output, "--recording", str(bag)]) == 2
    assert "needs --channels" in error_line(capsys, "identify")
    assert identify_main([*output, "--targets", "x.yaml", "--from", "1.0"]) == 2
    assert "--from is for --recording" in error_line(capsys, "identify")
    assert identify_main([*output, "--targets", str(tmp_path / "none.yaml")]) == 2
    assert "can't be read" in error_line(capsys, "identify")


def test_the_folder_of_another_fit_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "fit"
    assert identify_main(command(bag, output, "--generations", "0")) == 0
    capsys.readouterr()
    assert identify_main(command(bag, output)) == 2
    assert "exists already" in error_line(capsys, "identify")
    assert identify_main(command(bag, output, "--resume", "--seed", "7", "--generations", "0")) == 2
    assert "search.seed is 0 there and 7 here" in error_line(capsys, "identify")


def test_a_range_in_which_every_trial_trips_is_an_error(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--set", "operation.speed_limit=1623.2", "--generations", "0")
    assert identify_main(command(bag, tmp_path / "fit", *words)) == 1
    assert "none of the 1 trials could be computed: over-speed" in error_line(capsys, "identify")
