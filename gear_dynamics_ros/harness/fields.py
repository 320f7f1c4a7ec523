"""Reads entries of a profile and checks their types.

``tree`` is the mapping that holds the entry, ``key`` its key there, and ``where`` the name of ``tree`` in the
file, as in ``commands.speed[2]``. All raise UsageError in one line with name, value and limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.decimals import exact_text


def require_list(value: object, where: str) -> Sequence[object]:
    """``value`` if it is a list."""
    if not isinstance(value, list):
        raise UsageError(f"{where} is {value!r}, must be a list")
    return value


def require_number(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The finite number under ``key``."""
    if key not in tree:
        raise UsageError(f"{where} has no {key}: add it")
    value = tree[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{where}.{key} is {value!r}, must be a finite number")
    return float(value)


def require_not_negative(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The number >= 0 under ``key``."""
    value = require_number(tree, key, where)
    if value < 0.0:
        raise UsageError(f"{where}.{key} is {exact_text(value)}, must be >= 0")
    return value


def require_time(tree: Mapping[str, Any], key: str, where: str) -> float:
    """The time >= 0 s under ``key``."""
    value = require_number(tree, key, where)
    if value < 0.0:
        raise UsageError(f"{where}.{key} is {exact_text(value)} s, must be >= 0")
    return value


def require_window(tree: Mapping[str, Any], where: str) -> tuple[float, float]:
    """The times in s under ``from`` and ``to``, of which the second must be later."""
    start, end = require_time(tree, "from", where), require_time(tree, "to", where)
    if end <= start:
        raise UsageError(
            f"{where}.to is {exact_text(end)} s, must be later than its from, {exact_text(start)} s"
        )
    return start, end


def optional_text(tree: Mapping[str, Any], key: str, where: str, default: str) -> str:
    """The text under ``key``, or ``default`` without that key."""
    value = tree.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"{where}.{key} is {value!r}, must be text")
    return value


def require_choice(tree: Mapping[str, Any], key: str, where: str, choices: Sequence[str]) -> str:
    """The text under ``key``, which must be one of ``choices``."""
    if key not in tree:
        raise UsageError(f"{where} has no {key}: give one of {', '.join(choices)}")
    value = tree[key]
    if value not in choices:
        raise UsageError(f"{where}.{key} is {value!r}, must be one of {', '.join(choices)}")
    return str(value)


def optional_flag(tree: Mapping[str, Any], key: str, where: str, default: bool) -> bool:
    """The boolean under ``key``, or ``default`` without that key."""
    value = tree.get(key, default)
    if not isinstance(value, bool):
        raise UsageError(f"{where}.{key} is {value!r}, must be true or false")
    return value
