"""What can be set: one tree of parameters for the node and all tools, in SI units. No ROS, no physics."""

from gear_dynamics_ros.parameters.bounds import command_bounds
from gear_dynamics_ros.parameters.changes import (
    ParameterChange,
    change_to,
    change_values,
    differences,
    updated,
)
from gear_dynamics_ros.parameters.checks import MOST_WAVES_PER_REVOLUTION
from gear_dynamics_ros.parameters.groups import (
    BearingParameters,
    GearPairParameters,
    GearParameters,
    OperationParameters,
    PacingParameters,
)
from gear_dynamics_ros.parameters.markdown_page import parameters_page
from gear_dynamics_ros.parameters.ros_file import (
    GEARBOX_NODE_NAME,
    dump_parameters,
    load_parameters,
    parse_parameters,
    read_settings,
)
from gear_dynamics_ros.parameters.specification import Specification
from gear_dynamics_ros.parameters.tree import (
    Parameters,
    specifications,
)

__all__ = [
    "GEARBOX_NODE_NAME",
    "MOST_WAVES_PER_REVOLUTION",
    "BearingParameters",
    "GearPairParameters",
    "GearParameters",
    "OperationParameters",
    "PacingParameters",
    "ParameterChange",
    "Parameters",
    "Specification",
    "change_to",
    "change_values",
    "command_bounds",
    "differences",
    "dump_parameters",
    "load_parameters",
    "parameters_page",
    "parse_parameters",
    "read_settings",
    "specifications",
    "updated",
]
