"""One row of the table of parameters: type, default, unit, bounds and help of one parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any, NamedTuple, TypeAlias

from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.rcl_yaml import scalar_text

Value: TypeAlias = bool | int | float | str | tuple[float, ...] | tuple[str, ...]


class Specification(NamedTuple):
    """One row of the table of parameters. Bounds are inclusive unless marked as exclusive; None: no bound."""

    name: str  # dotted
    element: type[Any]  # type of the entries of a tuple, otherwise the same as ``type``
    type: type[Any]  # bool, int, float, str or tuple
    default: Value
    unit: str
    help: str
    minimum: float | None
    maximum: float | None
    exclusive_minimum: bool
    exclusive_maximum: bool
    choices: tuple[str, ...]  # empty: any text
    length: tuple[int, int] | None  # least and greatest number of entries of a tuple
    runtime: bool  # can change while the gearbox runs

    @property
    def limits(self) -> str:
        """What a value, or each entry of a list, may be, in words; empty if the type is the only limit."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        bounds = []
        if self.minimum is not None:
            bounds.append(f"{'>' if self.exclusive_minimum else '>='} {exact_text(self.minimum)}")
        if self.maximum is not None:
            bounds.append(f"{'<' if self.exclusive_maximum else '<='} {exact_text(self.maximum)}")
        return " and ".join(bounds)


def parameter(
    default: Value,
    help: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    exclusive_minimum: bool = False,
    exclusive_maximum: bool = False,
    choices: Sequence[str] = (),
    length: tuple[int, int] | None = None,
    runtime: bool = False,
) -> Any:
    """A dataclass field that declares one parameter: its default and its row of the table.

    The name in the row stays empty: it depends on the groups that contain the field.
    """
    kind = type(default)
    row = Specification(
        name="",
        type=kind,
        element=type(default[0]) if isinstance(default, tuple) else kind,
        default=default,
        unit=unit,
        help=help,
        minimum=minimum,
        maximum=maximum,
        exclusive_minimum=exclusive_minimum,
        exclusive_maximum=exclusive_maximum,
        choices=tuple(choices),
        length=length,
        runtime=runtime,
    )
    return field(default=default, metadata={"specification": row})


def value_text(value: Value) -> str:
    """A value as text, in error messages and parameter files; YAML reads it back to the same value."""
    if isinstance(value, tuple):
        return "[" + ", ".join(scalar_text(entry) for entry in value) + "]"
    return scalar_text(value)
