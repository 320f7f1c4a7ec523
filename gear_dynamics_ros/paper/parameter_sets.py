"""The sets of parameters under which the paper's cases are run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from gear_dynamics_ros.paper.cases import ParameterSet
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.parameters.changes import updated

# Holds what the paper leaves open as a search over its numbers and claims found it.
PARAMETER_FILE: Final = "config/paper.yaml"
# Where each section of the paper that names no restitution may have its own.
RESTITUTION_BY_SECTION: Final[Mapping[str, float]] = {"3.1": 0.99422, "3.2": 0.99422, "3.4": 1.0}
# What config/gearbox.yaml has instead of the published equations.
REFINED_SWITCHES: Final[Mapping[str, str]] = {
    "mesh_geometry": "exact",
    "mesh_damping": "contact",
    "restitution_law": "exact",
    "mesh_phase": "actual",
}


def one_set(parameters: Parameters) -> ParameterSet:
    """``parameters`` for all cases."""
    return ParameterSet("one_set", "one set of parameters", parameters, {})


def set_by_section(parameters: Parameters) -> ParameterSet:
    """``parameters``, but for the restitution where the paper names none."""
    return ParameterSet(
        "by_section", "restitution by section of the paper", parameters, RESTITUTION_BY_SECTION
    )


def refined_set(parameters: Parameters) -> ParameterSet:
    """``parameters`` with the refined equations."""
    return ParameterSet("refined", "refined equations", updated(parameters, REFINED_SWITCHES), {})
