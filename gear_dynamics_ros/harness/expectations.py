"""Expectations of a profile: limits for a measure of one channel within a window."""

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
    FlankShare,
    Measure,
    Reversal,
    SettlingTime,
    Statistic,
)
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.parameters.mappings import require_mapping

CHANNEL_UNITS: Mapping[str, str] = {channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)}

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
    """That a measure of one channel over the samples with start <= time < end is in [minimum, maximum].

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
        """Unit of the measure, empty if it has none."""
        return self.measure.unit(CHANNEL_UNITS[self.channel])

    def describe(self) -> str:
        """Measure and channel in words."""
        return self.measure.describe(self.channel)

    def window(self) -> str:
        """Window in words."""
        return f"{self.start:g} to {self.end:g} s"

    def limits(self) -> str:
        """Limits in words."""
        if math.isinf(self.maximum):
            limits = f">= {exact_text(self.minimum)}"
        elif math.isinf(self.minimum):
            limits = f"<= {exact_text(self.maximum)}"
        else:
            limits = f"{exact_text(self.minimum)} to {exact_text(self.maximum)}"
        return f"{limits} {self.unit}".rstrip()


class _MeasureRequest(NamedTuple):
    """What an entry requests, without its name and window."""

    measure: Measure
    channel: str
    minimum: float
    maximum: float


_Parser: TypeAlias = Callable[[Mapping[str, Any], str], _MeasureRequest]


def parse_expectations(entries: object) -> tuple[Expectation, ...]:
    """The expectations of a profile from its list ``entries``.

    Raises UsageError in one line naming entry, value and limit.
    """
    expectations = tuple(
        _expectation(f"expectations[{position}]", entry)
        for position, entry in enumerate(fields.require_list(entries, "expectations"))
    )
    first: dict[str, int] = {}
    for position, expectation in enumerate(expectations):
        if first.setdefault(expectation.name, position) != position:
            raise UsageError(
                f"expectations[{position}].name is {expectation.name!r}, the same as that of "
                f"expectations[{first[expectation.name]}]: give each its own"
            )
    return expectations


def _expectation(where: str, entry: object) -> Expectation:
    tree = require_mapping(entry, where, _KEYS)
    measures = [measure for measure in _MEASURE_KEYS if measure in tree]
    if len(measures) != 1:
        named = " and ".join(measures) or "none"
        raise UsageError(f"{where} must have exactly one of {', '.join(_MEASURE_KEYS)}; it has {named}")
    (key,) = measures
    require_mapping(tree, f"{where} ({key})", (*_COMMON_KEYS, key, *_MEASURE_KEYS[key]))
    start, end = fields.require_window(tree, where)
    request = _PARSERS.get(key, _statistic)(tree, where)
    if key == "settling" and request.maximum > end - start:
        raise UsageError(
            f"{where}.within is {exact_text(request.maximum)} s, longer than the window ({end - start:g} s): "
            "lengthen the window or shorten within"
        )
    name = fields.optional_text(tree, "name", where, f"{key} {tree[key]} {start:g} to {end:g} s")
    return Expectation(name, request.measure, request.channel, start, end, request.minimum, request.maximum)


def _statistic(tree: Mapping[str, Any], where: str) -> _MeasureRequest:
    name = next(key for key in STATISTICS if key in tree)
    return _MeasureRequest(Statistic(name), _channel(tree, name, where), *_limits(tree, where))


def _flank_share(tree: Mapping[str, Any], where: str) -> _MeasureRequest:
    flank = fields.require_choice(tree, "share", where, tuple(FLANK_STATES))
    return _MeasureRequest(FlankShare(flank), "meshing_state", *_limits(tree, where))


def _settling_time(tree: Mapping[str, Any], where: str) -> _MeasureRequest:
    channel = _channel(tree, "settling", where)
    target, tolerance = (
        fields.require_number(tree, "target", where),
        fields.require_not_negative(tree, "tolerance", where),
    )
    measure = SettlingTime(target - tolerance, target + tolerance, CHANNEL_UNITS[channel])
    return _MeasureRequest(measure, channel, -math.inf, fields.require_time(tree, "within", where))


def _reversal(tree: Mapping[str, Any], where: str) -> _MeasureRequest:
    channel = _channel(tree, "monotone", where)
    direction = fields.require_choice(tree, "direction", where, tuple(DIRECTIONS))
    ripple = fields.require_not_negative(tree, "tolerance", where) if "tolerance" in tree else 0.0
    return _MeasureRequest(Reversal(direction), channel, -math.inf, ripple)


_PARSERS: Mapping[str, _Parser] = {"share": _flank_share, "settling": _settling_time, "monotone": _reversal}


def _channel(tree: Mapping[str, Any], key: str, where: str) -> str:
    return fields.require_choice(tree, key, where, tuple(CHANNEL_UNITS))


def _limits(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    given = {key: fields.require_number(tree, key, where) for key in _LIMIT_KEYS if key in tree}
    if given.keys() == {"target", "tolerance"}:
        tolerance = fields.require_not_negative(tree, "tolerance", where)
        return given["target"] - tolerance, given["target"] + tolerance
    if not given or given.keys() & {"target", "tolerance"}:
        raise UsageError(f"{where} must have minimum, maximum or both, or else target and tolerance")
    minimum, maximum = given.get("minimum", -math.inf), given.get("maximum", math.inf)
    if minimum > maximum:
        raise UsageError(f"{where}.minimum is {exact_text(minimum)}, above its maximum {exact_text(maximum)}")
    return minimum, maximum
