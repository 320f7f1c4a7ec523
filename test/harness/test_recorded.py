"""A recording as a profile and as a script: what they ask for, and that the script makes it again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.profile import Profile, step_profile
from gear_dynamics_ros.parameters import Parameters, change_values, updated
from gear_dynamics_ros.replay import publish
from gear_dynamics_ros.script import ChangeAction, ResetAction, require_chunk_edges
from gear_dynamics_ros.simulation.engine import Engine
from support.recordings import record

PARAMETERS = updated(Parameters(), {"operation.speed": 400.0, "operation.control": "torque"})
CHANGED = {"oil.viscosity": 0.05, "operation.drive_torque": 25.0}
CHUNK_NS = PARAMETERS.solver.samples_per_chunk * PARAMETERS.solver.sample_interval_ns


def profile_of(bag: recording.Recording) -> Profile:
    script = publish.command_script(bag)
    commands = [(step.time_ns / 1e9, step.commands) for step in script.steps]
    return step_profile(f"commands of {bag.path}", script.duration_ns / 1e9, commands)


@pytest.fixture(scope="module")
def eventful(tmp_path_factory: pytest.TempPathFactory):
    """Ten chunks with commands, a change of parameters, one of the stepping alone, and a reset."""

    def act(run, chunk):
        commands = run.engine.commands
        if chunk == 2:
            return commands._replace(load_torque=20.0)
        if chunk == 4:
            run.change(change_values(run.engine.parameters, CHANGED))
        if chunk == 5:
            run.change(change_values(run.engine.parameters, {"stepping.chunks": 7}))
        if chunk == 6:
            run.reset()
        if chunk == 8:
            return commands._replace(speed=410.0)
        return None

    return record(tmp_path_factory.mktemp("eventful") / "bag", PARAMETERS, 10, act)


def test_a_profile_has_the_commands_in_force_at_every_time(eventful) -> None:
    profile = profile_of(eventful)
    assert round(profile.duration * 1e9) == 10 * CHUNK_NS
    assert not profile.reset and not profile.parameters and not profile.expectations
    values = [
        tuple(profile.commands[name].value(chunk * CHUNK_NS / 1e9) for name in Commands._fields)
        for chunk in range(10)
    ]
    start, loaded = (30.0, 30.0, 400.0), (30.0, 20.0, 400.0)
    driven, reset, faster = (25.0, 20.0, 400.0), (25.0, 30.0, 400.0), (25.0, 30.0, 410.0)
    assert values == [start] * 2 + [loaded] * 2 + [driven] * 2 + [reset] * 2 + [faster] * 2


def test_a_script_has_every_act_at_its_time(eventful) -> None:
    script = publish.full_script(eventful)
    assert script.duration_ns == 10 * CHUNK_NS
    moments = [(m.time_ns // CHUNK_NS, m.actions, tuple(m.commands)) for m in script.steps]
    assert moments == [
        (0, (), (30.0, 30.0, 400.0)),
        (2, (), (30.0, 20.0, 400.0)),
        (4, (ChangeAction(CHANGED),), (25.0, 20.0, 400.0)),
        (6, (ResetAction(),), (25.0, 30.0, 400.0)),
        (8, (), (25.0, 30.0, 410.0)),
    ]


def test_what_is_left_out_is_counted(eventful) -> None:
    assert +publish.skipped_by_commands(eventful) == {"parameter changes": 2, "resets": 1}
    assert +publish.skipped_by_script(eventful) == {"changes of pacing or stepping": 1}


def test_a_change_of_commands_alone_is_not_left_out(tmp_path: Path) -> None:
    def act(run, chunk):
        if chunk == 1:
            run.change(change_values(run.engine.parameters, {"operation.load_torque": 20.0}))

    bag = record(tmp_path / "bag", PARAMETERS, 3, act)
    assert not +publish.skipped_by_commands(bag)
    assert profile_of(bag).commands["load_torque"].value(CHUNK_NS / 1e9) == 20.0


def test_an_engine_given_the_script_makes_the_same_bits(eventful) -> None:
    engine = Engine(PARAMETERS)
    engine.advance(300)  # another start, which the reset undoes
    script = publish.with_initial_reset(publish.full_script(eventful))
    ends = [moment.time_ns for moment in script.steps[1:]] + [script.duration_ns]
    made = []
    for moment, end_ns in zip(script.steps, ends, strict=True):
        for act in moment.actions:
            if isinstance(act, ResetAction):
                engine.reset()
            else:
                engine.change(change_values(engine.parameters, act.parameters))
        engine.command(moment.commands)
        made.append(engine.advance((end_ns - moment.time_ns) // eventful.sample_interval_ns).samples)
    # All but the time, which goes on through a reset.
    np.testing.assert_array_equal(np.vstack(made)[:, 1:28], eventful.waveform()[:, 1:])


def test_a_part_of_a_run_begins_at_its_own_first_sample(tmp_path: Path) -> None:
    def act(run, chunk):
        return run.engine.commands._replace(load_torque=20.0) if chunk == 4 else None

    bag = record(tmp_path / "bag", PARAMETERS, 6, act, begin=3)
    assert bag.first_sample == 600
    assert not publish.starts_at_start_state(bag)
    script = publish.full_script(bag)
    assert [(moment.time_ns, moment.commands.load_torque) for moment in script.steps] == [
        (0, 30.0),
        (CHUNK_NS, 20.0),
    ]
    assert script.duration_ns == 3 * CHUNK_NS


def test_a_recording_after_a_reset_begins_at_the_start_state(tmp_path: Path) -> None:
    def act(run, chunk):
        if chunk == 2:
            run.reset()

    bag = record(tmp_path / "bag", PARAMETERS, 5, act, begin=3)
    assert not publish.starts_at_start_state(bag)
    bag = record(tmp_path / "anew", PARAMETERS, 5, act, begin=2)
    assert bag.first_sample == 400
    assert publish.starts_at_start_state(bag)


def test_a_moment_within_a_chunk_is_refused_with_the_chunk_that_fits(eventful) -> None:
    script = publish.full_script(eventful)
    require_chunk_edges(script, CHUNK_NS)
    require_chunk_edges(script, 2 * CHUNK_NS)
    with pytest.raises(UsageError) as caught:
        require_chunk_edges(script, 3 * CHUNK_NS)
    assert "0.004 s after its first sample" in str(caught.value)
    assert "solver.chunk = 0.006 s" in str(caught.value)
    assert str(caught.value).endswith("start the gearbox with solver.chunk = 0.002 s")


def test_a_recording_without_samples_is_refused(tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", PARAMETERS, 0, lambda run, chunk: None)
    for make in (profile_of, publish.full_script):
        with pytest.raises(UsageError, match="has no samples"):
            make(bag)
