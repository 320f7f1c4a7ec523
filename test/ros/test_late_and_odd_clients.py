"""Clients that join late, with another quality of service, or with joints that the gearbox does not have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from gear_dynamics_ros import recording
from gear_dynamics_ros.messages.cdr import stamp_ns
from support.gearbox import Client, start_gearbox
from support.processes import StartProcess


def test_who_joins_during_a_pause_learns_the_time(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    node = start_gearbox(process, "clock_rate:=50.0", f"recording.path:={bag}")
    with Client(hears=["event"]) as operator:
        operator.until(lambda: operator.heard["event"])
        assert operator.switch("pause", True).success
        with Client(hears=[]) as late:
            clock: list[Any] = []
            late.subscribe("clock", clock.append)
            late.until(lambda: len(clock) > 1)
    assert node.stop() == 0
    heard = {stamp_ns(message.clock) for message in clock}
    recorded = [stamp_ns(message.clock) for _, message in recording.open(bag).messages("clock")]
    assert heard == {recorded[-1]} and len(set(recorded)) == len(recorded)


def test_warnings_have_full_names_and_come_once(ros_domain: int, process: StartProcess) -> None:
    node = start_gearbox(process)
    with Client(hears=["event"]) as client:
        unreliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        client.node.create_publisher(JointState, "/gearbox/command/joint", unreliable)
        node.wait_for("incompatible QoS")
        names = [f"joint_{number}" for number in range(100)]
        for _ in range(3):
            client.command("joint_command", JointState(name=names, velocity=[1.0] * 100))
        node.wait_for("take no commands")
        client.command("joint_command", JointState(name=["one_more"], velocity=[1.0]))
        node.wait_for("takes no commands")
    assert node.stop() == 0
    warnings = [line for line in node.output.splitlines() if "[WARN]" in line]
    (incompatible,) = [line for line in warnings if "incompatible QoS" in line]
    assert "'/gearbox/command/joint'" in incompatible
    many, one = [line for line in warnings if "no commands" in line]
    assert "/gearbox/command/joint: joints 'joint_0', 'joint_1'" in many and "and 95 more take no" in many
    assert "joint 'one_more' takes no commands" in one
    assert "~/" not in "\n".join(warnings)
