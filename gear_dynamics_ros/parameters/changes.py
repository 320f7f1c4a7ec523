"""Changes of parameters: what differs, whether it may change at run time, and what results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.specification import Value, value_text
from gear_dynamics_ros.parameters.tree import Parameters, specifications


class ParameterChange(NamedTuple):
    """A valid change at run time: made once, by ``change_to`` or ``change_values``, and then only applied."""

    old: Parameters
    new: Parameters
    values: Mapping[str, Value]  # of ``new``, by dotted name, those that differ


def differences(old: Parameters, new: Parameters) -> dict[str, Value]:
    """Values of ``new`` that are not those of ``old``, by dotted name."""
    before = old.to_flat()
    return {name: value for name, value in new.to_flat().items() if value != before[name]}


def updated(parameters: Parameters, values: Mapping[str, object]) -> Parameters:
    """``parameters`` with ``values`` by dotted name. Raises UsageError as ``Parameters.from_flat`` does."""
    return Parameters.from_flat({**parameters.to_flat(), **values})


def change_values(old: Parameters, values: Mapping[str, object]) -> ParameterChange:
    """The change of ``old`` by ``values``, by dotted name.

    Raises UsageError if the values are invalid together, or one differs that is fixed at run time.
    """
    return change_to(old, updated(old, values))


def change_to(old: Parameters, new: Parameters) -> ParameterChange:
    """The change from ``old`` to ``new``. Raises UsageError where one differs that is fixed at run time."""
    before, values = old.to_flat(), differences(old, new)
    for name, value in values.items():
        if not specifications()[name].runtime:
            raise UsageError(
                f"{name} = {value_text(before[name])} is fixed while the gearbox runs: "
                f"start it again with {name} = {value_text(value)}"
            )
    # A -0.0 for a 0.0 counts as no difference, and must make none to the bits either.
    return ParameterChange(old, updated(old, values), values)
