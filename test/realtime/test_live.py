"""A run on a thread of its own, paced by the real clock."""

from __future__ import annotations

import threading
import time

import pytest

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.realtime.engine_thread import EngineThread
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import Ending
from gear_dynamics_ros.topics import CHUNK_TOPICS
from support.processes import until

# Half a second of simulated time from the start to the speed limit.
RUNNING_AWAY = {"operation.control": "torque", "operation.load_torque": 0.0}


class Watcher:
    """A sink that can be waited on until a chunk is as wanted."""

    def __init__(self):
        self.chunks = []
        self.changed = threading.Condition()

    def wanted(self):
        return CHUNK_TOPICS

    def write(self, chunk, records):
        with self.changed:
            if chunk is not None:
                self.chunks.append(chunk)
            self.changed.notify_all()

    def close(self):
        pass

    def until(self, condition):
        with self.changed:
            assert self.changed.wait_for(lambda: self.chunks and condition(self.chunks[-1]), 120.0)


@pytest.fixture
def start():
    running = []

    def begin(**values):
        parameters = Parameters.from_flat(values)
        watcher = Watcher()
        run = Run(Engine(parameters), Encoder(parameters, 0), [watcher])
        ended = threading.Event()
        live = EngineThread(run, Mailbox(parameters, time.monotonic_ns()), ended.set)
        running.append(live)
        live.start()
        return live, watcher, ended

    yield begin
    for live in running:
        live.stop()


@pytest.mark.parametrize(("on_timeout", "load"), [("release", 0.0), ("hold", 21.0)])
def test_a_command_that_is_too_old_is_held_or_released(start, on_timeout, load):
    live, watcher, _ = start(
        **{
            "operation.control": "torque",
            "operation.command_timeout": 0.05,
            "operation.on_timeout": on_timeout,
            "pacing.real_time_factor": 0.5,
        }
    )
    live.mailbox.offer("load_torque_command", {"load_torque": 21.0}, b"", time.monotonic_ns())
    watcher.until(lambda chunk: live.timed_out and chunk.commands.load_torque == load)
    live.mailbox.offer("load_torque_command", {"load_torque": 22.0}, b"", time.monotonic_ns())
    watcher.until(lambda chunk: chunk.commands.load_torque == 22.0)


def test_what_fails_in_a_call_fails_in_the_caller_and_the_run_goes_on(start):
    live, watcher, _ = start()
    with pytest.raises(GearboxError, match="not paused"):
        step(live, 1, 1.0).result(60.0)
    known = len(watcher.chunks)
    watcher.until(lambda chunk: len(watcher.chunks) > known)


def test_a_sink_that_fails_ends_the_run_with_its_reason(start):
    live, _, ended = start()

    class Broken:
        def wanted(self):
            return CHUNK_TOPICS

        def write(self, chunk, records):
            raise RuntimeError("out of paper")

        def close(self):
            pass

    live.call(lambda: live.run.attach(Broken()))
    assert ended.wait(120.0)
    assert "out of paper" in live.run.state.reason


def test_stopping_and_starting_loses_no_sample(start):
    live, watcher, _ = start(**{"pacing.real_time_factor": 0.0})
    for _ in range(3):
        known = len(watcher.chunks)
        watcher.until(lambda chunk, known=known: len(watcher.chunks) > known + 3)
        live.stop()
        assert not live.active
        live.start()
    live.stop()
    assert [chunk.first_sample for chunk in watcher.chunks] == [200 * k for k in range(len(watcher.chunks))]


def step(live, chunks, timeout):
    values = {"stepping.chunks": chunks, "stepping.timeout": timeout}
    live.call(lambda: live.change(change_values(live.run.engine.parameters, values)))
    return live.step()


def paused(start, **values):
    live, watcher, ended = start(**values)
    watcher.until(lambda chunk: True)
    assert live.call(lambda: live.pause()) and not live.call(lambda: live.pause())
    return live, watcher, ended


def test_steps_make_as_many_chunks_as_wanted_while_paused(start):
    live, watcher, _ = paused(start)
    known = len(watcher.chunks)
    before, overruns = live.time, live.pace().overruns
    assert step(live, 25, 60.0).result(60.0) == pytest.approx(before + 0.05)
    assert len(watcher.chunks) == known + 25
    assert live.pace().overruns == overruns


@pytest.mark.parametrize(
    ("meanwhile", "reason"),
    [
        (lambda live: live.call(lambda: live.unpause()), "aborted: resumed after"),
        (lambda live: live.call(lambda: live.restart(live.run.reset)), "aborted: the run was reset .* after"),
        (lambda live: live.stop(), "aborted: deactivated after"),
    ],
)
def test_steps_are_given_up_when_something_else_is_wanted(start, meanwhile, reason):
    live, watcher, _ = paused(start)
    known = len(watcher.chunks)
    steps = step(live, 1_000_000, 3600.0)
    watcher.until(lambda chunk: len(watcher.chunks) > known)
    with pytest.raises(GearboxError, match="stepping already"):
        step(live, 1, 1.0).result(60.0)
    meanwhile(live)
    with pytest.raises(GearboxError, match=f"{reason} .* of 1000000 chunks"):
        steps.result(60.0)


def test_steps_are_given_up_when_their_time_is_over(start):
    live, _, _ = paused(start)
    with pytest.raises(GearboxError, match=r"stepping.timeout"):
        step(live, 1_000_000, 0.05).result(60.0)
    assert live.run.state.paused and step(live, 1, 60.0).result(60.0)


def test_steps_are_given_up_when_the_run_ends(start):
    live, _, ended = paused(start, **RUNNING_AWAY)
    with pytest.raises(GearboxError, match="aborted: over-speed"):
        step(live, 1_000_000, 3600.0).result(120.0)
    assert ended.wait(60.0)
    with pytest.raises(GearboxError, match=r"the run has ended .*: call ~/reset first"):
        step(live, 1, 1.0).result(60.0)


def test_an_overrun_ends_the_run_where_it_is_to(start):
    live, _, ended = start(**{"pacing.real_time_factor": 1e6, "pacing.on_overrun": "error"})
    assert ended.wait(120.0)
    assert "overrun" in live.run.state.reason and "pacing.real_time_factor" in live.run.state.reason


def test_parameters_change_between_two_chunks_and_the_pace_with_them(start):
    live, watcher, _ = start(**{"pacing.real_time_factor": 0.1})
    watcher.until(lambda chunk: True)
    parameters = live.run.engine.parameters
    wanted = change_values(parameters, {"operation.load_torque": 12.0, "pacing.real_time_factor": 0.0})
    live.call(lambda: live.change(wanted))
    known = len(watcher.chunks)
    watcher.until(lambda chunk: len(watcher.chunks) > known + 3)
    load = watcher.chunks[-1]["load_torque"]
    assert set(load) == {12.0}
    assert watcher.chunks[0].commands.load_torque == 30.0


class Broken:
    """A sink that takes chunks and nothing between two."""

    def wanted(self):
        return CHUNK_TOPICS

    def write(self, chunk, records):
        if chunk is None:
            raise RuntimeError("out of ink")

    def close(self):
        pass


def test_what_is_posted_to_a_broken_sink_ends_the_run_and_not_the_thread(start):
    live, _, ended = start()
    live.call(lambda: live.run.attach(Broken()))
    live.post(list)
    assert ended.wait(120.0)
    assert live.call(lambda: live.run.state.reason) == "out of ink"


def test_what_was_asked_behind_something_that_fails_is_done(start):
    live, _, ended = start()
    answers = []
    hold = threading.Event()
    callers = [
        threading.Thread(target=live.call, args=[act]) for act in (hold.wait, lambda: answers.append("done"))
    ]
    callers[0].start()
    live.run.attach(Broken())
    live.post(list)
    callers[1].start()
    until(lambda: len(live._requests) == 2, "both are asked")
    hold.set()
    for caller in callers:
        caller.join(60.0)
    assert answers == ["done"] and ended.wait(60.0)


def test_a_failure_at_the_end_of_the_run_leaves_the_thread_to_serve(start):
    live, _, ended = start(**RUNNING_AWAY)

    def fail():
        ended.set()
        raise RuntimeError("nobody wants to know")

    live._on_end = fail
    assert ended.wait(60.0)
    assert (
        live.call(lambda: live.run.state.reason) == "nobody wants to know"
        and live.run.state.ending is Ending.FAILED
    )


def test_what_came_while_nothing_ran_is_no_command(start):
    live, watcher, _ = start(**{"pacing.real_time_factor": 0.5})
    watcher.until(lambda chunk: True)
    live.stop()
    live.mailbox.offer("load_torque_command", {"load_torque": 11.0}, b"", time.monotonic_ns())
    known = len(watcher.chunks)
    live.start()
    watcher.until(lambda chunk: len(watcher.chunks) > known)
    assert watcher.chunks[-1].commands.load_torque == 30.0


def test_an_ended_run_can_be_neither_paused_nor_resumed(start):
    live, _, ended = start(**RUNNING_AWAY)
    assert ended.wait(60.0)
    with pytest.raises(GearboxError, match="the run has ended"):
        live.call(lambda: live.unpause())
