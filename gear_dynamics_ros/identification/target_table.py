"""Numbers that a gearbox should give, from a table in YAML, as data of a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.identification.unknowns import Unknown
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.hints import most_alike, shortened
from gear_dynamics_ros.parameters.mappings import require_mapping
from gear_dynamics_ros.parameters.rcl_yaml import parse_yaml
from gear_dynamics_ros.parameters.tree import specification_of

# Quantities of a motion by name, SI units; raises GearboxError where the run ends early.
Measure: TypeAlias = Callable[[Parameters], Mapping[str, float]]

# Quantities of a chaotic motion scatter: a smaller step would show the scatter and not the trend.
DIFFERENCE: Final = 5e-3
_TABLE_KEYS: Final = ("targets", "conditions", "transient", "keep", "windows")
_TARGET_KEYS: Final = ("quantity", "value", "scale", "conditions", "label")


class TargetValue(NamedTuple):
    """One number that the fit should meet."""

    label: str
    quantity: str  # as the measurement names it
    value: float  # SI
    scale: float  # SI, deviation that counts as 1
    conditions: Mapping[str, Any]  # parameters under which it holds, by dotted name


class Watch(NamedTuple):
    """How long a motion is watched, in periods of the mesh."""

    transient: int = 500  # left out first
    keep: int = 500  # measured
    windows: int = 1  # of ``keep`` periods; the median of their quantities counts


class TargetTable(NamedTuple):
    """Content of a table."""

    targets: tuple[TargetValue, ...]
    watch: Watch


def read_targets(path: Path) -> TargetTable:
    """The table in the YAML file ``path``.

    Raises UsageError, which begins with ``path``, if it can't be read, or has unknown, missing or invalid
    entries.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"{path}: it can't be read: {reason}") from None
    try:
        return _table(parse_yaml(text))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


class TargetObjective:
    """Measured minus wanted quantities, each divided by its scale."""

    difference = DIFFERENCE

    def __init__(self, table: TargetTable, measure: Measure, quantities: Collection[str]) -> None:
        """``quantities`` are the names that ``measure`` gives. Raises UsageError on a target of none."""
        for target in table.targets:
            if target.quantity not in quantities:
                meant = most_alike(target.quantity, quantities)
                hint = f"did you mean {meant}?" if meant else f"there are {', '.join(quantities)}"
                name = shortened(target.quantity)
                raise UsageError(f"{target.label}: there is no quantity {name}: {hint}")
        self._table = table
        self._measure = measure
        # Each motion is computed once, whatever the number of its targets.
        self._motions: list[tuple[Mapping[str, Any], list[int]]] = []
        for number, target in enumerate(table.targets):
            for conditions, numbers in self._motions:
                if conditions == target.conditions:
                    numbers.append(number)
                    break
            else:
                self._motions.append((target.conditions, [number]))

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self._table.targets)

    @property
    def stages(self) -> tuple[int, ...]:
        """One: all targets count at once."""
        return (self.count,)

    def require_fitting(self, base: Parameters, unknowns: Sequence[Unknown]) -> None:
        """Raise UsageError if a condition is varied, or not valid with ``base``."""
        varied = {entry.name for unknown in unknowns for entry in unknown.entries}
        for target in self._table.targets:
            for name in varied & target.conditions.keys():
                raise UsageError(f"{target.label}: its condition {name} is varied: remove it or the --vary")
            try:
                updated(base, target.conditions)
            except UsageError as error:
                raise UsageError(f"{target.label}: {error}") from None

    def residuals(self, parameters: Parameters) -> NDArray[np.float64]:
        """Residuals in the order of the table, shape (count,). Raises GearboxError if a run ends early."""
        residuals = np.empty(self.count)
        for conditions, numbers in self._motions:
            measured = self._measure(updated(parameters, conditions))
            for number in numbers:
                target = self._table.targets[number]
                found = float(measured[target.quantity])
                if not math.isfinite(found):
                    raise GearboxError(f"{target.label}: {target.quantity} is {found}")
                residuals[number] = (found - target.value) / target.scale
        return residuals

    def identity(self) -> dict[str, Any]:
        """The whole table."""
        targets = [
            {**target._asdict(), "conditions": dict(target.conditions)} for target in self._table.targets
        ]
        return {"targets": targets, "watch": self._table.watch._asdict()}

    def summary(self, residuals: NDArray[np.float64]) -> dict[str, Any]:
        """Of each target: what was wanted and what the fit gives."""
        return {
            "targets": [
                {
                    "label": target.label,
                    "quantity": target.quantity,
                    "conditions": dict(target.conditions),
                    "value": target.value,
                    "fitted": target.value + target.scale * float(residual),
                    "scale": target.scale,
                    "residual": float(residual),
                }
                for target, residual in zip(self._table.targets, residuals, strict=True)
            ]
        }

    def table(self, residuals: NDArray[np.float64]) -> tuple[list[str], list[list[object]]]:
        """A row for each target."""
        header = ["label", "quantity", "value", "fitted", "scale", "residual"]
        rows = self.summary(residuals)["targets"]
        return header, [[row[name] for name in header] for row in rows]


def _table(tree: object) -> TargetTable:
    table = require_mapping(tree, "the table", _TABLE_KEYS)
    shared = _conditions(table, "the table")
    entries = table.get("targets")
    if not isinstance(entries, list) or not entries:
        raise UsageError("targets must be a list with at least one entry that has quantity, value and scale")
    targets = tuple(_target(entry, f"targets[{number}]", shared) for number, entry in enumerate(entries))
    default = Watch()
    watch = Watch(
        _count(table, "transient", default.transient, least=0),
        _count(table, "keep", default.keep, least=1),
        _count(table, "windows", default.windows, least=1),
    )
    return TargetTable(targets, watch)


def _target(tree: object, where: str, shared: Mapping[str, Any]) -> TargetValue:
    entry = require_mapping(tree, where, _TARGET_KEYS)
    quantity = entry.get("quantity")
    if not isinstance(quantity, str) or not quantity:
        raise UsageError(f"{where} has no quantity: name one, such as quantity: ldmf")
    label = entry.get("label", f"{where} ({quantity})")
    if not isinstance(label, str):
        raise UsageError(f"{where}.label is {label!r}, must be text")
    value, scale = _number(entry, "value", where), _number(entry, "scale", where)
    if scale <= 0.0:
        raise UsageError(f"{where}.scale is {exact_text(scale)}, must be > 0: the deviation that counts as 1")
    return TargetValue(label, quantity, value, scale, {**shared, **_conditions(entry, where)})


def _conditions(tree: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    conditions = tree.get("conditions", {})
    if not isinstance(conditions, Mapping):
        raise UsageError(
            f"{where}.conditions is {conditions!r:.60}, must be a mapping of parameters to values"
        )
    for name in conditions:
        specification_of(name)
    return conditions


def _number(tree: Mapping[str, Any], key: str, where: str) -> float:
    value = tree.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{where}.{key} is {value!r:.60}, must be a finite number")
    return float(value)


def _count(tree: Mapping[str, Any], key: str, default: int, least: int) -> int:
    value = tree.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise UsageError(f"{key} is {value!r:.60}, must be a whole number >= {least}")
    return value
