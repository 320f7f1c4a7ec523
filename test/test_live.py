"""A run on a thread of its own, paced by the real clock."""

from __future__ import annotations

import threading
import time

import pytest

from gear_dynamics_ros.commands import Mailbox
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.live import Live
from gear_dynamics_ros.messages import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.run import Run


class Watcher:
    """A sink that can be waited on until a chunk is as wanted."""

    def __init__(self):
        self.chunks = []
        self.changed = threading.Condition()

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
        live = Live(run, Mailbox(parameters, time.monotonic_ns()), lambda chunk: [], ended.set)
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
        live.call(live.single_step)
    known = len(watcher.chunks)
    watcher.until(lambda chunk: len(watcher.chunks) > known)


def test_a_sink_that_fails_ends_the_run_with_its_reason(start):
    live, _, ended = start()

    class Broken:
        def write(self, chunk, records):
            raise RuntimeError("out of paper")

        def close(self):
            pass

    live.call(lambda: live.run.attach(Broken()))
    assert ended.wait(120.0)
    assert "out of paper" in live.ended


def test_stopping_and_starting_loses_no_sample(start):
    live, watcher, _ = start(**{"pacing.real_time_factor": 0.0})
    for _ in range(3):
        known = len(watcher.chunks)
        watcher.until(lambda chunk, known=known: len(watcher.chunks) > known + 3)
        live.stop()
        with pytest.raises(GearboxError, match="not active"):
            live.call(lambda: None)
        live.start()
    live.stop()
    assert [chunk.first_sample for chunk in watcher.chunks] == [200 * k for k in range(len(watcher.chunks))]
