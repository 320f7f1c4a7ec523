"""What a sweep computes: models, axes and directions, as points and the branches that they form."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, specifications
from gear_dynamics_ros.parameters.entries import Entry, with_entries
from gear_dynamics_ros.simulation.orbit import SAMPLES_PER_PERIOD
from gear_dynamics_ros.sweeps.axis import Axis, AxisValue
from gear_dynamics_ros.sweeps.point import Measurement

MOST_POINTS: Final = 1_000_000
MOST_PERIODS: Final = 10_000_000
DIRECTIONS: Final = {
    "independent": ("independent",),
    "up": ("up",),
    "down": ("down",),
    "both": ("up", "down"),
}

Index = tuple[int, ...]  # of a point: model, way, and the value on each axis


class Branch(NamedTuple):
    """Points that are computed one after the other; each but the first starts in the state of that before."""

    points: tuple[Index, ...]


@dataclass(frozen=True)
class SweepPlan:
    """Everything that decides the numbers of a sweep.

    Raises UsageError if it has no axis, one twice, too many points, or can't be swept as it says.
    """

    parameters: Parameters
    axes: tuple[Axis, ...]
    models: tuple[str, ...]
    measurement: Measurement
    direction: str = "independent"  # of DIRECTIONS: along the first axis

    def __post_init__(self) -> None:
        _require_axes(self.axes)
        _require_models(self.models)
        _require_measurement(self.measurement)
        if self.direction not in DIRECTIONS:
            raise UsageError(f"direction {self.direction!r} must be one of {', '.join(DIRECTIONS)}")
        if self.size > MOST_POINTS:
            raise UsageError(f"the sweep has {self.size} points, more than {MOST_POINTS}: give fewer values")
        first = self.axes[0]
        if self.direction != "independent" and not (first.targets and _is_numeric(first)):
            raise UsageError(
                f"{first.name} can't be swept {self.direction}, with carried state: "
                "give a parameter with numbers as the first axis, or sweep independently"
            )

    @property
    def ways(self) -> tuple[str, ...]:
        """Directions of travel, one or two."""
        return DIRECTIONS[self.direction]

    @property
    def shape(self) -> Index:
        """Number of models, of ways, and of values on each axis."""
        return (len(self.models), len(self.ways), *(len(axis.values) for axis in self.axes))

    @property
    def size(self) -> int:
        """Number of points."""
        size = 1
        for length in self.shape:
            size *= length
        return size

    def points(self) -> Iterator[Index]:
        """All points, the last axis fastest."""
        return itertools.product(*map(range, self.shape))

    def branches(self) -> list[Branch]:
        """All branches, which can be computed in any order."""
        if self.direction == "independent":
            return [Branch((point,)) for point in self.points()]
        _, _, length, *others = self.shape
        return [
            Branch(tuple((model, way, value, *rest) for value in _travel(self.axes[0], name, length)))
            for model in range(len(self.models))
            for way, name in enumerate(self.ways)
            for rest in itertools.product(*map(range, others))
        ]

    def settings(self, point: Index) -> dict[str, AxisValue]:
        """Value on each axis at ``point``, SI, by the axis' name."""
        return {axis.name: axis.values[i] for axis, i in zip(self.axes, point[2:], strict=True)}

    def parameters_at(self, point: Index) -> Parameters:
        """Parameters at ``point``. Raises UsageError if they don't fit together."""
        values: dict[Entry, Any] = {Entry("model", None): self.models[point[0]]}
        for axis, i in zip(self.axes, point[2:], strict=True):
            for target in axis.targets:
                target.value(self.parameters)  # an entry that the list does not have can't be set
                values[target] = axis.values[i]
        return with_entries(self.parameters, values)

    def to_json(self) -> str:
        """The plan as text, by which a folder of results is recognised."""
        return json.dumps(
            {
                "models": self.models,
                "direction": self.direction,
                "axes": {axis.name: axis.values for axis in self.axes},
                "measurement": self.measurement._asdict(),
                "parameters": self.parameters.to_flat(),
            },
            indent=1,
        )


def _travel(axis: Axis, way: str, length: int) -> Sequence[int]:
    """Indices into the values of ``axis`` in the order of travel ``way``: rising, or falling."""
    values: Any = axis.values
    return sorted(range(length), key=lambda i: values[i], reverse=way == "down")


def _is_numeric(axis: Axis) -> bool:
    return not any(isinstance(value, str) for value in axis.values)


def _require_axes(axes: Sequence[Axis]) -> None:
    if not axes:
        raise UsageError("a sweep needs at least one range: give --over NAME=START:STOP:COUNT")
    seen: dict[str, str] = {}
    for axis in axes:
        for name in [str(target) for target in axis.targets] or [axis.name]:
            if name in seen:
                raise UsageError(f"{axis.name} and {seen[name]} set the same parameter: give it once")
            seen[name] = axis.name
            if name == "model":
                raise UsageError("model can't be an axis: give --models")


def _require_models(models: Sequence[str]) -> None:
    choices = specifications()["model"].choices
    for model in models:
        if model not in choices:
            raise UsageError(f"model {model!r} must be one of {', '.join(choices)}")
    if not models or len(set(models)) < len(models):
        raise UsageError(f"models {', '.join(models) or 'none'}: give each of them once")


def _require_measurement(measurement: Measurement) -> None:
    limits: Mapping[str, int] = {"transient": 0, "keep": 1}
    for name, least in limits.items():
        value = getattr(measurement, name)
        if not least <= value <= MOST_PERIODS:
            raise UsageError(f"{name} = {value} periods of the mesh: must be {least} to {MOST_PERIODS}")
    steps = measurement.steps_per_period
    if not SAMPLES_PER_PERIOD <= steps <= 100_000 or steps % SAMPLES_PER_PERIOD:
        raise UsageError(
            f"steps = {steps} per period of the mesh: must be a multiple of {SAMPLES_PER_PERIOD} up to 100000"
        )
