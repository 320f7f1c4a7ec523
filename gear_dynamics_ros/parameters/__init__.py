"""What can be set: one tree of parameters for the node and all tools, in SI units. No ROS, no physics."""

from gear_dynamics_ros.parameters.changes import (
    ParameterChange,
    change_to,
    change_values,
    differences,
    updated,
)
from gear_dynamics_ros.parameters.tree import (
    NODE,
    Bearing,
    Gear,
    Gears,
    Operation,
    Pacing,
    Parameters,
    Specification,
    dump,
    load,
    parse,
    read_settings,
    reference,
    specifications,
)

__all__ = [
    "NODE",
    "Bearing",
    "Gear",
    "Gears",
    "Operation",
    "Pacing",
    "ParameterChange",
    "Parameters",
    "Specification",
    "change_to",
    "change_values",
    "differences",
    "dump",
    "load",
    "parse",
    "read_settings",
    "reference",
    "specifications",
    "updated",
]
