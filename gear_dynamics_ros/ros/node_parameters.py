"""Declares the table of parameters as ROS parameters with type, range, unit and description."""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from typing import Any, cast

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import (
    ParameterChange,
    Parameters,
    Specification,
    change_values,
    differences,
    specifications,
)
from gear_dynamics_ros.parameters.rcl_yaml import parse_yaml, resolve_scalar
from gear_dynamics_ros.parameters.tree import ROS_OWN_PARAMETERS, unknown_parameter

LARGEST_INTEGER = 2**63 - 1


def declare(node: Node) -> Parameters:
    """Check the parameters of ``node`` from file and command line, and declare every parameter of the table.

    ``node`` must declare its overrides automatically. Raises UsageError as ``Parameters.from_flat`` does.
    """
    overrides = cast("dict[str, Parameter]", node.get_parameters_by_prefix(""))
    given = {
        name: _plain(parameter.value)
        for name, parameter in overrides.items()
        if not ROS_OWN_PARAMETERS.fullmatch(name)
    }
    parameters = Parameters.from_flat(given)
    for name in given:
        # Declared again below with the type of the table: an integer may have been given for a float.
        node.undeclare_parameter(name)
    rows = specifications()
    node.declare_parameters(
        "",
        [(name, _listed(value), _descriptor(rows[name])) for name, value in parameters.to_flat().items()],
        ignore_override=True,
    )
    return parameters


class UnknownParameterError(ParameterNotDeclaredException):
    """A parameter that the node does not have; rclpy's own error can lose its name."""

    def __init__(self, name: str) -> None:
        Exception.__init__(self, unknown_parameter(name))


def require_known(node: Node, parameters: Sequence[Parameter]) -> None:
    """Raise UnknownParameterError, which the services of rclpy answer with, if ``node`` lacks a parameter."""
    for parameter in parameters:
        if not node.has_parameter(parameter.name):
            raise UnknownParameterError(parameter.name)


def numbers_to_floats(parameters: list[Parameter]) -> list[Parameter]:
    """``parameters``, about to be set, with other spellings of a number converted to the float required.

    These are integers, and texts such as 5e-2 or [0, 5e-2], which the tools of ROS do not read as numbers.
    """
    floats = {name for name, row in specifications().items() if row.element is float}
    return [_floated(parameter) if parameter.name in floats else parameter for parameter in parameters]


def _floated(parameter: Parameter) -> Parameter:
    value = _read(parameter)
    if isinstance(value, list) and value and all(map(_is_number, value)):
        return Parameter(parameter.name, value=[float(entry) for entry in value])
    if _is_number(value):
        return Parameter(parameter.name, value=float(value))
    return parameter


def _read(parameter: Parameter) -> Any:
    """Value of ``parameter``; texts, and a text of a list, as rcl would read them."""
    value: Any = parameter.value
    if parameter.type_ == Parameter.Type.STRING_ARRAY:
        return [resolve_scalar(entry) for entry in value]
    if parameter.type_ == Parameter.Type.STRING and value.startswith("["):
        try:
            return parse_yaml(value)
        except UsageError:
            return value
    return resolve_scalar(value) if parameter.type_ == Parameter.Type.STRING else _listed(_plain(value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def change_by(parameters: Parameters, given: Sequence[Parameter]) -> ParameterChange:
    """Change of ``parameters`` by ``given`` ROS parameters. Raises UsageError as ``change_values``."""
    rows = specifications()
    values = {parameter.name: _plain(parameter.value) for parameter in given if parameter.name in rows}
    return change_values(parameters, values)


def to_set(old: Parameters, new: Parameters) -> list[Parameter]:
    """ROS parameters to set on a node with ``old`` so that it has ``new``."""
    return [Parameter(name, value=_listed(value)) for name, value in differences(old, new).items()]


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list | array) else value


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _descriptor(row: Specification) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=f"{row.help} [{row.unit}]" if row.unit else row.help,
        additional_constraints=row.limits,
        read_only=not row.runtime,
    )
    if row.type is float and _bounded(row):
        lowest = -sys.float_info.max if row.minimum is None else row.minimum
        highest = sys.float_info.max if row.maximum is None else row.maximum
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=math.nextafter(lowest, math.inf) if row.exclusive_minimum else lowest,
                to_value=math.nextafter(highest, -math.inf) if row.exclusive_maximum else highest,
            )
        ]
    if row.type is int and _bounded(row):
        descriptor.integer_range = [
            IntegerRange(
                from_value=-LARGEST_INTEGER if row.minimum is None else int(row.minimum),
                to_value=LARGEST_INTEGER if row.maximum is None else int(row.maximum),
            )
        ]
    return descriptor


def _bounded(row: Specification) -> bool:
    return row.minimum is not None or row.maximum is not None
