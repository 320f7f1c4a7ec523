"""Typed reading of a profile's tree: every refusal is one line that names entry, value and limit.

``where`` is the name of the entry in the file, as in ``commands.speed[2]``. All raise UsageError.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gear_dynamics_ros.errors import UsageError


def mapping(value: object, where: str, keys: Sequence[str]) -> Mapping[str, Any]:
    """``value`` if it is a mapping with no other keys than ``keys``."""
    if not isinstance(value, Mapping):
        raise UsageError(f"{where} is {value!r}, must be a mapping with keys from {', '.join(keys)}")
    for key in value:
        if key not in keys:
            raise UsageError(f"{where} has the unknown key {key!r}; known: {', '.join(keys)}")
    return value


def sequence(value: object, where: str) -> Sequence[object]:
    """``value`` if it is a list."""
    if not isinstance(value, list):
        raise UsageError(f"{where} is {value!r}, must be a list")
    return value


def number(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The finite number under ``key``."""
    if key not in tree:
        raise UsageError(f"{where} has no {key}: add it")
    value = tree[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{where}.{key} is {value!r}, must be a finite number")
    return float(value)


def not_negative(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The number >= 0 under ``key``."""
    value = number(tree, key, where)
    if value < 0.0:
        raise UsageError(f"{where}.{key} is {value:g}, must be >= 0")
    return value


def time(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The time >= 0 s under ``key``."""
    value = number(tree, key, where)
    if value < 0.0:
        raise UsageError(f"{where}.{key} is {value:g} s, must be >= 0")
    return value


def window(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    """The times under ``from`` and ``to`` in s, the second later than the first."""
    start, end = time(tree, "from", where), time(tree, "to", where)
    if end <= start:
        raise UsageError(f"{where}.to is {end:g} s, must be later than its from, {start:g} s")
    return start, end


def text(tree: Mapping[str, Any], key: str, where: str, default: str) -> str:
    """The text under ``key``."""
    value = tree.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"{where}.{key} is {value!r}, must be text")
    return value


def choice(tree: Mapping[str, Any], key: str, where: str, choices: Sequence[str]) -> str:
    """The one of ``choices`` under ``key``."""
    if key not in tree:
        raise UsageError(f"{where} has no {key}: give one of {', '.join(choices)}")
    value = tree[key]
    if value not in choices:
        raise UsageError(f"{where}.{key} is {value!r}, must be one of {', '.join(choices)}")
    return str(value)


def switch(tree: Mapping[str, Any], key: str, where: str, default: bool) -> bool:
    """The true or false under ``key``."""
    value = tree.get(key, default)
    if not isinstance(value, bool):
        raise UsageError(f"{where}.{key} is {value!r}, must be true or false")
    return value
