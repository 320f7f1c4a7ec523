"""A change of parameters is validated when it is made, and holds just what differs."""

from __future__ import annotations

import math

import pytest

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, change_to, change_values


def test_a_change_holds_what_differs_and_both_sides() -> None:
    old = Parameters()
    change = change_values(
        old, {"oil.viscosity": 0.05, "operation.load_torque": 30, "mesh.error_cos": [1e-6]}
    )
    assert change.old is old
    assert change.values == {"mesh.error_cos": (1e-6,), "oil.viscosity": 0.05}
    assert change.new.oil.viscosity == 0.05 and change.new.mesh.error_cos == (1e-6,)
    assert change_to(old, change.new) == change
    assert change_to(old, Parameters()).values == {}


def test_an_invalid_or_fixed_value_makes_no_change() -> None:
    with pytest.raises(UsageError, match=r"beyond operation\.speed_limit"):
        change_values(Parameters(), {"operation.speed": 6000.0})
    with pytest.raises(UsageError, match=r"gears\.module = 0\.003 is fixed .* gears\.module = 0\.004"):
        change_values(Parameters(), {"oil.viscosity": 0.1, "gears.module": 0.004})


def test_a_minus_zero_for_a_zero_is_no_change() -> None:
    change = change_values(Parameters(), {"operation.load_viscous": -0.0, "oil.viscosity": 0.05})
    assert change.values == {"oil.viscosity": 0.05}
    assert math.copysign(1.0, change.new.operation.load_viscous) == 1.0
