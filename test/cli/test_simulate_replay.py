"""simulate and replay as a user types them: records, verifies, and says what is wrong."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path

import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.parameters import Parameters, load_parameters, updated
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.engine import Engine
from support.paths import CONFIG
from support.processes import StartProcess, until
from support.recordings import perform


def simulate(output: Path, *words: str, duration: str = "0.02") -> int:
    command = ["--params-file", str(CONFIG / "paper.yaml"), "--output", str(output), "--duration", duration]
    return simulate_main([*command, *words])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    assert simulate(path) == 0
    return path


def test_simulate_records_what_the_engine_gives(bag: Path) -> None:
    expected = Engine(load_parameters(CONFIG / "paper.yaml")).advance(2000)
    assert recording.open(bag).waveform().tobytes() == expected.samples.tobytes()


def test_verify_proves_it(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay_main(["verify", str(bag)]) == 0
    assert "2000 samples of 28 channels are the same to the bit" in capsys.readouterr().out


def test_info_tells_what_is_there(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay_main(["info", str(bag)]) == 0
    shown = capsys.readouterr().out
    assert "complete" in shown and "2000 samples" in shown and "/gearbox/waveform" in shown


def test_events_tell_what_changed_and_what_was_restored(tmp_path: Path) -> None:
    parameters = Parameters.from_flat({"solver.chunk": 3e-4})
    changed = {"mesh.stiffness_cos": [0.05, 0.01], "operation.control": "torque"}
    path = perform(
        tmp_path / "bag",
        ["step", "save", "step", changed, "step", "split", "step", "restore"],
        parameters,
    )
    start, change, back, restore = recording.open(path).events
    assert (start.kind, start.parameters, start.checkpoint) == ("start", {}, {})
    assert (change.kind, change.sample, change.parameters) == ("parameters", 60, changed)
    assert back.parameters == {"mesh.stiffness_cos": [0.08], "operation.control": "speed"}
    assert (restore.kind, restore.sample, restore.message) == ("restore", 120, "as saved")
    assert restore.checkpoint["sample"] == 30
    second = recording.open(path / "bag_1.mcap")
    assert second.parameters == updated(parameters, changed)


def test_a_trip_ends_with_the_reason_and_a_complete_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bag"
    words = ("--set", "operation.drive_torque=190.0", "--set", "operation.speed_limit=1640.0")
    assert simulate(path, *words, duration="0.1") == 1
    error = capsys.readouterr().err
    warning, reason = error.splitlines()
    assert "does not balance" in warning
    assert "over-speed" in reason and "operation.speed_limit = 1640" in reason
    opened = recording.open(path)
    assert opened.complete
    assert opened.events[-1].kind == "end" and "over-speed" in opened.events[-1].message
    assert verify_recording(opened).difference is None


@pytest.mark.parametrize(
    ("words", "duration", "told"),
    [
        (("--set", "operation.sped=1"), "0.02", "operation.speed"),
        (("--set", "bearings.driving.restitution=1.5"), "0.02", "bearings.driving.restitution"),
        ((), "-1", "--duration"),
        ((), "inf", "--duration"),
    ],
)
def test_bad_requests_are_refused_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], duration: str, told: str
) -> None:
    path = tmp_path / "bag"
    assert simulate(path, *words, duration=duration) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
    assert not path.exists()


def test_nothing_is_overwritten(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(bag, copy)
    assert simulate(copy) == 2
    assert "exists" in capsys.readouterr().err
    assert replay_main(["verify", str(copy)]) == 0


def test_a_file_that_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.mcap").write_bytes(b"not an mcap file")
    assert replay_main(["info", str(tmp_path / "x.mcap")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("replay: error: ") and error.count("\n") == 1
    assert "x.mcap: not an MCAP file" in error


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_a_complete_recording_even_if_repeated(
    tmp_path: Path, process: StartProcess, number: int
) -> None:
    path = tmp_path / "bag"
    running = process("simulate", "--duration", "1000", "--output", path)
    file = path / "bag_0.mcap"
    until(lambda: file.exists() and file.stat().st_size > 1_000_000, "a megabyte is written")
    running.signal(number)
    running.signal(number)
    assert running.wait() == 128 + number
    assert f"interrupted by {signal.Signals(number).name}" in running.stderr
    assert "Traceback" not in running.stderr
    bag = recording.open(path)
    assert bag.complete and bag.events[-1].message.startswith(signal.Signals(number).name)
    assert verify_recording(bag).difference is None
