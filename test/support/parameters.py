"""Parameters in a line."""

from __future__ import annotations

from typing import Any

from gear_dynamics_ros.parameters import Parameters


def parameters(**changed: Any) -> Parameters:
    """Defaults with ``changed``: dots of a name are written as two underscores."""
    return Parameters.from_flat({name.replace("__", "."): value for name, value in changed.items()})
