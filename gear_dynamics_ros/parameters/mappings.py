"""Mappings in files that users write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.hints import shortened


def require_mapping(value: object, where: str, keys: Sequence[str]) -> Mapping[str, Any]:
    """``value`` if it is a mapping whose keys are all in ``keys``; ``where`` names it in the file.

    Raises UsageError.
    """
    if not isinstance(value, Mapping):
        raise UsageError(
            f"{where} is {shortened(repr(value))}, must be a mapping with keys among {', '.join(keys)}"
        )
    for key in value:
        if key not in keys:
            raise UsageError(f"{where} has the unknown key {shortened(repr(key))}; known: {', '.join(keys)}")
    return value
