"""Warnings about parameters that are allowed but probably not intended."""

from __future__ import annotations

import math

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.step_check import checks


def parameter_warnings(parameters: Parameters) -> list[str]:
    """Every warning about ``parameters``, one line each: unbalanced torques, then a step that is too long."""
    return [*_unbalanced_torques(parameters), *_long_step(parameters)]


def _unbalanced_torques(parameters: Parameters) -> list[str]:
    """Torques that accelerate the gears from the start on, under ``operation.control: torque``."""
    operation, gears = parameters.operation, parameters.gears
    if operation.control != "torque":
        return []
    ratio = gears.driving.teeth / gears.driven.teeth
    speed = operation.speed * ratio if operation.initial == "touching" else 0.0
    load = operation.load_torque * (math.tanh(speed) if operation.load_law == "brake" else 1.0)
    load += operation.load_viscous * speed
    surplus = operation.drive_torque - load * ratio
    if math.isclose(operation.drive_torque, load * ratio, rel_tol=1e-9, abs_tol=1e-9):
        return []
    acceleration = surplus / (gears.driving.inertia + gears.driven.inertia * ratio**2)
    return [
        f"operation.drive_torque = {operation.drive_torque:g} N m does not balance the load of "
        f"{load * ratio:g} N m at the driving shaft: the speed changes by {acceleration:.4g} rad/s^2; "
        "balance them or set operation.control: speed"
    ]


def _long_step(parameters: Parameters) -> list[str]:
    """Rates of the model that are too high for ``solver.step``."""
    return [check.message for check in checks(parameters) if not check.holds]
