"""The end of the process that ends the node."""

from __future__ import annotations

import os
import signal
import sys

from gear_dynamics_ros import recording
from support.processes import until

# Starts its arguments as ``ros2 run`` does: as a child, told of no signal.
ROS2 = "import subprocess, sys\nsys.exit(subprocess.Popen([sys.executable, *sys.argv[4:]]).wait())\n"


def test_a_node_whose_ros2_run_was_terminated_finishes_its_recording(ros_domain, process, tmp_path):
    bag = tmp_path / "bag"
    ros2 = tmp_path / "ros2"
    ros2.write_text(ROS2)
    node = ["-m", "gear_dynamics_ros.cli.gearbox", "--ros-args", "-p", f"recording.path:={bag}"]
    parent = process(sys.executable, ros2, "run", "gear_dynamics_ros", "gearbox", *node)
    parent.wait_for("recording to")
    parent.signal(signal.SIGTERM)
    parent.wait_for("the ros2 run that started it has ended")
    until((bag / "metadata.yaml").exists, "the recording is finished")
    assert recording.open(bag).complete


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
