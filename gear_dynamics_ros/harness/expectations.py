"""What a channel is expected to show within a window of the profile."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from gear_dynamics_ros.channels import CHANNELS, ENERGIES
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness import fields
from gear_dynamics_ros.harness.measures import (
    DIRECTIONS,
    FLANK_STATES,
    STATISTICS,
    Measure,
    Monotone,
    Settling,
    Share,
    Statistic,
)

UNITS: Mapping[str, str] = {channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)}

_COMMON_KEYS = ("name", "from", "to")
_LIMIT_KEYS = ("minimum", "maximum", "target", "tolerance")
_MEASURE_KEYS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys((*STATISTICS, "share"), _LIMIT_KEYS),
    "settling": ("target", "tolerance", "within"),
    "monotone": ("direction", "tolerance"),
}
_KEYS = tuple(dict.fromkeys((*_COMMON_KEYS, *_MEASURE_KEYS, *_LIMIT_KEYS, "within", "direction")))


@dataclass(frozen=True, slots=True)
class Expectation:
    """A measure of one channel over the samples with start <= time < end lies within [minimum, maximum].

    Times in s; ``unit`` is that of the measure and of both limits.
    """

    name: str
    measure: Measure
    channel: str
    start: float
    end: float
    minimum: float
    maximum: float

    @property
    def unit(self) -> str:
        """Unit of what is measured, empty without."""
        return self.measure.unit(UNITS[self.channel])

    def describe(self) -> str:
        """Measure and channel in words."""
        return self.measure.describe(self.channel)

    def window(self) -> str:
        """Window in words."""
        return f"{self.start:g} to {self.end:g} s"

    def limits(self) -> str:
        """Limits in words."""
        if math.isinf(self.maximum):
            limits = f">= {self.minimum:.6g}"
        elif math.isinf(self.minimum):
            limits = f"<= {self.maximum:.6g}"
        else:
            limits = f"{self.minimum:.6g} to {self.maximum:.6g}"
        return f"{limits} {self.unit}".rstrip()


class _Asked(NamedTuple):
    """What an entry asks for, whatever its name and window."""

    measure: Measure
    channel: str
    minimum: float
    maximum: float


_Parser: TypeAlias = Callable[[Mapping[str, Any], str], _Asked]


def parse_expectations(entries: object) -> tuple[Expectation, ...]:
    """The list ``expectations`` of a profile. Raises UsageError naming entry, value and limit."""
    expectations = tuple(
        _expectation(f"expectations[{position}]", entry)
        for position, entry in enumerate(fields.sequence(entries, "expectations"))
    )
    first: dict[str, int] = {}
    for position, expectation in enumerate(expectations):
        if first.setdefault(expectation.name, position) != position:
            raise UsageError(
                f"expectations[{position}].name is {expectation.name!r}, as that of "
                f"expectations[{first[expectation.name]}]: give each its own"
            )
    return expectations


def _expectation(where: str, entry: object) -> Expectation:
    tree = fields.mapping(entry, where, _KEYS)
    measures = [measure for measure in _MEASURE_KEYS if measure in tree]
    if len(measures) != 1:
        named = " and ".join(measures) or "none"
        raise UsageError(f"{where} must have exactly one of {', '.join(_MEASURE_KEYS)}; it has {named}")
    (key,) = measures
    fields.mapping(tree, f"{where} ({key})", (*_COMMON_KEYS, key, *_MEASURE_KEYS[key]))
    start, end = fields.window(tree, where)
    asked = _PARSERS.get(key, _statistic)(tree, where)
    if key == "settling" and asked.maximum > end - start:
        raise UsageError(
            f"{where}.within is {asked.maximum:g} s, longer than the window ({end - start:g} s): "
            "lengthen the window or ask for less"
        )
    name = fields.text(tree, "name", where, f"{key} {tree[key]} {start:g} to {end:g} s")
    return Expectation(name, asked.measure, asked.channel, start, end, asked.minimum, asked.maximum)


def _statistic(tree: Mapping[str, Any], where: str) -> _Asked:
    name = next(key for key in STATISTICS if key in tree)
    return _Asked(Statistic(name), _channel(tree, name, where), *_limits(tree, where))


def _share(tree: Mapping[str, Any], where: str) -> _Asked:
    flank = fields.choice(tree, "share", where, tuple(FLANK_STATES))
    return _Asked(Share(flank), "meshing_state", *_limits(tree, where))


def _settling(tree: Mapping[str, Any], where: str) -> _Asked:
    channel = _channel(tree, "settling", where)
    target, tolerance = fields.number(tree, "target", where), fields.not_negative(tree, "tolerance", where)
    measure = Settling(target - tolerance, target + tolerance, UNITS[channel])
    return _Asked(measure, channel, -math.inf, fields.time(tree, "within", where))


def _monotone(tree: Mapping[str, Any], where: str) -> _Asked:
    channel = _channel(tree, "monotone", where)
    direction = fields.choice(tree, "direction", where, tuple(DIRECTIONS))
    ripple = fields.not_negative(tree, "tolerance", where) if "tolerance" in tree else 0.0
    return _Asked(Monotone(direction), channel, -math.inf, ripple)


_PARSERS: Mapping[str, _Parser] = {"share": _share, "settling": _settling, "monotone": _monotone}


def _channel(tree: Mapping[str, Any], key: str, where: str) -> str:
    return fields.choice(tree, key, where, tuple(UNITS))


def _limits(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    given = {key: fields.number(tree, key, where) for key in _LIMIT_KEYS if key in tree}
    if given.keys() == {"target", "tolerance"}:
        tolerance = fields.not_negative(tree, "tolerance", where)
        return given["target"] - tolerance, given["target"] + tolerance
    if not given or given.keys() & {"target", "tolerance"}:
        raise UsageError(f"{where} must have minimum, maximum or both, or else target and tolerance")
    minimum, maximum = given.get("minimum", -math.inf), given.get("maximum", math.inf)
    if minimum > maximum:
        raise UsageError(f"{where}.minimum is {minimum:g}, above its maximum {maximum:g}")
    return minimum, maximum
