"""The loop of commands, chunks and sinks, without a clock."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.decoder import applied_commands, waveform_samples
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, change_to, change_values
from gear_dynamics_ros.physics.advice import parameter_warnings
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import Ending, RunState
from gear_dynamics_ros.topics import CHUNK_TOPICS, TOPICS
from support.sinks import Keeper

EPOCH = 1_700_000_000_000_000_000
CHUNK = 200
INTERVAL = 10_000


class Kept(Keeper):
    """What was kept, decoded."""

    def of(self, topic):
        return [
            (record.time_ns, deserialize(TOPICS[topic].type, record.data))
            for record in self.records
            if record.topic == topic
        ]

    @property
    def applied(self):
        return [
            ((time - EPOCH) // INTERVAL, applied_commands(message))
            for time, message in self.of("applied_command")
        ]

    @property
    def events(self):
        return [
            (entry["sample"], entry["event"])
            for entry in map(json.loads, (m.data for _, m in self.of("event")))
        ]


class Picky(Keeper):
    """Wants one topic of each chunk."""

    def __init__(self, topic):
        super().__init__()
        self.topic = topic

    def wanted(self):
        return (self.topic,)


def start(**values):
    keeper = Kept()
    parameters = Parameters.from_flat(values)
    run = Run(Engine(parameters), Encoder(parameters, EPOCH), [keeper], duration=parameters.pacing.duration)
    return run, keeper


def test_commands_in_force_stand_before_the_chunk_they_change():
    run, keeper = start()
    first = run.engine.commands
    second = Commands(30.0, 12.0, 1500.0)
    run.step()
    run.step(second)
    run.step(second)
    run.step()
    assert keeper.applied == [(0, first), (CHUNK, second)]
    topics = [record.topic for record in keeper.records]
    assert topics[:2] == ["event", "applied_command"]
    assert topics.index("applied_command", 2) < topics.index("waveform", topics.index("waveform") + 1)
    assert np.all(keeper.chunks[0]["load_torque"] == 30.0)
    assert np.all(keeper.chunks[1]["load_torque"] == 12.0)


def test_records_are_in_order_of_time_and_hold_every_sample():
    run, keeper = start()
    for _ in range(3):
        run.step()
    times = [record.time_ns for record in keeper.records]
    assert times == sorted(times)
    rows = np.vstack([waveform_samples(message)[1] for _, message in keeper.of("waveform")])
    np.testing.assert_array_equal(rows, np.vstack([chunk.samples for chunk in keeper.chunks]))
    np.testing.assert_allclose(rows[:, 0], np.arange(3 * CHUNK) * 1e-5, rtol=1e-12)


def test_reset_goes_back_to_the_start_while_time_goes_on():
    run, keeper = start()
    run.step(Commands(30.0, 5.0, 1600.0))
    run.reset("wanted")
    run.step()
    first = keeper.applied[-1]
    assert first == (CHUNK, Engine(Parameters()).commands)
    assert keeper.events == [(0, "start"), (CHUNK, "reset")]
    assert keeper.chunks[1].first_sample == CHUNK
    np.testing.assert_array_equal(keeper.chunks[1]["driving_x"][:1], [0.0])


def test_changed_parameters_are_told_once_and_become_commands():
    run, keeper = start()
    run.step()
    run.change(change_to(run.engine.parameters, run.engine.parameters))
    run.change(
        change_values(run.engine.parameters, {"operation.load_torque": 12.0, "mesh.stiffness_cos": [0.1]})
    )
    run.step()
    with pytest.raises(UsageError, match=r"gears\.module"):
        run.change(change_values(run.engine.parameters, {"gears.module": 0.004}))
    run.reset()
    assert keeper.events == [(0, "start"), (CHUNK, "parameters"), (2 * CHUNK, "reset")]
    (entry,) = [e for e in map(json.loads, (m.data for _, m in keeper.of("event"))) if "parameters" in e]
    assert entry["parameters"] == {"operation.load_torque": 12.0, "mesh.stiffness_cos": [0.1]}
    assert keeper.applied[-1] == (CHUNK, Commands(30.0, 12.0, 1623.156))
    assert run.engine.commands.load_torque == 12.0


def test_a_restored_state_goes_on_after_the_end_and_is_told_whole():
    run, keeper = start(**{"operation.speed_limit": 1700.0, "operation.control": "torque"})
    run.step()
    checkpoint = run.checkpoint()
    while not run.state.ended:
        run.step(Commands(190.0, 30.0, 1600.0))
    ended = run.checkpoint()
    with pytest.raises(GearboxError, match="had ended: take an earlier one"):
        run.resume(ended)
    assert run.checkpoint() == ended and run.state.ended
    run.resume(checkpoint, "as asked")
    assert run.state == RunState()
    assert run.step().first_sample == ended.sample
    _, message = keeper.of("event")[-1]
    assert Checkpoint.from_tree(json.loads(message.data)["checkpoint"]) == checkpoint
    assert keeper.applied[-1] == (ended.sample, Commands(30.0, 30.0, 1623.156))


def test_over_speed_ends_the_run_and_a_reset_recovers():
    run, keeper = start(
        **{"operation.speed_limit": 1624.0, "operation.control": "torque", "operation.load_torque": 0.0}
    )
    while not run.state.ended:
        run.step()
    assert "operation.speed_limit" in run.state.reason
    assert run.state.ending is Ending.TRIPPED
    assert keeper.events[-1] == (run.engine.sample, "end")
    with pytest.raises(GearboxError, match="ended"):
        run.step()
    assert not keeper.closed
    run.reset()
    assert run.state == RunState()
    run.step()
    run.close()
    assert keeper.closed


@pytest.mark.parametrize(("duration", "samples"), [(0.005, 500), (0.004, 400), (0.0040001, 401)])
def test_duration_ends_the_run_on_its_last_sample(duration, samples):
    run, keeper = start(**{"pacing.duration": duration})
    while not run.state.ended:
        run.step()
    assert run.state == RunState(ending=Ending.COMPLETED, reason="pacing.duration reached")
    assert run.engine.sample == samples == sum(map(len, keeper.chunks))
    assert [event for _, event in keeper.events] == ["start", "end"]


def test_a_sink_attached_later_learns_the_commands_in_force():
    run, _ = start()
    run.step()
    late = Kept()
    run.attach(late)
    run.step()
    run.detach(late)
    run.step()
    assert late.applied == [(CHUNK, run.engine.commands)]
    assert [chunk.first_sample for chunk in late.chunks] == [CHUNK]


def test_unbalanced_torques_are_named_with_the_acceleration_they_cause():
    torque = {"operation.control": "torque"}
    assert parameter_warnings(Parameters.from_flat(torque)) == []
    assert parameter_warnings(Parameters.from_flat({"operation.drive_torque": 31.0})) == []
    (line,) = parameter_warnings(Parameters.from_flat({**torque, "operation.drive_torque": 31.0}))
    assert "operation.drive_torque = 31" in line and "224.2 rad/s^2" in line
    assert (
        parameter_warnings(
            Parameters.from_flat({**torque, "operation.drive_torque": 15.0, "gears.driven.teeth": 80})
        )
        == []
    )


def test_only_what_some_sink_wants_of_a_chunk_is_encoded():
    parameters = Parameters()
    sinks = [Picky("dte"), Picky("energy")]
    run = Run(Engine(parameters), Encoder(parameters, EPOCH), sinks)
    run.step()
    for sink in sinks:
        assert [r.topic for r in sink.records if r.topic in CHUNK_TOPICS] == ["dte", "energy"]
    keeper = Kept()
    run.attach(keeper)
    run.step()
    encoded = [record.topic for record in keeper.records if record.topic in CHUNK_TOPICS]
    assert encoded == [topic for topic in CHUNK_TOPICS if topic not in ("impacts", "clock")]
