"""The engine: the same bits at any chunk length, checkpoints, governor, loads, and how a run ends."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands, Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.kernel import entry as kernel_entry
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from support.parameters import parameters
from support.referee import CHANNELS, Mode, Referee, nested

SAMPLES = 600


PAPER = {
    "mesh_geometry": "published",
    "mesh_damping": "always",
    "restitution_law": "lankarani_nikravesh",
    "mesh_phase": "nominal",
    "operation__control": "torque",
}


@given(st.lists(st.integers(1, 250), min_size=2, max_size=12), st.booleans())
@settings(max_examples=20)
def test_chunk_length_changes_no_bit(lengths: list[int], paper: bool) -> None:
    chosen = parameters(**(PAPER if paper else {}))
    whole = Engine(chosen).advance(sum(lengths))
    engine = Engine(chosen)
    parts = [engine.advance(length) for length in lengths]
    assert np.concatenate([part.samples for part in parts]).tobytes() == whole.samples.tobytes()
    assert np.concatenate([part.angles for part in parts]).tobytes() == whole.angles.tobytes()
    assert parts[-1].counters == whole.counters


@pytest.mark.parametrize("model", ["traditional", "compared", "improved"])
@pytest.mark.parametrize(
    "switches",
    list(
        itertools.product(
            ["published", "exact"],
            ["always", "contact"],
            ["lankarani_nikravesh", "exact"],
            ["nominal", "actual"],
        )
    ),
)
def test_every_model_runs_under_every_switch(model: str, switches: tuple[str, ...]) -> None:
    names = ("mesh_geometry", "mesh_damping", "restitution_law", "mesh_phase")
    chunk = Engine(parameters(model=model, **dict(zip(names, switches, strict=True)))).advance(SAMPLES)
    assert chunk.status is Status.RUNNING
    assert chunk.samples.shape == (SAMPLES, len(CHANNEL_NAMES))
    assert np.isfinite(chunk.samples).all()
    assert set(np.unique(chunk["meshing_state"])) <= {-1.0, 0.0, 1.0}
    film = np.abs(chunk.samples[:, 16:20]).max()
    assert (film > 0.0) == (model == "improved")


def test_a_checkpoint_goes_on_bit_for_bit_through_json() -> None:
    chosen = parameters()
    engine = Engine(chosen)
    engine.advance(333)
    engine.command(Commands(10.0, 45.0, 1500.0))
    saved = json.dumps(engine.checkpoint().to_tree())
    rest = engine.advance(SAMPLES)
    restored = Engine(chosen)
    restored.restore(Checkpoint.from_tree(json.loads(saved)))
    again = restored.advance(SAMPLES)
    assert again.samples.tobytes() == rest.samples.tobytes()
    assert (again.first_sample, again.commands, again.counters) == (333, rest.commands, rest.counters)


def test_a_spoiled_checkpoint_changes_nothing() -> None:
    engine = Engine(parameters())
    before = engine.checkpoint()
    tree = before.to_tree()
    for entry, value in (
        ("state", {"x": [1.0, 2.0]}),
        ("state", None),
        ("commands", {"torque": 1.0}),
        ("status", 17),
        ("sample", math.inf),
        ("sample", 0.5),
    ):
        with pytest.raises(GearboxError, match="checkpoint"):
            engine.restore(Checkpoint.from_tree({**tree, entry: value}))
    del tree["sample"]
    with pytest.raises(GearboxError, match="sample"):
        engine.restore(Checkpoint.from_tree(tree))
    assert engine.checkpoint() == before


def test_time_is_a_counter_and_goes_on_through_a_reset() -> None:
    engine = Engine(parameters())
    first = engine.advance(250)
    assert first["time"].tolist() == [k / 100_000 for k in range(250)]
    engine.reset()
    second = engine.advance(250)
    assert second.first_sample == 250
    assert second["time"][0] == 0.0025
    assert second.samples[:, 1:].tobytes() == first.samples[:, 1:].tobytes()


@pytest.mark.parametrize("phase", ["actual", "nominal"])
@pytest.mark.parametrize("teeth", [(23, 41), (40, 40), (41, 23)])
def test_surfaces_are_continuous_where_the_phase_wraps(phase: str, teeth: tuple[int, int]) -> None:
    engine = Engine(
        parameters(
            gears__driving__teeth=teeth[0],
            gears__driven__teeth=teeth[1],
            mesh_phase=phase,
            operation__control="torque",
            operation__speed=4000.0,
            operation__speed_limit=1e5,
            operation__load_torque=30.0 * teeth[1] / teeth[0],
            solver__step=0.25e-6,
            solver__sample_interval=0.25e-6,
            surface__waves=5,
        )
    )
    chunk = engine.advance(26_000)
    wraps = np.flatnonzero(np.diff(chunk["driving_angle"]) < 0.0)
    assert len(wraps) >= 4
    # A jump shows in two neighbouring bends; where all waves pass through zero together there is none.
    bends = np.abs(np.diff(chunk["half_backlash"], 2))
    at_wraps = np.concatenate([wraps - 1, wraps])
    assert bends[at_wraps].max() <= np.delete(bends, at_wraps).max()
    # The steepest wave moves by its amplitude times its phase in a step; a jump would be of the order of Ra.
    assert np.abs(np.diff(chunk["half_backlash"])).max() < 0.25e-6


def test_accumulated_angles_run_on() -> None:
    engine = Engine(
        parameters(
            gears__driving__teeth=20,
            operation__control="torque",
            solver__step=1e-6,
            solver__sample_interval=1e-6,
        )
    )
    chunk = engine.advance(20_000)
    speeds = np.stack([chunk["driving_speed"], chunk["driven_speed"]], axis=1)
    expected = (speeds[1:] + speeds[:-1]) / 2 * 1e-6
    np.testing.assert_allclose(np.diff(chunk.angles, axis=0), expected, atol=1e-8)
    np.testing.assert_allclose(chunk.angles[:, 0] % (2 * math.pi), chunk["driving_angle"], atol=1e-9)
    assert chunk.angles[-1, 0] > 4 * math.pi


def test_the_nominal_phase_does_not_drift() -> None:
    speed = 1234.5678
    engine = Engine(parameters(**PAPER, operation__speed=speed))
    count = 40_000
    engine.advance(count)
    phase = engine.advance(1)["mesh_phase"][0]
    exact = math.fmod(40 * speed * count * 1e-5, 2 * math.pi)
    assert phase == pytest.approx(exact, abs=2e-11)


def test_governor_is_evaluated_once_a_sample() -> None:
    engine = Engine(parameters(operation__speed=1000.0))
    engine.advance(100)
    engine.command(Commands(30.0, 30.0, 1010.0))
    chunk = engine.advance(SAMPLES)
    error = 1010.0 - chunk["driving_speed"]
    integral = 30.0 + np.concatenate([[0.0], np.cumsum(5.0 * error * 1e-5)[:-1]])
    start = chunk["drive_torque"][0] - 0.5 * error[0]
    np.testing.assert_allclose(chunk["drive_torque"], 0.5 * error + start + integral - 30.0, atol=1e-9)


def test_governor_stands_still_while_clipped() -> None:
    engine = Engine(parameters(operation__speed=100.0, operation__governor__torque_limit=35.0))
    engine.command(Commands(30.0, 30.0, 3000.0))
    chunk = engine.advance(SAMPLES)
    assert (chunk["drive_torque"] == 35.0).all()
    engine.command(Commands(30.0, 30.0, float(chunk["driving_speed"][-1])))
    assert engine.advance(1)["drive_torque"][0] == pytest.approx(30.0, abs=1.0)


def test_brake_and_viscous_load() -> None:
    engine = Engine(
        parameters(operation__load_law="brake", operation__load_viscous=0.01, operation__initial="rest")
    )
    chunk = engine.advance(SAMPLES)
    expected = 30.0 * np.tanh(chunk["driven_speed"]) + 0.01 * chunk["driven_speed"]
    np.testing.assert_allclose(chunk["load_torque"], expected, rtol=1e-12, atol=1e-12)
    assert chunk["driven_speed"][0] == 0.0


def test_over_speed_ends_the_run_at_the_sample_that_broke_the_limit() -> None:
    engine = Engine(parameters(**PAPER, operation__speed=1000.0, operation__speed_limit=1010.0))
    engine.command(Commands(200.0, 30.0, 1000.0))
    chunk = engine.advance(5000)
    assert chunk.status is Status.OVER_SPEED
    fastest = np.maximum(chunk["driving_speed"], chunk["driven_speed"])
    assert fastest[-1] > 1010.0 >= fastest[:-1].max()
    assert "operation.speed_limit = 1010" in chunk.message
    with pytest.raises(GearboxError, match="reset"):
        engine.advance()
    engine.reset()
    assert engine.advance().status is Status.RUNNING


def test_a_state_that_is_not_finite_ends_the_run_without_showing_it() -> None:
    engine = Engine(parameters(**PAPER, model="compared"))
    engine.advance(50)
    spoiled = engine.checkpoint()
    engine.restore(spoiled._replace(state={**spoiled.state, "vx": [math.nan, 0.0]}))
    chunk = engine.advance(100)
    assert chunk.status is Status.NON_FINITE
    assert len(chunk) == 0
    assert "solver.step" in chunk.message


def test_centres_pressed_together_end_the_run() -> None:
    engine = Engine(parameters(gears__backlash=1e-6, mesh__error_cos=[20e-6], operation__drive_torque=150.0))
    engine.command(Commands(150.0, 150.0, 1600.0))
    chunk = engine.advance(20_000)
    assert chunk.status is Status.CENTRES_PRESSED
    assert "b1 <= 0" in chunk.message


def test_engine_needs_neither_ros_nor_rerun_nor_matplotlib() -> None:
    blocked = "import sys; sys.modules.update(dict.fromkeys(['rclpy', 'rerun', 'matplotlib']));"
    names = ("simulation.engine", "recording", "replay.verify")
    code = blocked + "".join(f" import gear_dynamics_ros.{name};" for name in names)
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture
def pressed() -> Checkpoint:
    """A state in which both bearings are pressed in deep, in contacts that began as slowly as can be."""
    checkpoint = Engine(parameters(model="compared", operation__speed=200.0)).checkpoint()
    depth = parameters().bearings.driving.clearance + 3e-6
    # The line of centres turns by 2 depth / a_s; keep the teeth 1 um apart all the same.
    turned = 2.0 * depth * math.cos(parameters().gears.pressure_angle) - 1e-6
    changed = {
        "y": [-depth, depth],
        "u": checkpoint.state["u"] + turned,
        "flank": 0.0,
        "contact": [1.0, 1.0],
        "impact_speed": [1e-3, 1e-3],
    }
    return checkpoint._replace(state={**checkpoint.state, **changed})


def test_a_slowly_begun_contact_pressed_in_later_stays_exact(pressed: Checkpoint) -> None:
    """Its damping rate, a k_h delta^1.5 / (m v_impact), is several times what RK4 bears in one step."""
    chosen = parameters(model="compared", operation__speed=200.0)
    engine = Engine(chosen)
    engine.restore(pressed)
    chunk = engine.advance(100)
    assert chunk.status is Status.RUNNING

    referee, state = Referee(nested(chosen.to_flat())), pressed.state
    referee.y[1], referee.y[3], referee.y[4] = *state["y"], state["u"]
    referee.mode = Mode(contact=[True, True], impact_speed=list(state["impact_speed"]))
    expected = referee.run(100)
    for gear in ("driving", "driven"):
        for axis in "xy":
            channel = f"{gear}_contact_force_{axis}"
            force = expected[:, CHANNELS.index(channel)]
            assert np.abs(expected[:, CHANNELS.index(f"{gear}_contact_force_y")]).max() > 1000.0
            np.testing.assert_allclose(chunk[channel], force, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(chunk["dte"], expected[:, CHANNELS.index("dte")], rtol=0.0, atol=1e-14)


def test_impacts_are_listed_whatever_the_chunk(rattling: Parameters) -> None:
    whole = Engine(rattling).advance(3000)
    engine = Engine(rattling)
    pieces = np.concatenate([engine.advance(30).impacts for _ in range(100)])
    assert pieces.tobytes() == whole.impacts.tobytes()
    begin, end, bearing, impact_speed, rebound_speed, peak_force = whole.impacts.T
    assert len(whole.impacts) > 10
    assert (end > begin).all() and set(bearing) == {0.0, 1.0}
    assert (impact_speed > 0.0).all() and (rebound_speed > 0.0).all() and (peak_force > 0.0).all()


def test_an_impact_list_that_is_full_ends_no_run(
    rattling: Parameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Engine(rattling).advance(3000)
    calls = []
    integrate = kernel_entry.integrate
    monkeypatch.setattr(
        kernel_entry, "integrate", lambda *arguments: calls.append(1) or integrate(*arguments)
    )
    monkeypatch.setattr("gear_dynamics_ros.simulation.engine.IMPACTS_A_CALL", 1)
    halting = Engine(rattling).advance(3000)
    assert len(calls) > 5
    assert halting.impacts.tobytes() == whole.impacts.tobytes()
    assert halting.samples.tobytes() == whole.samples.tobytes()


@pytest.fixture
def rattling() -> Parameters:
    """Little torque: both journals leave their sleeves again and again."""
    return parameters(model="compared", operation__drive_torque=1.0, operation__load_torque=1.0)


@pytest.mark.parametrize("model", ["compared", "improved"])
def test_an_impact_alone_delivers_its_restitution(model: str) -> None:
    """One journal flung at its sleeve; nothing else acts on it but the film."""
    eta = 0.6
    p = parameters(
        model=model,
        gears__backlash=1e-3,
        bearings__driving__restitution=eta,
        oil__viscosity=1e-9,
        operation__drive_torque=0.0,
        operation__load_torque=0.0,
        operation__speed=0.0,
    )
    engine = Engine(p)
    start = engine.checkpoint()
    changed = {
        "u": 0.0,
        "y": [p.bearings.driving.clearance - 1e-6, 0.0],
        "vy": [0.1, 0.0],
        "flank": 0.0,
    }
    engine.restore(start._replace(state={**start.state, **changed}))
    ((begin, end, bearing, impact_speed, rebound_speed, peak_force),) = engine.advance(50).impacts
    assert begin == pytest.approx(1e-5, rel=1e-4) and end > begin and bearing == 0.0
    assert impact_speed == pytest.approx(0.1, rel=1e-4)
    assert rebound_speed / impact_speed == pytest.approx(eta, rel=1e-4)
    assert peak_force > 0.1 * p.gears.driving.mass / (end - begin)
