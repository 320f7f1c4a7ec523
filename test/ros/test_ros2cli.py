"""The commands of ros2cli against the node, where an installation of ROS 2 has them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time

import pytest

from support.gearbox import start_gearbox

ROS2 = shutil.which("ros2")
PATIENCE = 60.0
UNSEEN = ("Node not found", "Unable to find node")
ASKING_A_DAEMON = ("node", "param", "lifecycle")

pytestmark = pytest.mark.skipif(ROS2 is None, reason="ros2 is not installed: it is not among the ROS wheels")


def ros2(*words):
    """Output of a command; it must exit with 0.

    Commands that would ask a daemon, and start one, look at the graph themselves: a daemon that has just
    started knows nothing yet, and outlives the test. On a busy machine their look may be too short too.
    """
    if words[0] in ASKING_A_DAEMON:
        words = (*words[:2], "--no-daemon", "--spin-time", "2", *words[2:])
    deadline = time.monotonic() + PATIENCE
    while True:
        answer = subprocess.run(
            [str(ROS2), *words], capture_output=True, text=True, timeout=PATIENCE, check=False
        )
        if answer.returncode == 0:
            return answer.stdout
        output = answer.stdout + answer.stderr
        assert any(text in output for text in UNSEEN) and time.monotonic() < deadline, output


def test_a_running_gearbox_answers(ros_domain, process):
    start_gearbox(process, "pacing.real_time_factor:=0.2").wait_for("running the improved model")
    info = ros2("node", "info", "/gearbox")
    assert "/gearbox/waveform: std_msgs/msg/Float64MultiArray" in info
    assert "/gearbox/step: std_srvs/srv/Trigger" in info
    assert "successful" in ros2("param", "set", "/gearbox", "oil.viscosity", "0.05")
    assert "0.05" in ros2("param", "get", "/gearbox", "oil.viscosity")
    answer = ros2("service", "call", "/gearbox/pause", "std_srvs/srv/SetBool", "{data: true}")
    assert "success=True" in answer
    assert "success=True" in ros2("service", "call", "/gearbox/step", "std_srvs/srv/Trigger")


def test_the_rate_of_a_topic_can_be_measured(ros_domain, process):
    start_gearbox(process, "pacing.real_time_factor:=0.2").wait_for("running the improved model")
    with subprocess.Popen(
        [str(ROS2), "topic", "hz", "/gearbox/dte"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as watching:
        assert watching.stdout is not None
        try:
            assert any("average rate" in line for line in watching.stdout)
        finally:
            watching.send_signal(signal.SIGINT)


def test_transitions_are_made(ros_domain, process):
    start_gearbox(process, "autostart:=false")
    for transitions, state in (
        (("configure", "activate"), "active"),
        (("deactivate", "cleanup"), "unconfigured"),
    ):
        for transition in transitions:
            assert "successful" in ros2("lifecycle", "set", "/gearbox", transition)
        assert state in ros2("lifecycle", "get", "/gearbox")
