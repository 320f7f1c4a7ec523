"""Recordings of other programs, and files that are something else, are refused in a line of words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.parts import part_files
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import current_provenance
from support.terminal import error_line


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    folder = tmp_path / "foreign"
    folder.mkdir()
    with (folder / "foreign_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="another program")
        writer.finish()
    return folder


@pytest.mark.parametrize(("verb", "code"), [("info", 1), ("verify", 1), ("publish", 2)])
def test_the_recording_of_another_program_is_told_in_words(
    foreign: Path, capsys: pytest.CaptureFixture[str], verb: str, code: int
) -> None:
    assert replay_main([verb, str(foreign)]) == code
    line = error_line(capsys)
    assert (
        "was not recorded by this package, or its start is lost: it has no entry 'gear_dynamics_ros'" in line
    )


def test_analyze_tells_it_too(foreign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analyze_main([str(foreign), "--output", str(tmp_path / "out")]) == 1
    assert "it has no entry 'gear_dynamics_ros'" in error_line(capsys, "analyze")
    assert not (tmp_path / "out").exists()


def test_a_metadata_file_that_is_not_text_is_named_and_not_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    assert simulate_main(["--duration", "0.002", "--output", str(bag)]) == 0
    (bag / "metadata.yaml").write_bytes(bytes(range(128, 256)) * 30)
    capsys.readouterr()
    for verb in ("info", "verify"):
        code = replay_main([verb, str(bag)])
        shown = capsys.readouterr()
        assert "\\x" not in shown.out + shown.err
        if code:
            assert "metadata.yaml" in shown.err and len(shown.err) < 400 and shown.err.count("\n") == 1


def test_the_state_of_a_run_that_ended_non_finite_is_strict_json() -> None:
    engine = Engine(Parameters.from_flat({"mesh.stiffness": 1e13, "solver.sample_interval": 2e-5}))
    while engine.status is Status.RUNNING and engine.sample < 100_000:
        engine.advance()
    assert engine.status is Status.NON_FINITE
    stored = StoredCheckpoint(engine.checkpoint(), current_provenance())

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    tree = json.loads(stored.to_text(), parse_constant=refuse)
    assert "NaN" in json.dumps(tree["checkpoint"]["state"])
    again = StoredCheckpoint.from_text(stored.to_text(), "state.json")
    assert repr(again.checkpoint.state) == repr(stored.checkpoint.state)
    with pytest.raises(GearboxError, match="had ended"):
        engine.resume(again.checkpoint)


def test_no_message_of_a_chunk_shows_a_negative_zero(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    settings = ["operation.drive_torque=0", "operation.load_torque=0", "operation.control=torque"]
    words = [word for setting in settings for word in ("--set", setting)]
    assert simulate_main(["--duration", "0.05", "--output", str(bag), *words]) == 0
    assert part_files(bag)
    found = recording.open(bag)
    values = [message.data for _, message in found.messages("mesh_force")]
    efforts = [value for _, message in found.messages("joint_states") for value in message.effort]
    assert values and "-0.0" not in {repr(float(value)) for value in (*values, *efforts)}
