"""How a run starts, and why one has ended."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.chunk import Commands, Status
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.physics.constants import Excitations, aligned_zeros
from gear_dynamics_ros.physics.kernel import entry
from gear_dynamics_ros.physics.kernel.records import STATE


def start_commands(parameters: Parameters) -> Commands:
    """The commands in force at the start."""
    operation = parameters.operation
    # -0.0 equals 0.0, so it must not give other bits.
    return Commands(operation.drive_torque + 0.0, operation.load_torque + 0.0, operation.speed + 0.0)


def start_state(
    parameters: Parameters, constants: NDArray[Any], points: NDArray[Any], excitations: Excitations
) -> NDArray[Any]:
    """State (1,) of STATE in which a run with ``parameters`` starts; ``points`` (3,) POINT are scratch."""
    state = aligned_zeros((1,), STATE)
    operation, commands = parameters.operation, start_commands(parameters)
    if operation.initial == "touching":
        r1, r2 = constants["base_radius"][0]
        state["omega"] = operation.speed, operation.speed * r1 / r2
    state["drive_torque"] = operation.drive_torque if operation.control == "speed" else commands.drive_torque
    state["governor"] = operation.drive_torque
    state["impact_speed"] = constants["minimum_impact_speed"]
    state["speed"], state["load_torque"] = commands.speed, commands.load_torque
    entry.start_touching(constants, state, points, *excitations)
    return state


def end_reason(status: Status, state: NDArray[Any], parameters: Parameters, time: float) -> str:
    """Why a run in ``state`` ended at ``time`` (s) with ``status``; empty while it runs."""
    if status is Status.OVER_SPEED:
        fastest = float(np.abs(state["omega"]).max())
        limit = parameters.operation.speed_limit
        return (
            f"over-speed: {exact_text(fastest)} rad/s exceeds operation.speed_limit = "
            f"{exact_text(limit)} rad/s"
        )
    if status is Status.NON_FINITE:
        return (
            f"the state is no longer finite at t = {time:.9g} s: "
            f"lower solver.step = {parameters.solver.step:g} s or check the parameters"
        )
    if status is Status.CENTRES_PRESSED:
        return "the centres are pressed together: no backlash is left (b1 <= 0) and both flanks would touch"
    return ""
