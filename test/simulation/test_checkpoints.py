"""Checkpoint files: what they give back, what they refuse, and that none is ever half written."""

from __future__ import annotations

import json
import math
import resource
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gear_dynamics_ros import __version__, recording
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.simulate import simulate_main as simulate
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import Parameters, Specification, change_values, specifications, updated
from gear_dynamics_ros.physics.constants import excitation_table, kernel_constants
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import model_hash

LIGHT = {"operation.drive_torque": 3.0, "operation.load_torque": 3.0}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Checkpoint after 2.5 ms with a parameter and a command of its own."""
    engine = Engine(Parameters.from_flat({"model": "compared", **LIGHT}))
    engine.advance(100)
    engine.change(change_values(engine.parameters, {"mesh.stiffness": 2e8}))
    engine.command(Commands(3.0, 4.0, 1500.0))
    engine.advance(150)
    path = tmp_path / "state.json"
    checkpoint.save_checkpoint(path, engine.checkpoint())
    return path


@given(st.integers(0, 500), st.sampled_from(["traditional", "compared", "improved"]), st.floats(1e7, 1e9))
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_fresh_engine_goes_on_bit_for_bit(
    tmp_path: Path, sample: int, model: str, stiffness: float
) -> None:
    engine = Engine(Parameters.from_flat({"model": model, **LIGHT}))
    engine.advance(sample)
    engine.change(change_values(engine.parameters, {"mesh.stiffness": stiffness}))
    checkpoint.save_checkpoint(tmp_path / "state.json", engine.checkpoint())
    expected = engine.advance(500)

    saved = checkpoint.load_checkpoint(tmp_path / "state.json")
    assert saved.checkpoint.parameters == engine.parameters
    assert (saved.provenance.version, saved.provenance.model_hash) == (__version__, model_hash())
    fresh = Engine(saved.checkpoint.parameters)
    fresh.resume(saved.checkpoint)
    again = fresh.advance(500)
    assert again.samples[:, 1:].tobytes() == expected.samples[:, 1:].tobytes()
    assert again.impacts[:, 2:].tobytes() == expected.impacts[:, 2:].tobytes()
    np.testing.assert_allclose(again.impacts[:, :2] + sample * 1e-5, expected.impacts[:, :2], atol=1e-15)


def test_a_later_one_replaces_an_earlier_one_and_leaves_nothing_beside_it(file: Path) -> None:
    engine = Engine(Parameters())
    engine.advance(7)
    checkpoint.save_checkpoint(file, engine.checkpoint())
    assert checkpoint.load_checkpoint(file).checkpoint.sample == 7
    assert list(file.parent.iterdir()) == [file]


def test_a_place_that_cannot_be_written_is_named_and_kept_as_it_is(tmp_path: Path) -> None:
    engine = Engine(Parameters())
    for path in (tmp_path / "missing" / "state.json", tmp_path, Path()):
        with pytest.raises(GearboxError, match=r"can't be written: .*choose another path"):
            checkpoint.save_checkpoint(path, engine.checkpoint())
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_leaves_the_earlier_one(file: Path) -> None:
    before, engine = file.read_bytes(), Engine(Parameters())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(GearboxError, match="can't be written: File too large"):
            checkpoint.save_checkpoint(file, engine.checkpoint())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


def test_an_ended_run_is_not_saved() -> None:
    engine = Engine(Parameters.from_flat({"operation.speed_limit": 1623.2}))
    while not engine.status:
        engine.advance()
    with pytest.raises(GearboxError, match="the run has ended"):
        checkpoint.save_checkpoint(Path("none"), engine.checkpoint())


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"{}",
        b'{"version": "1", "model_hash": "", "parameters": {}, "checkpoint": 3}',
        b'{"version": "1", "model_hash": "", "parameters": {"gears.modul": 1.0}, "checkpoint": {}}',
    ],
)
def test_what_is_no_checkpoint_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"state\.json") as caught:
        checkpoint.load_checkpoint(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(UsageError, match="there is no checkpoint"):
        checkpoint.load_checkpoint(tmp_path / "other.json")


def test_another_model_or_another_gearbox_is_refused(file: Path) -> None:
    saved = checkpoint.load_checkpoint(file)
    checkpoint.require_fitting(saved, saved.checkpoint.parameters)
    with pytest.raises(UsageError, match=r"model 000000000000 \(version 0\.1\)"):
        other = saved.provenance._replace(model_hash="0" * 64, version="0.1")
        checkpoint.require_fitting(saved._replace(provenance=other), saved.checkpoint.parameters)
    for name, value in {"gears.driven.teeth": 41, "model": "improved", "solver.step": 5e-7}.items():
        with pytest.raises(UsageError, match=rf"^{name} = {value}|^{name} = '{value}'"):
            checkpoint.require_fitting(saved, updated(saved.checkpoint.parameters, {name: value}))


def test_what_does_not_decide_the_physics_stays_with_who_goes_on(file: Path) -> None:
    mine: dict[str, Any] = {
        "solver.chunk": 1e-3,
        "pacing.real_time_factor": 0.0,
        "operation.command_timeout": 3.0,
        "waveform_channels": ("time", "dte"),
    }
    running = Parameters.from_flat({"model": "compared", "oil.viscosity": 1.0, **mine})
    taken = checkpoint.parameters_to_continue(checkpoint.load_checkpoint(file), running).to_flat()
    assert {name: taken[name] for name in mine} == mine
    assert (taken["mesh.stiffness"], taken["oil.viscosity"]) == (2e8, 0.0228)
    assert taken["operation.load_torque"] == 3.0


def test_whatever_the_kernel_is_told_decides_the_physics() -> None:
    def told(parameters: Parameters) -> bytes:
        table = excitation_table(parameters)
        numbers = (kernel_constants(parameters, table), table.waves, table.amplitudes)
        return b"".join(part.tobytes() for part in numbers)

    def others(before: Any, row: Specification) -> list[Any]:
        if row.choices and row.type is str:
            return list(row.choices)
        if row.type is tuple and row.element is float:
            return [(0.01,), (*before, 0.01)]
        if row.type is float:
            return [1.01 * before, 2 * before, 0.1]
        return [before + 1] if row.type is int else []

    plain = Parameters.from_flat({"operation.initial": "rest", "model": "traditional"})
    by_default, deciding = told(plain), set()
    for name, row in specifications().items():
        for value in others(plain.to_flat()[name], row):
            with suppress(UsageError):
                if told(updated(plain, {name: value})) != by_default:
                    deciding.add(name)
                    break
    assert {name for name in deciding if not checkpoint.decides_physics(name)} == set()
    groups = ("gears.", "mesh.", "surface.", "bearings.", "oil.")
    assert deciding >= {name for name in specifications() if name.startswith(groups)}


def test_simulate_goes_on_from_one(file: Path, tmp_path: Path) -> None:
    saved = checkpoint.load_checkpoint(file)
    engine = Engine(saved.checkpoint.parameters)
    engine.resume(saved.checkpoint)
    engine.change(change_values(saved.checkpoint.parameters, {"operation.load_torque": 9.0}))
    words = ["--from-checkpoint", str(file), "--duration", "0.005", "--output", str(tmp_path / "bag")]
    assert simulate([*words, "--set", "operation.load_torque=9"]) == 0
    read = recording.open(tmp_path / "bag")
    assert read.first_sample == 0 and read.end_sample == 500
    assert read.waveform().tobytes() == engine.advance(500).samples.tobytes()
    assert read.commands == [(0, Commands(3.0, 9.0, 1500.0))]
    assert verify_recording(read).difference is None


@pytest.mark.parametrize(
    ("setting", "told"), [("gears.module=0.004", "gears.module"), ("gears.modul=0.004", "gears.module")]
)
def test_simulate_refuses_what_does_not_fit(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], setting: str, told: str
) -> None:
    words = ["--from-checkpoint", str(file), "--duration", "0.005", "--output", str(tmp_path / "bag")]
    assert simulate([*words, "--set", setting]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
    assert not (tmp_path / "bag").exists()


def test_a_damaged_state_in_an_intact_file_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads(file.read_text())
    del content["checkpoint"]["state"]["u"]
    file.write_text(json.dumps(content))
    words = ["--from-checkpoint", str(file), "--duration", "0.005", "--output", str(tmp_path / "bag")]
    assert simulate(words) == 1
    assert "an entry of the checkpoint is missing or invalid: KeyError('u')" in capsys.readouterr().err


IMPOSSIBLE: list[tuple[str, Any]] = [
    ("u", None),
    ("u", "1.0"),
    ("u", True),
    ("u", [1.0]),
    ("u", float("nan")),
    ("omega", 1.0),
    ("omega", [1.0, 2.0, 3.0]),
    ("omega", [1.0, [2.0]]),
    ("omega", [1.0, float("inf")]),
    ("flank", 2.0),
    ("flank", 0.5),
    ("contact", [1.0, 0.1]),
    ("impact_speed", [0.0, 1.0]),
    ("contact_age", [-1.0, 0.0]),
    ("nominal_turn", 1.5),
    ("whole_turns", 1 << 40),
    ("whole_turns", -1),
    ("steps", 1.5),
    ("steps", 1 << 70),
    ("impacts", -3),
    ("pressed", 7),
    ("speed", 1400.0),
]


@pytest.mark.parametrize(("name", "value"), IMPOSSIBLE, ids=str)
def test_a_state_that_no_run_has_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, value: Any
) -> None:
    content = json.loads(file.read_text())
    content["checkpoint"]["state"][name] = value
    file.write_text(json.dumps(content))
    words = ["--from-checkpoint", str(file), "--duration", "0.005", "--output", str(tmp_path / "bag")]
    assert simulate(words) == 1
    error = capsys.readouterr().err
    assert name in error and error.count("\n") == 1 and not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("name", "value"), [("speed", 2e6), ("load_torque", 1e300), ("drive_torque", math.nan)]
)
def test_a_command_that_is_out_of_range_is_refused(file: Path, name: str, value: float) -> None:
    content = json.loads(file.read_text())
    tree = content["checkpoint"]
    tree["commands"][name] = value
    if name in tree["state"] and name != "drive_torque":
        tree["state"][name] = value
    file.write_text(json.dumps(content))
    saved = checkpoint.load_checkpoint(file)
    engine = Engine(saved.checkpoint.parameters)
    before = engine.checkpoint()
    with pytest.raises(GearboxError, match=f"{name} = "):
        engine.resume(saved.checkpoint)
    assert engine.checkpoint() == before


ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.text(max_size=3),
    st.integers(),
    st.floats(),
    st.lists(st.floats(), max_size=3),
)


@given(st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_edited_anywhere_is_refused_or_goes_on(file: Path, data: st.DataObject) -> None:
    tree = checkpoint.load_checkpoint(file).checkpoint.to_tree()
    section = data.draw(st.sampled_from(sorted(tree)))
    if isinstance(tree[section], dict):
        tree[section] = dict(tree[section])
        tree[section][data.draw(st.sampled_from(sorted(tree[section])))] = data.draw(ODD)
    else:
        tree[section] = data.draw(ODD)
    try:
        edited = checkpoint.Checkpoint.from_tree(tree)
        engine = Engine(edited.parameters)
        engine.resume(edited)
    except GearboxError as error:
        assert "\n" not in str(error)
        return
    assert len(engine.advance(3)) == 3 or engine.status
