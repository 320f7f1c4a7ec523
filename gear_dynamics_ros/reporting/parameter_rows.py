"""Parameters as rows of a table: value, unit, and the shipped default where it is another."""

from __future__ import annotations

from typing import Final, NamedTuple

from gear_dynamics_ros.parameters import Parameters, specifications
from gear_dynamics_ros.parameters.specification import Value, value_text
from gear_dynamics_ros.reporting.rendering import quantity

SWITCHES: Final = ("model", "mesh_geometry", "mesh_damping", "restitution_law", "mesh_phase")
KEY_GROUPS: Final = ("gears", "mesh", "surface", "bearings", "oil", "operation", "solver")
DIGITS: Final = 6


class ParameterRow(NamedTuple):
    """One parameter: its value, and the default if that is another."""

    name: str
    value: str
    unit: str
    default: str  # empty if it has this value


def switch_rows(parameters: Parameters) -> list[ParameterRow]:
    """The switches of the model."""
    return [row for row in _rows(parameters) if row.name in SWITCHES]


def changed_rows(parameters: Parameters) -> list[ParameterRow]:
    """The parameters that differ from the shipped defaults."""
    return [row for row in _rows(parameters) if row.default]


def key_rows(parameters: Parameters) -> list[ParameterRow]:
    """The parameters of the machine, its operation and the solver."""
    return [row for row in _rows(parameters) if row.name.split(".")[0] in KEY_GROUPS]


def _rows(parameters: Parameters) -> list[ParameterRow]:
    rows = []
    for name, value in parameters.to_flat().items():
        row = specifications()[name]
        text, unit = _shown(value, row.unit)
        default = "" if value == row.default else " ".join(_shown(row.default, row.unit)).rstrip()
        rows.append(ParameterRow(name, text, unit, default))
    return rows


def _shown(value: Value, unit: str) -> tuple[str, str]:
    """Text and unit of a value."""
    if isinstance(value, float):
        return quantity(value, unit, DIGITS)
    return (value_text(value) if not isinstance(value, str) else value or '""'), unit
