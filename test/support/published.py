"""The default gearbox with the equations as the source paper published them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from gear_dynamics_ros.parameters import Parameters, load_parameters
from support.paths import CONFIG

SWITCHES: Final = (
    "mesh_geometry=published",
    "mesh_damping=always",
    "restitution_law=lankarani_nikravesh",
    "mesh_phase=nominal",
    "operation.control=torque",
)


def published_gearbox(overrides: Sequence[str] = ()) -> Parameters:
    """``config/gearbox.yaml`` with SWITCHES and ``overrides``, each NAME=VALUE.

    Unlike ``config/paper.yaml`` it holds no fitted values, on which a test must not depend.
    """
    return load_parameters(CONFIG / "gearbox.yaml", [*SWITCHES, *overrides])
