"""Bounds of commands."""

from __future__ import annotations

import math

from gear_dynamics_ros.parameters.tree import specifications


def command_bounds(speed_limit: float) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each command, by field of Commands; ``speed_limit`` in rad/s."""
    rows = {name: specifications()[f"operation.{name}"] for name in ("drive_torque", "load_torque")}
    bounds = {
        name: (
            -math.inf if row.minimum is None else row.minimum,
            math.inf if row.maximum is None else row.maximum,
        )
        for name, row in rows.items()
    }
    return bounds | {"speed": (-speed_limit, speed_limit)}
