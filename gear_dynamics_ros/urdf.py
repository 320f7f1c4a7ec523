"""URDF of the gearbox for robot_state_publisher and ros2_control: ``python -m gear_dynamics_ros.urdf``.

Axes are the model's: x from the driving to the driven gear, z along the shafts; the root link stands at the
nominal centre of the driving gear. Shafts turn in their nominal centres: the displacements in the bearings
are some ten micrometres.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

from gear_dynamics_ros.cli.common import add_settings, guarded
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.messages import bearing_frame
from gear_dynamics_ros.parameters import NODE, Parameters, load, specifications
from gear_dynamics_ros.physics.constants import base_radii
from gear_dynamics_ros.resources import share_file
from gear_dynamics_ros.topics import TOPICS, resolve

PLUGIN = "topic_based_ros2_control/TopicBasedSystem"
INTERFACES = ("position", "velocity", "effort")
COLOURS = {"driving": "0.30 0.45 0.69 1", "driven": "0.87 0.52 0.32 1"}
UPWARD, DOWNWARD = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
Vector = tuple[float, float, float]


def urdf(parameters: Parameters, node: str = NODE) -> str:
    """URDF, with a ros2_control block, of the gearbox that the node with the full name ``node`` runs.

    Joints are those of ``joint_states``; each bearing's link is the frame of its ``bearing_force``. A gear is
    a cylinder of its pitch diameter, as long as its bearing, for the model knows no face width.
    """
    prefix = parameters.joint_prefix
    root = f"{prefix}gearbox"
    robot = Xml.Element("robot", name=root)
    Xml.SubElement(robot, "link", name=root)
    distance = sum(pitch_radii(parameters))
    _add_gear(robot, parameters, "driving", (0.0, 0.0, 0.0), UPWARD)
    # The driven gear turns clockwise where its speed is positive.
    _add_gear(robot, parameters, "driven", (distance, 0.0, 0.0), DOWNWARD)
    _add_mesh(robot, parameters)
    _add_control(robot, parameters, node)
    Xml.indent(robot)
    return f'<?xml version="1.0"?>\n{Xml.tostring(robot, encoding="unicode")}\n'


def pitch_radii(parameters: Parameters) -> tuple[float, float]:
    """Pitch radii of driving and driven gear, m."""
    gears = parameters.gears
    return 0.5 * gears.module * gears.driving.teeth, 0.5 * gears.module * gears.driven.teeth


def _add_gear(robot: Xml.Element, parameters: Parameters, side: str, centre: Vector, axis: Vector) -> None:
    prefix = parameters.joint_prefix
    gear = getattr(parameters.gears, side)
    length = getattr(parameters.bearings, side).length
    radius = dict(zip(("driving", "driven"), pitch_radii(parameters), strict=True))[side]
    bearing, name = bearing_frame(prefix, side), f"{prefix}{side}_gear"

    Xml.SubElement(robot, "link", name=bearing)
    _add_joint(robot, "fixed", f"{prefix}{side}_seat", f"{prefix}gearbox", bearing, centre)

    link = Xml.SubElement(robot, "link", name=name)
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "mass", value=_text(gear.mass))
    # A disc: half of the polar inertia about a diameter, and the share of its length.
    across = 0.5 * gear.inertia + gear.mass * length**2 / 12.0
    moments = {"ixx": across, "ixy": 0.0, "ixz": 0.0, "iyy": across, "iyz": 0.0, "izz": gear.inertia}
    Xml.SubElement(inertial, "inertia", {key: _text(value) for key, value in moments.items()})
    visual = Xml.SubElement(link, "visual")
    cylinder = {"radius": _text(radius), "length": _text(length)}
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "cylinder", cylinder)
    material = Xml.SubElement(visual, "material", name=name)
    Xml.SubElement(material, "color", rgba=COLOURS[side])

    joint = _add_joint(robot, "continuous", f"{prefix}{side}", bearing, name, (0.0, 0.0, 0.0))
    Xml.SubElement(joint, "axis", xyz=_text(*axis))
    torque = specifications()["operation.drive_torque"].maximum
    speed = parameters.operation.speed_limit
    Xml.SubElement(
        joint, "limit", effort=_text(math.inf if torque is None else torque), velocity=_text(speed)
    )


def _add_mesh(robot: Xml.Element, parameters: Parameters) -> None:
    prefix = parameters.joint_prefix
    gears = parameters.gears
    contact = f"{prefix}mesh_contact"
    Xml.SubElement(robot, "link", name=contact)
    pitch_point = (pitch_radii(parameters)[0], 0.0, 0.0)
    joint = _add_joint(robot, "prismatic", f"{prefix}mesh", f"{prefix}gearbox", contact, pitch_point)
    # Where the driving gear's teeth press the driven one's at positive mesh force.
    along = (math.sin(gears.pressure_angle), math.cos(gears.pressure_angle), 0.0)
    Xml.SubElement(joint, "axis", xyz=_text(*along))
    limits = {
        "lower": -gears.module,
        "upper": gears.module,
        "effort": parameters.mesh.stiffness * gears.module,
        "velocity": parameters.operation.speed_limit * sum(base_radii(parameters)),
    }
    Xml.SubElement(joint, "limit", {key: _text(value) for key, value in limits.items()})


def _add_joint(
    robot: Xml.Element, kind: str, name: str, parent: str, child: str, origin: Vector
) -> Xml.Element:
    joint = Xml.SubElement(robot, "joint", name=name, type=kind)
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    Xml.SubElement(joint, "origin", xyz=_text(*origin), rpy="0 0 0")
    return joint


def _add_control(robot: Xml.Element, parameters: Parameters, node: str) -> None:
    prefix, operation = parameters.joint_prefix, parameters.operation
    system = Xml.SubElement(robot, "ros2_control", name=f"{prefix}gearbox", type="system")
    hardware = Xml.SubElement(system, "hardware")
    Xml.SubElement(hardware, "plugin").text = PLUGIN
    settings = {
        "joint_commands_topic": resolve(TOPICS["joint_command"], node),
        "joint_states_topic": resolve(TOPICS["joint_states"], node),
        # Send always: older plugins compare positions only, and would hold back new speeds and torques.
        "trigger_joint_command_threshold": "-1",
    }
    for name, value in settings.items():
        Xml.SubElement(hardware, "param", name=name).text = value
    # Commands start as the gearbox starts: the plugin sends all of them, used or not. Its older versions
    # list values without gaps, so that joints with more commands must come first.
    _add_interfaces(
        system, f"{prefix}driving", {"velocity": operation.speed, "effort": operation.drive_torque}
    )
    _add_interfaces(system, f"{prefix}driven", {"effort": operation.load_torque})
    _add_interfaces(system, f"{prefix}mesh", {})


def _add_interfaces(system: Xml.Element, name: str, commands: Mapping[str, float]) -> None:
    joint = Xml.SubElement(system, "joint", name=name)
    for kind, names in (("command_interface", tuple(commands)), ("state_interface", INTERFACES)):
        for interface in names:
            element = Xml.SubElement(joint, kind, name=interface)
            # Which of the two a version takes its first command from differs.
            if interface in commands:
                Xml.SubElement(element, "param", name="initial_value").text = _text(commands[interface])


def _text(*values: float) -> str:
    """Numbers with fewer digits than differ between mathematical libraries."""
    return " ".join(f"{value:.12g}" for value in values)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the URDF; returns the exit code."""
    parser = argparse.ArgumentParser(prog="urdf", description="Print the URDF of a gearbox.")
    parser.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    add_settings(parser)
    parser.add_argument(
        "--node", default=NODE, metavar="NAME", help="full name of the gearbox (default: %(default)s)"
    )
    return guarded(_print, parser, argv)


def _print(arguments: argparse.Namespace) -> int:
    if not arguments.node.startswith("/") or arguments.node.endswith("/"):
        raise UsageError(f"--node is {arguments.node!r}, no full name of a node: give one like {NODE}")
    parameters = load(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)
    print(urdf(parameters, arguments.node), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
