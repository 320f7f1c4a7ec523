"""What may happen to a run: parameters that change, control that is handed over, a state taken up again."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.analysis import ledger
from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN
from gear_dynamics_ros.chunk import Chunk, Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, change_to, change_values
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from support.parameters import parameters

TORQUE = {"operation.control": "torque"}
SPEED = {"operation.control": "speed"}
CHANGES: tuple[dict[str, Any], ...] = (
    TORQUE,
    SPEED,
    {"surface.driving.roughness": 2.5e-6},
    {"surface.driven.roughness": 0.0},
    {"mesh.error_mean": 8e-6, "mesh.error_cos": [1e-6, 2e-6]},
    {"mesh.error_mean": -40e-6},
    {"mesh.stiffness": 1.5e8, "mesh.stiffness_cos": [0.3]},
    {"mesh.damping_ratio": 0.0},
    {"mesh.damping_ratio": 0.3},
    {"bearings.driving.restitution": 0.9, "bearings.minimum_impact_speed": 5e-3},
    {"bearings.driving.kelvin_stiffness": 3e7, "bearings.driven.kelvin_damping": 9000.0},
    {"oil.viscosity": 0.1, "oil.eccentricity_limit": 0.15},
    {"operation.governor.proportional": 4.0, "operation.governor.torque_limit": 35.0},
    {"operation.load_law": "brake", "operation.load_viscous": 1e-3},
    {"operation.drive_torque": 3.0, "operation.load_torque": 3.0},
    {"operation.speed": 900.0},
)
MODELS = ("traditional", "compared", "improved")


def change(engine: Engine, values: dict[str, Any]) -> None:
    engine.change(change_values(engine.parameters, values))


def state(engine: Engine) -> dict[str, Any]:
    found = dict(engine.checkpoint().state)
    return found


@given(
    st.lists(st.tuples(st.integers(1, 200), st.sampled_from(CHANGES)), min_size=1, max_size=5),
    st.lists(st.integers(1, 90), min_size=1, max_size=4),
    st.sampled_from(MODELS),
)
@settings(max_examples=25, deadline=None)
def test_chunk_length_changes_no_bit_between_changes(
    script: list[tuple[int, dict[str, Any]]], lengths: list[int], model: str
) -> None:
    def run(pieces: list[int]) -> tuple[bytes, bytes, object]:
        engine = Engine(parameters(model=model))
        chunks = []
        for samples, values in script:
            rest = samples
            while rest:
                chunks.append(engine.advance(min(rest, pieces[len(chunks) % len(pieces)])))
                rest -= len(chunks[-1])
            change(engine, values)
        chunks.append(engine.advance(100))
        whole = np.concatenate([chunk.samples for chunk in chunks])
        impacts = np.concatenate([chunk.impacts for chunk in chunks])
        return whole.tobytes(), impacts.tobytes(), engine.checkpoint()

    assert run(lengths) == run([10_000])


def test_nothing_changed_changes_no_bit() -> None:
    engine, left_alone = Engine(Parameters()), Engine(Parameters())
    for _ in range(20):
        engine.change(change_to(engine.parameters, Parameters()))
        assert engine.advance(37).samples.tobytes() == left_alone.advance(37).samples.tobytes()
    assert engine.checkpoint() == left_alone.checkpoint()


def test_what_is_fixed_stays_and_nothing_else_changes() -> None:
    engine = Engine(Parameters())
    engine.advance(100)
    before = engine.checkpoint()
    with pytest.raises(UsageError, match=r"gears\.module = 0\.003 is fixed"):
        change(engine, {"oil.viscosity": 0.1, "gears.module": 0.004})
    assert engine.parameters == Parameters() and engine.checkpoint() == before


def test_a_minus_that_no_recording_tells_is_not_taken() -> None:
    engine = Engine(parameters(operation__control="torque", operation__drive_torque=0.0))
    change(engine, {"operation.drive_torque": -0.0, "oil.viscosity": 0.1})
    engine.reset()
    assert not np.signbit(engine.advance(1)["drive_torque"][0])


def test_control_is_handed_over_without_a_jump() -> None:
    engine = Engine(parameters(operation__speed=1500.0))
    engine.command(Commands(30.0, 34.0, 1510.0))
    in_force = engine.advance(500)["drive_torque"][-1]
    assert in_force != 30.0
    change(engine, TORQUE)
    assert engine.commands == Commands(in_force, 34.0, 1510.0)
    assert (engine.advance(200)["drive_torque"] == in_force).all()
    change(engine, SPEED)
    back = engine.advance(200)
    assert back["drive_torque"][0] == pytest.approx(in_force, rel=1e-14)
    error = 1510.0 - back["driving_speed"]
    integral = np.concatenate([[0.0], np.cumsum(5.0 * error * 1e-5)[:-1]])
    np.testing.assert_allclose(
        back["drive_torque"], in_force + 0.5 * (error - error[0]) + integral, rtol=1e-12
    )


@pytest.mark.parametrize("limit", [200.0, 31.0])
def test_gains_change_without_a_jump_within_the_limit(limit: float) -> None:
    engine = Engine(parameters(operation__speed=1500.0))
    engine.command(Commands(30.0, 30.0, 1520.0))
    in_force = engine.advance(500)["drive_torque"][-1]
    assert in_force > 31.0
    governor = {"proportional": 7.0, "integral": 90.0, "torque_limit": limit}
    change(engine, {f"operation.governor.{name}": value for name, value in governor.items()})
    assert engine.advance(1)["drive_torque"][0] == pytest.approx(min(in_force, limit), rel=1e-14)


def test_a_parameter_that_differs_is_a_command_and_the_others_stay_in_force() -> None:
    engine = Engine(parameters(**{"operation__control": "torque"}))
    engine.command(Commands(20.0, 21.0, 1200.0))
    engine.advance(10)
    change(engine, {"operation.load_torque": 25.0})
    assert engine.commands == Commands(20.0, 25.0, 1200.0)
    shown = engine.advance(10)
    assert (shown["drive_torque"] == 20.0).all() and (shown["load_torque"] == 25.0).all()
    change(engine, {"operation.control": "speed", "operation.drive_torque": 28.0})
    change(engine, {"operation.control": "torque", "operation.drive_torque": 29.0})
    assert engine.commands == Commands(29.0, 25.0, 1200.0)
    engine.reset()
    assert engine.commands == Commands(29.0, 25.0, 1623.156)


def test_a_change_moves_the_gap_at_once() -> None:
    """The flanks stand 50 um apart: a static error takes the teeth off one and presses them on the other."""
    engine = Engine(parameters(model="compared"))
    engine.advance(200)
    seen = set()
    for mean in (2e-6, -15e-6, 70e-6, -60e-6):
        before = state(engine)
        change(engine, {"mesh.error_mean": mean})
        after = state(engine)
        assert after["flank_changes"] - before["flank_changes"] == abs(after["flank"] - before["flank"])
        chunk = engine.advance(1)
        (flank,), (dte,), (half_backlash,) = chunk["meshing_state"], chunk["dte"], chunk["half_backlash"]
        assert flank == after["flank"] == np.sign(dte) * (abs(dte) > half_backlash)
        assert chunk.counters.capped == before["capped"]
        seen.add(flank)
    assert seen == {-1.0, 0.0, 1.0}


def test_a_contact_that_goes_on_stays_one_contact() -> None:
    engine = Engine(parameters(model="compared", waveform_channels=("time",)))
    while sum(state(engine)["contact"]) < 2.0:
        engine.advance(10)
    before = state(engine)
    change(engine, {"bearings.driven.restitution": 0.7, "bearings.minimum_impact_speed": 0.5, **TORQUE})
    after = state(engine)
    latched = ("impact_speed", "impact_time", "contact_age", "closing_speed", "peak_force2")
    kept = ("contact", *latched, "impacts")
    assert [after[name] for name in kept] == [before[name] for name in kept]


def test_the_film_is_held_where_a_lower_limit_says_so() -> None:
    engine = Engine(Parameters())
    engine.advance(1000)
    change(engine, {"oil.eccentricity_limit": 0.1})
    capped = engine.counters.capped
    assert state(engine)["film_limited"] == [1.0, 1.0]
    change(engine, {"oil.eccentricity_limit": 0.98})
    assert state(engine)["film_limited"] == [0.0, 0.0]
    engine.advance(10)
    assert engine.counters.capped == capped


@pytest.mark.parametrize("model", MODELS)
def test_the_ledger_closes_over_changes(model: str) -> None:
    engine = Engine(parameters(model=model, waveform_channels=tuple(COLUMN), solver__step=1e-6))
    chunks: list[Chunk] = [engine.advance(50)]
    stored_by_changes = 0.0
    for values in CHANGES[:-1]:
        before = state(engine)["excitation_work"]
        change(engine, values)
        stored_by_changes += abs(state(engine)["excitation_work"] - before)
        chunks.append(engine.advance(50))
    rows = np.concatenate([chunk.samples for chunk in chunks])[:, len(CHANNEL_NAMES) :]
    moved = np.abs(np.diff(rows[:, : -len(ledger.STORED)], axis=0)).sum()
    assert np.abs((rows - rows[0]) @ ledger.RESIDUAL_SIGNS).max() < 1e-6 * moved
    assert stored_by_changes > 1e-4 * moved


@given(st.integers(1, 900), st.integers(0, 300), st.sampled_from(MODELS), st.data())
@settings(max_examples=25, deadline=None)
def test_a_state_taken_up_later_goes_on_bit_for_bit(
    saved_at: int, later: int, model: str, data: st.DataObject
) -> None:
    engine = Engine(parameters(model=model, operation__drive_torque=3.0, operation__load_torque=3.0))
    change(engine, data.draw(st.sampled_from(CHANGES)))
    engine.advance(saved_at)
    checkpoint = Checkpoint.from_tree(json.loads(json.dumps(engine.checkpoint().to_tree())))
    original = engine.advance(600)
    other = Engine(engine.parameters)
    if later:
        other.advance(later)
    other.resume(checkpoint)
    again = other.advance(600)
    assert again.first_sample == later
    assert again.samples[:, 1:].tobytes() == original.samples[:, 1:].tobytes()
    assert (again.angles.tobytes(), again.counters) == (original.angles.tobytes(), original.counters)
    assert again.energies.tobytes() == original.energies.tobytes()
    assert again.impacts[:, 2:].tobytes() == original.impacts[:, 2:].tobytes()
    shift = (later - saved_at) * 1e-5
    np.testing.assert_allclose(again.impacts[:, :2], original.impacts[:, :2] + shift, rtol=0.0, atol=1e-15)
