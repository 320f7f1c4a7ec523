"""Warnings about parameters, as the tools print them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.advice import sampling_warnings

TORQUES = ("--set", "operation.control=torque", "--set", "operation.drive_torque=31.0")


def warnings_of(folder: Path, capsys: pytest.CaptureFixture[str], *settings: str) -> list[str]:
    assert simulate_main(["--duration", "0.001", "--output", str(folder / "bag"), *settings]) == 0
    return [line for line in capsys.readouterr().err.splitlines() if "warning" in line]


def test_simulate_tells_once_of_torques_that_do_not_balance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (line,) = warnings_of(tmp_path, capsys, *TORQUES)
    assert line.startswith(
        "simulate: warning: operation.drive_torque = 31 N m does not balance the load of 30 N m"
    )
    assert "224.2 rad/s^2" in line and line.endswith("set operation.control: speed")


def test_simulate_prints_all_warnings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torques, step = warnings_of(tmp_path, capsys, *TORQUES, "--set", "operation.speed=3000.0")
    assert "does not balance" in torques
    assert "solver.step times the frequency of the shortest wave" in step


def test_balanced_torques_bring_no_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert warnings_of(tmp_path, capsys, "--set", "operation.control=torque") == []


def test_waves_that_pass_faster_than_samples_can_show_are_told() -> None:
    # The shortest of 8 waves goes 40 * 1.5^7 = 683.4 times around the driving gear.
    parameters = Parameters()
    limit = 2.0 * math.pi * 0.5e5 / (40 * 1.5**7)  # rad/s, at 100 kHz
    assert sampling_warnings(parameters, 0.999 * limit) == []
    (line,) = sampling_warnings(parameters, -1.001 * limit)
    assert "passes at 50.05 kHz, above half the sampling rate (50 kHz)" in line
    smooth = {"surface.driving.roughness": 0.0, "surface.driven.roughness": 0.0}
    assert sampling_warnings(Parameters.from_flat(smooth), 1e4) == []
