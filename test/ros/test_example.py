"""The speed controller of the examples against a real gearbox, over topics; judged in simulated time."""

from __future__ import annotations

import math
import signal
import sys
from itertools import pairwise

import numpy as np
import pytest
from std_msgs.msg import Float64

from gear_dynamics_ros.messages.cdr import stamp_ns
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.ros.node_topics import quality
from gear_dynamics_ros.topics import TOPICS
from support.gearbox import Peer, start_gearbox
from support.paths import ROOT

SPEED = 1000.0
PROPORTIONAL, INTEGRAL = 0.11, 0.55
LOADS = (30.0, 40.0, 25.0)
SETTLED = 1.0  # s of simulated time after a step
HELD = 1.5
TOLERANCE = 3.0  # rad/s
SMOOTHED = 25  # chunks: the teeth shake the shaft far faster than the loop moves it


def greatest_drop(step):
    """Of the speed of a rigid gearbox under the controller without delay, rad/s, for a step of the load."""
    inertia = sum(gear.inertia for gear in (Parameters().gears.driving, Parameters().gears.driven))
    slow, fast = sorted(-np.roots([inertia, PROPORTIONAL, INTEGRAL]).real)
    at = math.log(fast / slow) / (fast - slow)
    return abs(step) / inertia * (math.exp(-slow * at) - math.exp(-fast * at)) / (fast - slow)


class Bench(Peer):
    """Hears the shaft and puts load on it."""

    def __init__(self):
        super().__init__("bench")
        self.rows = []  # simulated time in s since the first, speed, drive torque, load torque
        self.first_ns = None
        self.load = self.publisher("load_torque_command")
        every = quality(TOPICS["joint_states"])
        every.depth = 500
        self.subscribe("joint_states", self.hear, every)

    def hear(self, state):
        now = stamp_ns(state.header.stamp)
        self.first_ns = now if self.first_ns is None else self.first_ns
        self.rows.append(((now - self.first_ns) * 1e-9, state.velocity[0], *state.effort[:2]))

    def put(self, load):
        """Set the load; returns the simulated time from which it acts."""
        known = len(self.rows)
        self.load.publish(Float64(data=load))
        self.until(lambda: self.rows[known:] and self.rows[-1][3] == load)
        return next(row[0] for row in self.rows[known:] if row[3] == load)

    def speeds(self, begin, end):
        """Smoothed speeds between two simulated times, once they have passed."""
        self.until(lambda: self.rows[-1][0] > end)
        speeds = [speed for at, speed, *_ in self.rows if begin <= at <= end]
        return np.convolve(speeds, np.full(SMOOTHED, 1.0 / SMOOTHED), "valid")


@pytest.fixture
def bench(ros_domain):
    with Bench() as bench:
        yield bench


def test_speed_comes_back_after_each_load_step(ros_domain, process, bench):
    settings = {
        "operation.control": "torque",
        "operation.speed": SPEED,
        "operation.drive_torque": LOADS[0],
        "operation.load_torque": LOADS[0],
        "operation.command_timeout": 5.0,
        "operation.on_timeout": "release",
        # What a busy machine adds to the delay over the topics counts by as much less.
        "pacing.real_time_factor": 0.25,
    }
    start_gearbox(process, *(f"{name}:={value}" for name, value in settings.items()))
    bench.until(lambda: bench.rows)
    gains = ("-p", f"proportional:={PROPORTIONAL}", "-p", f"integral:={INTEGRAL}", "-p", f"speed:={SPEED}")
    controller = process(sys.executable, str(ROOT / "examples/speed_controller.py"), "--ros-args", *gains)
    bench.until(lambda: bench.load.get_subscription_count() > 0)
    bench.until(lambda: any(row[2] != LOADS[0] for row in bench.rows))
    began = bench.rows[-1][0]
    assert np.abs(bench.speeds(began + SETTLED, began + HELD) - SPEED).max() < TOLERANCE

    for before, load in pairwise(LOADS):
        at = bench.put(load)
        held = bench.speeds(at + SETTLED, at + HELD)
        assert np.abs(held - SPEED).max() < TOLERANCE
        away = (math.copysign(1.0, load - before) * (SPEED - bench.speeds(at, at + SETTLED))).max()
        # Delay over the topics adds to the drop.
        assert 0.85 < away / greatest_drop(load - before) < 2.0

    assert bench.switch("pause", True).success
    controller.wait_for("the loop is open")
    assert bench.switch("pause", False).success
    resumed = bench.rows[-1][0]
    assert np.abs(bench.speeds(resumed, resumed + HELD) - SPEED).max() < TOLERANCE

    controller.signal(signal.SIGINT)
    assert controller.wait() == 0
    assert "Traceback" not in controller.output
    bench.until(lambda: bench.rows[-1][2:] == (0.0, 0.0))
