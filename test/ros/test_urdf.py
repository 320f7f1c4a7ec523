"""The URDF, read by a parser of others: it moves as the gearbox does and commands it."""

from __future__ import annotations

import math
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from urdf_parser_py.urdf import URDF

from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import base_radii
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.topics import JOINT_STATE, WRENCH
from gear_dynamics_ros.urdf.__main__ import urdf_main
from gear_dynamics_ros.urdf.description import HARDWARE_PLUGINS, robot_description
from support.gearbox import Peer, start_gearbox
from support.paths import ROOT

UNEQUAL = Parameters.from_flat({"gears.driving.teeth": 25, "gears.driven.teeth": 40})


def parsed(parameters):
    # The parser reports tags that it does not know; ros2_control is not its business.
    tree = ElementTree.fromstring(robot_description(parameters))
    tree.remove(tree.find("ros2_control"))
    return URDF.from_xml_string(ElementTree.tostring(tree))


def rotation(axis, angle):
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def pose(robot, link, positions):
    """Rotation (3, 3) and origin (3,) of a link in the root's frame."""
    if link == robot.get_root():
        return np.eye(3), np.zeros(3)
    joint_name, parent = robot.parent_map[link]
    joint = robot.joint_map[joint_name]
    turned, origin = pose(robot, parent, positions)
    origin = origin + turned @ np.array(joint.origin.xyz)
    assert joint.origin.rpy == [0.0, 0.0, 0.0]
    axis = np.array(joint.axis if joint.axis is not None else (1.0, 0.0, 0.0))
    if joint.type == "continuous":
        return turned @ rotation(axis, positions[joint_name]), origin
    if joint.type == "prismatic":
        return turned, origin + turned @ axis * positions[joint_name]
    return turned, origin


def involute(base_radius, start):
    """Points (n, 3) of a flank in its gear's frame, unwound clockwise from the angle ``start``."""
    roll = np.linspace(0.0, 1.2, 40_001)
    angle = start - roll
    x, y = np.cos(angle) - roll * np.sin(angle), np.sin(angle) + roll * np.cos(angle)
    return base_radius * np.column_stack([x, y, np.zeros_like(x)])


def crossing(points, through, along):
    """How far from ``through`` the polyline crosses the line in the direction ``along``, m."""
    aside = (points - through) @ np.array([along[1], -along[0], 0.0])
    (index,) = np.flatnonzero(np.diff(np.sign(aside)))
    share = aside[index] / (aside[index] - aside[index + 1])
    return float((points[index] + share * (points[index + 1] - points[index]) - through) @ along)


def test_the_shipped_file_is_what_the_defaults_print(capsys):
    assert urdf_main([]) == 0
    assert capsys.readouterr().out == (ROOT / "urdf/gearbox.urdf").read_text()


def test_flanks_meet_where_the_joint_states_put_the_gears():
    parameters = UNEQUAL
    robot = parsed(parameters)
    engine, encoder = Engine(parameters), Encoder(parameters, 0)
    alpha = parameters.gears.pressure_angle
    start = math.tan(alpha) - alpha
    teeth = parameters.gears.driving.teeth, parameters.gears.driven.teeth
    # Where the flanks of the first teeth touch in the pitch point.
    flanks = [
        involute(radius, start + half_turn)
        for radius, half_turn in zip(base_radii(parameters), (0.0, math.pi), strict=True)
    ]
    seen = []
    for _ in range(7):
        (states,) = [
            deserialize(JOINT_STATE, record.data)
            for record in encoder.chunk(engine.advance(37))
            if record.topic == "joint_states"
        ]
        positions = dict(zip(states.name, states.position.tolist(), strict=True))
        at_rest = pose(robot, "mesh_contact", {**positions, "mesh": 0.0})[1]
        mesh = pose(robot, "mesh_contact", {**positions, "mesh": 1e-3})[1] - at_rest
        along = mesh / np.linalg.norm(mesh)
        np.testing.assert_allclose(np.linalg.norm(mesh), 1e-3)
        passed = math.floor(positions["driving"] * teeth[0] / (2 * math.pi))
        places = []
        for gear, flank, count, backward in zip(("driving", "driven"), flanks, teeth, (-1, 1), strict=True):
            turned, origin = pose(robot, f"{gear}_gear", positions)
            this_tooth = flank @ rotation((0, 0, 1), backward * passed * 2 * math.pi / count).T
            places.append(crossing(this_tooth @ turned.T + origin, at_rest, along))
        assert abs(places[0] - places[1]) < 100e-6, places
        seen.append(places[0])
    assert max(seen) - min(seen) > 2e-3


def test_gears_have_their_mass_and_moments_and_stand_a_centre_distance_apart():
    robot = parsed(UNEQUAL)
    gears = UNEQUAL.gears
    for side, count in (("driving", 25), ("driven", 40)):
        link = robot.link_map[f"{side}_gear"]
        gear = getattr(gears, side)
        assert link.inertial.mass == gear.mass
        assert link.inertial.inertia.izz == gear.inertia
        # What a body can have: no moment is greater than the sum of the others.
        assert link.inertial.inertia.izz < 2 * link.inertial.inertia.ixx
        assert link.visual.geometry.radius == pytest.approx(gears.module * count / 2)
    apart = pose(robot, "driven_bearing", {})[1] - pose(robot, "driving_bearing", {})[1]
    np.testing.assert_allclose(apart, [gears.module * 65 / 2, 0.0, 0.0])


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_forces_are_given_in_frames_that_stand_as_the_model_does(prefix):
    parameters = Parameters.from_flat({"joint_prefix": prefix})
    robot = parsed(parameters)
    records = Encoder(parameters, 0).chunk(Engine(parameters).advance())
    frames = [deserialize(WRENCH, r.data).header.frame_id for r in records if "bearing_force" in r.topic]
    assert len(frames) == 2
    for frame in frames:
        np.testing.assert_array_equal(pose(robot, frame, {})[0], np.eye(3))


def test_prefix_and_node_reach_every_name():
    text = robot_description(Parameters.from_flat({"joint_prefix": "left_"}), "/cell/left")
    names = {element.get("name") for element in ElementTree.fromstring(text) if element.tag != "ros2_control"}
    assert {"left_driving", "left_driven", "left_mesh", "left_driving_bearing"} <= names
    assert all(name.startswith("left_") for name in names)
    settings = {element.get("name"): element.text for element in ElementTree.fromstring(text).iter("param")}
    assert settings["joint_commands_topic"] == "/cell/left/command/joint"
    assert settings["joint_states_topic"] == "/cell/joint_states"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--node", "gearbox"], "write it like /gearbox"),
        (["--set", "gears.module=-1"], "gears.module"),
        (["--params-file", "none.yaml"], "none.yaml"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(arguments, told):
    command = [sys.executable, "-m", "gear_dynamics_ros.urdf", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert told in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize("plugin", HARDWARE_PLUGINS)
def test_both_plugins_can_be_named(plugin, capsys):
    assert urdf_main(["--plugin", plugin]) == 0
    robot = ElementTree.fromstring(capsys.readouterr().out)
    assert robot.findtext("ros2_control/hardware/plugin") == plugin
    # As in joint_state_topic_hardware_interface: a state without an interface would be an error there.
    for joint in robot.findall("ros2_control/joint"):
        states = {interface.get("name") for interface in joint.findall("state_interface")}
        assert states == {"position", "velocity", "effort"}


def test_the_text_reaches_robot_state_publisher_as_a_parameter(ros_domain):
    text = (ROOT / "urdf/gearbox.urdf").read_text()
    context = Context()
    # Without the last newline, as the shell does in $(cat FILE).
    words = ["--ros-args", "-p", f"robot_description:={text.rstrip()}"]
    rclpy.init(args=words, context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("publisher", context=context, automatically_declare_parameters_from_overrides=True)
        found = node.get_parameter("robot_description").value
    finally:
        context.try_shutdown()
    assert ElementTree.canonicalize(found, strip_text=True) == ElementTree.canonicalize(text, strip_text=True)


class Plugin(Peer):
    """Sends what the plugins of ros2_control make of the block: all joints, their commands in one message."""

    def __init__(self, block):
        settings = {element.get("name"): element.text for element in block.find("hardware").iter("param")}
        self.joints = {
            joint.get("name"): {
                interface.get("name"): float(interface.find("param").text)
                for interface in joint.iter("command_interface")
            }
            for joint in block.iter("joint")
        }
        super().__init__("controllers")
        self.states, self.applied = [], []
        self.commander = self.node.create_publisher(JointState, settings["joint_commands_topic"], 1)
        self.node.create_subscription(
            JointState,
            settings["joint_states_topic"],
            self.states.append,
            qos_profile_sensor_data,
        )
        self.subscribe("applied_command", self.applied.append)

    def packed(self):
        """As topic_based_ros2_control from 0.2.0 on and joint_state_topic_hardware_interface: the values that
        there are, one after the other."""
        commands = self.joints.values()
        return JointState(
            name=list(self.joints),
            velocity=[command["velocity"] for command in commands if "velocity" in command],
            effort=[command["effort"] for command in commands if "effort" in command],
        )

    def padded(self):
        """As topic_based_ros2_control up to 0.1.1: a value for each joint, 0 where it has no such command."""
        commands = self.joints.values()
        return JointState(
            name=list(self.joints),
            position=[0.0 for _ in commands],
            velocity=[command.get("velocity", 0.0) for command in commands],
            effort=[command.get("effort", 0.0) for command in commands],
        )

    def commands(self):
        """Speed, drive torque and load torque in force."""
        last = self.applied[-1]
        return last.velocity[0], *last.effort


def test_the_block_commands_a_running_gearbox(ros_domain, process):
    start = ("operation.speed:=900.0", "operation.load_torque:=12.0", "pacing.real_time_factor:=0.2")
    gearbox = start_gearbox(process, *start)
    values = {"operation.speed": 900.0, "operation.load_torque": 12.0}
    block = ElementTree.fromstring(robot_description(Parameters.from_flat(values))).find("ros2_control")
    with Plugin(block) as plugin:
        plugin.until(lambda: plugin.states and plugin.applied)
        assert set(plugin.joints) == set(plugin.states[0].name)
        plugin.until(lambda: plugin.commander.get_subscription_count() > 0)
        # The first commands are the gearbox's own; each sign of another one comes with the load torque.
        plugin.joints["driven"]["effort"] = 13.0
        plugin.commander.publish(plugin.packed())
        plugin.until(lambda: plugin.commands()[2] == 13.0)
        assert plugin.commands() == (900.0, 30.0, 13.0)
        plugin.joints["driving"] = {"velocity": 880.0, "effort": 31.0}
        plugin.joints["driven"]["effort"] = 14.0
        plugin.commander.publish(plugin.padded())
        plugin.until(lambda: plugin.commands()[2] == 14.0)
        assert plugin.commands() == (880.0, 31.0, 14.0)
        assert "refused" not in gearbox.output
