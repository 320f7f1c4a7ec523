"""The end of the process that started a command."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from gear_dynamics_ros import recording
from support.processes import until

# Starts its arguments as ``ros2 run`` and ``ros2 launch`` do: as a child, told of no signal.
ROS2 = "import subprocess, sys\nsys.exit(subprocess.Popen([sys.executable, *sys.argv[4:]]).wait())\n"


@pytest.fixture
def start_as_child(process, tmp_path):
    """Starts a command as the child of a program with the command line given."""

    def start(program, verb, command, *arguments):
        path = tmp_path / program
        path.write_text(ROS2)
        module = ["-m", f"gear_dynamics_ros.cli.{command}", *map(str, arguments)]
        return process(sys.executable, path, verb, "gear_dynamics_ros", command, *module)

    return start


@pytest.mark.parametrize(
    ("program", "verb"), [("ros2", "run"), ("ros2", "launch"), ("launch_test", "test.py")]
)
def test_a_node_whose_launcher_was_terminated_finishes_its_recording(
    ros_domain, start_as_child, tmp_path, program, verb
):
    bag = tmp_path / "bag"
    parent = start_as_child(program, verb, "gearbox", "--ros-args", "-p", f"recording.path:={bag}")
    parent.wait_for("recording to")
    parent.signal(signal.SIGTERM)
    parent.wait_for("ending: SIGTERM")
    until((bag / "metadata.yaml").exists, "the recording is finished")
    assert recording.open(bag).complete


def test_a_simulation_whose_ros2_run_was_killed_finishes_its_recording(start_as_child, tmp_path):
    bag = tmp_path / "bag"
    parent = start_as_child("ros2", "run", "simulate", "--duration", "1000", "--output", bag)
    until(lambda: any(bag.glob("*.mcap")), "the recording has begun")
    parent.signal(signal.SIGKILL)
    parent.wait_for("simulate: interrupted by SIGTERM")
    until((bag / "metadata.yaml").exists, "the recording is finished")


def test_a_command_outlives_another_parent(start_as_child, tmp_path):
    bag = tmp_path / "bag"
    parent = start_as_child("shell", "run", "simulate", "--duration", "0.5", "--output", bag)
    until(lambda: any(bag.glob("*.mcap")), "the recording has begun")
    parent.signal(signal.SIGKILL)
    until((bag / "metadata.yaml").exists, "the recording is finished")
    assert recording.open(bag).complete
    assert "interrupted" not in parent.output


def test_a_signal_ignored_by_the_shell_reaches_the_node_all_the_same(ros_domain, process):
    node = process(
        "/bin/sh",
        "-c",
        f"trap '' INT; exec {sys.executable} -m gear_dynamics_ros.cli.gearbox",
        PATH=os.environ["PATH"],
    )
    node.wait_for("running")
    node.signal(signal.SIGINT)
    assert node.wait() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_error_does_not_replace_the_exit_code(ros_domain, process, number):
    node = process("gearbox", "--ros-args", "-p", "oil.viscosity:=-1.0")
    node.wait_for("gearbox: error: ")
    while node.returncode is None:
        node.signal(number)
    assert node.returncode == 2
