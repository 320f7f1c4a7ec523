"""The gearbox as URDF text.

Axes are the model's: x from the driving to the driven gear, z along the shafts; the root link stands at the
nominal centre of the driving gear. Shafts turn in their nominal centres: the displacements in the bearings
are some ten micrometres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree import ElementTree as Xml

from gear_dynamics_ros.messages.encoder import bearing_frame
from gear_dynamics_ros.parameters import GEARBOX_NODE_NAME, Parameters, specifications
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.topics import TOPICS, full_topic_name

# Plugins of ros2_control that command by topic: the default, and its predecessor, with the same parameters.
HARDWARE_PLUGINS = (
    "joint_state_topic_hardware_interface/JointStateTopicSystem",
    "topic_based_ros2_control/TopicBasedSystem",
)
STATE_INTERFACES = ("position", "velocity", "effort")
GEAR_RGBA = {"driving": "0.30 0.45 0.69 1", "driven": "0.87 0.52 0.32 1"}
AXIS_UP, AXIS_DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
Vector = tuple[float, float, float]


def robot_description(
    parameters: Parameters, node: str = GEARBOX_NODE_NAME, plugin: str = HARDWARE_PLUGINS[0]
) -> str:
    """URDF text, with a ros2_control block, of the gearbox of the node with the full name ``node``.

    ``plugin`` (of HARDWARE_PLUGINS) is the one that ros2_control loads.

    The joints are those of the topic ``joint_states``; each bearing's link is the frame of its
    ``bearing_force``. A gear is a cylinder of its pitch diameter and of its bearing's length, because the
    model has no face width.
    """
    prefix = parameters.joint_prefix
    root = f"{prefix}gearbox"
    robot = Xml.Element("robot", name=root)
    Xml.SubElement(robot, "link", name=root)
    distance = sum(pitch_radii(parameters))
    _add_gear(robot, parameters, "driving", (0.0, 0.0, 0.0), AXIS_UP)
    # The driven gear turns clockwise where its speed is positive.
    _add_gear(robot, parameters, "driven", (distance, 0.0, 0.0), AXIS_DOWN)
    _add_mesh(robot, parameters)
    _add_control(robot, parameters, node, plugin)
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
    # A disc: about a diameter half the polar moment of inertia, plus the term of its length.
    across = 0.5 * gear.inertia + gear.mass * length**2 / 12.0
    moments = {"ixx": across, "ixy": 0.0, "ixz": 0.0, "iyy": across, "iyz": 0.0, "izz": gear.inertia}
    Xml.SubElement(inertial, "inertia", {key: _text(value) for key, value in moments.items()})
    visual = Xml.SubElement(link, "visual")
    cylinder = {"radius": _text(radius), "length": _text(length)}
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "cylinder", cylinder)
    material = Xml.SubElement(visual, "material", name=name)
    Xml.SubElement(material, "color", rgba=GEAR_RGBA[side])

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
    # The direction in which the driving teeth press the driven ones at positive mesh force.
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


def _add_control(robot: Xml.Element, parameters: Parameters, node: str, plugin: str) -> None:
    prefix, operation = parameters.joint_prefix, parameters.operation
    system = Xml.SubElement(robot, "ros2_control", name=f"{prefix}gearbox", type="system")
    hardware = Xml.SubElement(system, "hardware")
    Xml.SubElement(hardware, "plugin").text = plugin
    settings = {
        "joint_commands_topic": full_topic_name(TOPICS["joint_command"], node),
        "joint_states_topic": full_topic_name(TOPICS["joint_states"], node),
        # Always send: older plugins compare positions only, and would not send new speeds and torques.
        "trigger_joint_command_threshold": "-1",
    }
    for name, value in settings.items():
        Xml.SubElement(hardware, "param", name=name).text = value
    # Initial commands are those of the parameters, because the plugin sends all of them, used or not. Its
    # older versions list values without gaps, so that joints with more commands must come first.
    _add_interfaces(
        system, f"{prefix}driving", {"velocity": operation.speed, "effort": operation.drive_torque}
    )
    _add_interfaces(system, f"{prefix}driven", {"effort": operation.load_torque})
    _add_interfaces(system, f"{prefix}mesh", {})


def _add_interfaces(system: Xml.Element, name: str, commands: Mapping[str, float]) -> None:
    joint = Xml.SubElement(system, "joint", name=name)
    for kind, names in (("command_interface", tuple(commands)), ("state_interface", STATE_INTERFACES)):
        for interface in names:
            element = Xml.SubElement(joint, kind, name=interface)
            # Some versions read it from the command interface, others from the state interface.
            if interface in commands:
                Xml.SubElement(element, "param", name="initial_value").text = _text(commands[interface])


def _text(*values: float) -> str:
    """Numbers with 12 digits: the last digits of a double differ between mathematical libraries."""
    return " ".join(f"{value:.12g}" for value in values)
