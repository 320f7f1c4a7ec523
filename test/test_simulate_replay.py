"""simulate and replay as a user types them: records, verifies, and says what is wrong."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gear_dynamics_ros import recording, replay
from gear_dynamics_ros.cli.replay import main as replay_main
from gear_dynamics_ros.cli.simulate import main as simulate_main
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.messages import Encoder
from gear_dynamics_ros.parameters import Parameters, load, updated
from gear_dynamics_ros.recording.writer import Recorder
from gear_dynamics_ros.recordings import RecorderSink
from gear_dynamics_ros.run import Run
from gear_dynamics_ros.signals import CHANNEL_NAMES, COLUMN, Commands

CONFIG = Path(__file__).parent.parent / "config"


def simulate(output: Path, *words: str, duration: str = "0.02") -> int:
    command = ["--params-file", str(CONFIG / "paper.yaml"), "--output", str(output), "--duration", duration]
    return simulate_main([*command, *words])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    assert simulate(path) == 0
    return path


def test_simulate_records_what_the_engine_gives(bag: Path) -> None:
    expected = Engine(load(CONFIG / "paper.yaml")).advance(2000)
    assert recording.open(bag).waveform().tobytes() == expected.samples.tobytes()


def test_verify_proves_it(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay_main(["verify", str(bag)]) == 0
    assert "2000 samples of 28 channels came out the same to the bit" in capsys.readouterr().out


def test_info_tells_what_is_there(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay_main(["info", str(bag)]) == 0
    shown = capsys.readouterr().out
    assert "complete" in shown and "2000 samples" in shown and "/gearbox/waveform" in shown


def commanded(path: Path, parameters: Parameters, recorded_as: Parameters | None = None) -> Path:
    """A run with commands and a reset; the recording may claim other parameters than it was made with."""
    engine = Engine(parameters)
    recorder = Recorder(path, recorded_as or parameters, engine.checkpoint(), 1_000_000_000)
    run = Run(engine, Encoder(parameters, 1_000_000_000), [RecorderSink(recorder, engine)])
    run.step()
    run.step(Commands(30.0, 55.0, 1700.0))
    run.step()
    run.reset()
    run.step()
    run.step(Commands(30.0, -20.0, 1500.0))
    run.close()
    return path


# What may be done between two chunks; "restore" takes up the state that "save" kept.
DEEDS: tuple[Any, ...] = (
    "step",
    "reset",
    "save",
    "restore",
    "split",
    Commands(30.0, 55.0, 1700.0),
    Commands(31.0, -20.0, 1500.0),
    {"operation.control": "torque"},
    {"operation.control": "speed", "operation.speed": 1400.0},
    {"operation.governor.integral": 50.0, "operation.drive_torque": 25.0},
    {"surface.driving.roughness": 2e-6, "mesh.error_cos": [3e-6, 1e-6]},
    {"mesh.error_mean": -20e-6, "oil.viscosity": 0.05},
    {"mesh.error_mean": 0.0, "operation.load_torque": 30.0},
)


def perform(path: Path, deeds: Sequence[Any], parameters: Parameters) -> Path:
    """Recording of a run in which ``deeds`` were done between its chunks, and one chunk more."""
    engine = Engine(parameters)
    recorder = Recorder(path, parameters, engine.checkpoint(), 0)
    run = Run(engine, Encoder(parameters, 0), [RecorderSink(recorder, engine)])
    saved = (run.engine.parameters, run.checkpoint())
    commands = None
    for deed in deeds:
        if isinstance(deed, Commands):
            commands = deed
        elif isinstance(deed, dict):
            run.change(updated(engine.parameters, deed))
        elif deed == "reset":
            run.reset()
        elif deed == "save":
            saved = (engine.parameters, run.checkpoint())
        elif deed == "restore":
            run.change(saved[0])
            run.restore(saved[1], "as saved")
        elif deed == "split":
            recorder.split(run.checkpoint(), engine.parameters)
        elif deed == "step":
            run.step(commands)
            commands = None
    run.step(commands)
    run.close()
    assert recorder.error is None
    return path


@given(
    st.lists(st.one_of(st.just("step"), st.sampled_from(DEEDS)), min_size=1, max_size=20),
    st.sampled_from(["torque", "speed"]),
)
@example(["save", "step", "restore", "step", "split", "step"], "speed")
@example(["step", "reset", "step", "split", "step"], "torque")
# A command repeated at the edge where something else has put another value in force.
@example([DEEDS[5], "step", "reset", DEEDS[5], "step"], "torque")
@example([DEEDS[5], "step", DEEDS[12], DEEDS[5], "step"], "speed")
@example(["save", DEEDS[5], "step", "restore", DEEDS[5], "step"], "torque")
@settings(max_examples=40, deadline=None)
def test_whatever_is_done_comes_out_again(deeds: list[Any], control: str) -> None:
    parameters = Parameters.from_flat({"operation.control": control, "solver.chunk": 3e-4})
    with tempfile.TemporaryDirectory() as folder:
        path = perform(Path(folder) / "bag", deeds, parameters)
        whole = recording.open(path)
        result = replay.verify(whole)
        assert (result.difference, result.samples) == (None, 30 * (deeds.count("step") + 1))
        assert whole.parameters == parameters
        for part in path.glob("*.mcap"):
            assert replay.verify(recording.open(part)).difference is None


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


@pytest.mark.parametrize(
    ("name", "value"), [("mesh.stiffness", 2.0000000001e8), ("operation.load_torque", 31.0)]
)
def test_a_changed_value_that_was_another_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: float
) -> None:
    deeds = ["step", {"mesh.stiffness": 2e8, "operation.load_torque": 30.5}, "step"]
    opened = recording.open(perform(tmp_path / "bag", deeds, Parameters.from_flat({"solver.chunk": 3e-4})))
    told = [
        event._replace(parameters={**event.parameters, name: value}) if event.parameters else event
        for event in opened.events
    ]
    assert replay.verify(opened).difference is None
    monkeypatch.setattr(type(opened), "events", told)
    monkeypatch.setattr(type(opened), "commands", [])
    difference = replay.verify(opened).difference
    assert difference is not None and difference.sample >= 30


@pytest.mark.parametrize("channels", [CHANNEL_NAMES, tuple(COLUMN), ("time", "mesh_loss")])
def test_commands_and_resets_come_out_again(tmp_path: Path, channels: tuple[str, ...]) -> None:
    parameters = Parameters.from_flat({"waveform_channels": channels})
    result = replay.verify(recording.open(commanded(tmp_path / "bag", parameters)))
    assert result.difference is None
    assert result.samples == 5 * parameters.solver.samples_per_chunk


def test_another_parameter_is_found_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claimed = Parameters.from_flat({"oil.viscosity": 0.0229})
    path = commanded(tmp_path / "bag", Parameters(), recorded_as=claimed)
    difference = replay.verify(recording.open(path)).difference
    assert difference is not None
    assert difference.simulated is not None and difference.recorded != difference.simulated
    assert replay_main(["verify", str(path)]) == 1
    assert f"sample {difference.sample}, {difference.channel}" in capsys.readouterr().err


def test_one_altered_bit_is_found(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = recording.open(bag)
    original = opened.chunks

    def altered(*arguments: int) -> object:
        for first, samples in original(*arguments):
            changed = samples.copy()
            if first == 1000:
                changed[7, 3] = np.nextafter(changed[7, 3], np.inf)
            yield first, changed

    monkeypatch.setattr(opened, "chunks", altered)
    difference = replay.verify(opened).difference
    assert difference is not None
    assert (difference.sample, difference.channel) == (1007, "mesh_force")


def test_a_trip_ends_with_the_reason_and_a_complete_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bag"
    words = ("--set", "operation.drive_torque=190.0", "--set", "operation.speed_limit=1640.0")
    assert simulate(path, *words, duration="0.1") == 1
    error = capsys.readouterr().err
    assert "over-speed" in error and "operation.speed_limit = 1640" in error and error.count("\n") == 1
    opened = recording.open(path)
    assert opened.complete
    assert opened.events[-1].kind == "end" and "over-speed" in opened.events[-1].message
    assert replay.verify(opened).difference is None


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
    assert replay_main(["info", str(tmp_path / "x.mcap")]) in (1, 2)
    error = capsys.readouterr().err
    assert error.startswith("replay: error: ") and error.count("\n") == 1
