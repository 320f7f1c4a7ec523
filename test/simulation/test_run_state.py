"""Whether a run goes on, and why it ended, is told in one place."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from typing import Any

import pytest

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, change_to, change_values
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import Ending, RunState
from gear_dynamics_ros.topics import CHUNK_TOPICS, TOPICS

CHUNK = 200
RUNNING_AWAY = {
    "operation.control": "torque",
    "operation.load_torque": 0.0,
    "operation.speed_limit": 1624.0,
}


class Events:
    """A sink that keeps the operator events."""

    def __init__(self) -> None:
        self.found: list[tuple[int, str, str]] = []

    def wanted(self) -> Collection[str]:
        return CHUNK_TOPICS

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        for record in records:
            if record.topic == "event":
                event = json.loads(deserialize(TOPICS["event"].type, record.data).data)
                self.found.append((event["sample"], event["event"], event["message"]))

    def close(self) -> None:
        """Nothing to finish."""


def start(**values: Any) -> tuple[Run, Events]:
    parameters = Parameters.from_flat(values)
    events = Events()
    run = Run(Engine(parameters), Encoder(parameters, 0), [events], duration=parameters.pacing.duration)
    return run, events


def test_a_pause_is_an_event_and_is_told_once() -> None:
    run, events = start()
    run.step()
    assert run.pause() and not run.pause()
    assert run.state == RunState(paused=True) and run.state.name == "paused"
    assert run.unpause() and not run.unpause()
    assert run.state == RunState() and run.state.name == "running"
    assert events.found == [(0, "start", ""), (CHUNK, "pause", ""), (CHUNK, "resume", "")]


def test_a_paused_run_that_is_stepped_to_its_end_is_paused_after_a_reset() -> None:
    run, _ = start(**RUNNING_AWAY)
    run.pause()
    while not run.state.ended:
        run.step()
    assert run.state.ending is Ending.TRIPPED and run.state.name == "ended"
    for ask in (run.pause, run.unpause, run.step):
        with pytest.raises(GearboxError, match=r"the run has ended \(over-speed.*call ~/reset first"):
            ask()
    run.reset()
    assert run.state == RunState(paused=True)


@pytest.mark.parametrize("ending", [Ending.COMPLETED, Ending.STOPPED, Ending.TRIPPED, Ending.FAILED])
def test_each_end_is_told_by_one_event_and_gone_after_a_reset(ending: Ending) -> None:
    values: dict[str, Any] = {"pacing.duration": 0.003} if ending is Ending.COMPLETED else {}
    run, events = start(**(RUNNING_AWAY if ending is Ending.TRIPPED else values))
    if ending is Ending.STOPPED:
        run.finish("SIGINT")
    elif ending is Ending.FAILED:
        run.fail("out of paper")
    while not run.state.ended:
        run.step()
    run.finish("too late")
    assert run.state.ending is ending
    assert run.state.completed == (ending is Ending.COMPLETED)
    ends = [event for event in events.found if event[1] == "end"]
    assert ends == [(run.engine.sample, "end", run.state.reason)]
    run.reset()
    assert run.state == RunState()


def test_a_failure_after_the_end_is_what_the_state_tells() -> None:
    run, events = start(**{"pacing.duration": 0.002})
    run.step()
    run.fail("the recording could not be finished")
    run.fail("and another")
    assert run.state == RunState(ending=Ending.FAILED, reason="the recording could not be finished")
    assert [kind for _, kind, _ in events.found] == ["start", "end"]


def test_a_change_made_for_other_parameters_than_those_in_force_changes_nothing() -> None:
    run, events = start()
    run.step()
    stale = change_values(run.engine.parameters, {"oil.viscosity": 0.1})
    run.change(change_values(run.engine.parameters, {"oil.viscosity": 0.05}))
    in_force, state = run.engine.parameters, run.checkpoint()
    with pytest.raises(GearboxError, match="changed meanwhile by something else"):
        run.change(stale)
    assert run.engine.parameters is in_force and run.checkpoint() == state
    assert [kind for _, kind, _ in events.found] == ["start", "parameters"]
    run.change(change_to(in_force, stale.new))
    assert run.engine.parameters.oil.viscosity == 0.1
