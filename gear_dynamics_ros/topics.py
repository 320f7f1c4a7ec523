"""The table of topics: name, message type, content and quality of service."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple


class Topic(NamedTuple):
    """One topic of the node: its name, message type, content and quality of service."""

    name: str  # "~/..." below the node, "/..." absolute, else in the node's namespace
    type: str
    content: str
    reliable: bool = True
    depth: int = 10  # messages kept for a slow subscriber
    latched: bool = False  # late subscribers receive the last messages too


FLOAT64 = "std_msgs/msg/Float64"
INT8 = "std_msgs/msg/Int8"
STRING = "std_msgs/msg/String"
JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
ARRAY = "std_msgs/msg/Float64MultiArray"
CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

# A subscriber that stalls for a second at the default 500 Hz still gets every chunk of the waveform.
WAVEFORM_DEPTH = 500
# A burst of commands must not displace a command that another publisher sent just before.
COMMAND_DEPTH = 100

TOPICS: Final[dict[str, Topic]] = {
    "drive_torque_command": Topic(
        "~/command/drive_torque", FLOAT64, "drive torque to apply, N m", depth=COMMAND_DEPTH
    ),
    "load_torque_command": Topic(
        "~/command/load_torque", FLOAT64, "load torque to apply, N m", depth=COMMAND_DEPTH
    ),
    "speed_command": Topic("~/command/speed", FLOAT64, "speed set-point, rad/s", depth=COMMAND_DEPTH),
    "joint_command": Topic(
        "~/command/joint",
        JOINT_STATE,
        "driving: velocity = set-point rad/s, effort = drive torque N m; driven: effort = load torque N m",
        depth=COMMAND_DEPTH,
    ),
    "joint_states": Topic(
        "joint_states",
        JOINT_STATE,
        "driving, driven (rad, rad/s, N m) and mesh (DTE m, its rate m/s, mesh force N)",
    ),
    "dte": Topic("~/dte", FLOAT64, "dynamic transmission error, m"),
    "mesh_force": Topic("~/mesh_force", FLOAT64, "force along the line of action, N"),
    "pressure_angle": Topic("~/pressure_angle", FLOAT64, "working pressure angle, rad"),
    "driving_bearing_force": Topic(
        "~/bearing_force/driving", WRENCH, "contact and film force on the driving gear, N"
    ),
    "driven_bearing_force": Topic(
        "~/bearing_force/driven", WRENCH, "contact and film force on the driven gear, N"
    ),
    "waveform": Topic(
        "~/waveform", ARRAY, "every sample of the chunk, a row each; SI units", depth=WAVEFORM_DEPTH
    ),
    "energy": Topic("~/energy", ARRAY, "works and losses since the start or the last reset, and stored, J"),
    "impacts": Topic(
        "~/impacts",
        ARRAY,
        "a row for each bearing contact that ended in the chunk, nothing where none did; SI units",
        depth=WAVEFORM_DEPTH,
    ),
    "meshing_state": Topic("~/meshing_state", INT8, "1 drive flank, 0 apart, -1 back flank"),
    "diagnostics": Topic("/diagnostics", DIAGNOSTICS, "health of engine and sinks"),
    "pacing": Topic("~/pacing", ARRAY, "once a second: real-time factor reached, overruns, lateness, slip"),
    "clock": Topic("/clock", CLOCK, "simulated time", reliable=False, depth=1),
    "applied_command": Topic(
        "~/command/applied",
        JOINT_STATE,
        "commands in force, stamped at the sample where they take effect; laid out like ~/command/joint",
        depth=1,
        latched=True,
    ),
    "model_info": Topic(
        "~/model_info",
        STRING,
        "JSON: version, hashes, parameters in force, columns and units, joints, frames, epoch of stamps",
        depth=1,
        latched=True,
    ),
    "event": Topic(
        "~/event",
        STRING,
        "JSON: sample, time (s), event, message, counters; parameters, checkpoint, commands of its kind",
        latched=True,
    ),
}

# Topics with one command each, and its field of Commands; then the topic that can have all commands.
FLOAT_COMMANDS: Final = {
    "drive_torque_command": "drive_torque",
    "load_torque_command": "load_torque",
    "speed_command": "speed",
}
JOINT_COMMAND: Final = "joint_command"
COMMAND_TOPICS: Final = (*FLOAT_COMMANDS, JOINT_COMMAND)
# Messages that a chunk makes, in this order; impacts only if some ended, the clock at its rate.
CHUNK_TOPICS: Final = (
    "joint_states",
    "dte",
    "mesh_force",
    "pressure_angle",
    "driving_bearing_force",
    "driven_bearing_force",
    "meshing_state",
    "energy",
    "impacts",
    "clock",
    "waveform",
)


def is_rows(topic: str) -> bool:
    """Whether the messages of the topic (key in TOPICS) have rows of numbers, as the waveform."""
    return TOPICS[topic].type == ARRAY


def full_topic_name(topic: Topic, node: str = "/gearbox") -> str:
    """Full name of a topic for the node with the full name ``node``."""
    if topic.name.startswith("~/"):
        return f"{node}/{topic.name[2:]}"
    if topic.name.startswith("/"):
        return topic.name
    return f"{node.rpartition('/')[0]}/{topic.name}"


class NodeNames(NamedTuple):
    """Full names of a node and, where ROS remapped them, of its topics, by key in TOPICS."""

    node: str = "/gearbox"
    remapped: Mapping[str, str] = MappingProxyType({})

    def topic(self, key: str) -> str:
        """Full name of a topic (key in TOPICS)."""
        return self.remapped.get(key) or full_topic_name(TOPICS[key], self.node)


DEFAULT_NAMES: Final = NodeNames()
