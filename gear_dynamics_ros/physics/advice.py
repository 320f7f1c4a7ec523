"""Warnings about parameters that are allowed but probably not intended."""

from __future__ import annotations

import math

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.step_check import checks, waves_per_turn


def parameter_warnings(parameters: Parameters) -> list[str]:
    """Every warning about ``parameters``, one line each: unbalanced torques, then a step that is too long."""
    return [*torque_warnings(parameters), *step_warnings(parameters)]


def torque_warnings(parameters: Parameters) -> list[str]:
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


def step_warnings(parameters: Parameters, speed: float | None = None) -> list[str]:
    """Rates of the model that are too high for ``solver.step``, at ``speed`` as for ``checks``."""
    return [check.message for check in checks(parameters, speed) if not check.holds]


def sampling_warnings(parameters: Parameters, speed: float) -> list[str]:
    """Waves of the tooth surfaces that pass too fast for the samples at ``speed`` of the driving gear, rad/s.

    Not among ``parameter_warnings``: the motion is right, only samples can't show it.
    """
    frequency = waves_per_turn(parameters) * abs(speed) / (2.0 * math.pi)
    highest = 0.5 / parameters.solver.sample_interval
    if frequency <= highest:
        return []
    return [
        f"the shortest wave of the tooth surfaces passes at {1e-3 * frequency:.4g} kHz, above half the "
        f"sampling rate ({1e-3 * highest:.4g} kHz): its traces in spectra are at wrong, lower frequencies; "
        f"lower solver.sample_interval to {0.5 / frequency:.2g} s or less to see it"
    ]
