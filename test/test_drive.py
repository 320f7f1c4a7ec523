"""`drive` against the real node over DDS: commands reach it, failures are told with numbers."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Process, StartProcess

STEP = """
commands:
  load_torque:
    - {at: 0.0, value: 20.0}
    - {at: 0.3, value: 45.0}
  speed:
    - {at: 0.0, value: 400.0}
expectations:
  - {name: not early, every: load_torque, from: 0.05, to: 0.3, target: 20.0, tolerance: 0.0}
  - {name: step applied, every: load_torque, from: 0.35, to: 0.6, target: 45.0, tolerance: 0.0}
  - {name: speed governed, mean: driving_speed, from: 0.2, to: 0.3, target: 400.0, tolerance: 20.0}
"""
IMPOSSIBLE = """
commands: {load_torque: [{at: 0.0, value: 20.0}]}
expectations:
  - {name: impossible torque, largest: load_torque, from: 0.1, to: 0.2, minimum: 1e3}
  - {name: drive flank, share: drive, from: 0.1, to: 0.2, minimum: 0.0, maximum: 1.0}
"""
RUNAWAY = """
duration: 1000.0
commands: {drive_torque: [{at: 0.0, value: 190.0}]}
"""
LONG = """
expectations:
  - {name: never reached, mean: dte, from: 0.0, to: 1000.0, minimum: -1.0}
"""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    return tmp_path / "profile.yaml"


@pytest.fixture(scope="module")
def gearbox(module_ros_domain: int, module_process: StartProcess) -> Iterator[Process]:
    """A gearbox that all tests here may drive; it turns at 400 rad/s.

    At a fifth of real time, so that a command that a busy machine holds up is late by little simulated time.
    """
    options = ("-p", "operation.speed:=400.0", "-p", "pacing.real_time_factor:=0.2")
    yield module_process("gearbox", "--ros-args", *options)


def drive(process: StartProcess, profile: Path, text: str, *options: str) -> Process:
    profile.write_text(text)
    return process("drive", profile, *options)


def test_commands_take_effect_at_their_time_and_expectations_hold(
    gearbox: Process, process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, STEP, "--wait", "60")
    assert run.wait() == 0, run.output + gearbox.output
    assert "3 of 3 expectations passed" in run.stdout
    assert run.stdout.count("\npass  ") == 3
    assert run.stderr == ""


def test_a_failed_expectation_is_named_with_its_numbers(
    gearbox: Process, process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, IMPOSSIBLE, "--wait", "60")
    assert run.wait() == 1, run.output
    assert "1 of 2 expectations passed" in run.stdout
    assert run.stderr.splitlines() == [
        "drive: failed: impossible torque: largest of load_torque in 0.1 to 0.2 s is 20, expected >= 1000"
    ]


def test_an_absent_gearbox_is_told_within_the_wait(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, LONG, "--node", "nobody", "--wait", "0.5")
    assert run.wait() == 1
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: no gearbox /nobody was seen for 0.5 s: start it")


def test_a_missing_channel_and_a_killed_gearbox_are_told(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    gearbox = process("gearbox", "--ros-args", "-p", "waveform_channels:=['time', 'dte']")
    run = drive(process, profile, IMPOSSIBLE, "--wait", "60")
    assert run.wait() == 1
    assert "channel load_torque is needed by expectation 'impossible torque'" in run.stderr
    assert "waveform_channels" in run.stderr

    run = drive(process, profile, LONG, "--wait", "60", "--timeout", "1")
    run.wait_for("joined")
    gearbox.signal(signal.SIGKILL)
    assert run.wait() == 1
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /gearbox ")
    assert "never reached" in run.stdout


def test_the_end_of_the_run_is_told_with_its_reason(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    gearbox = process("gearbox", "--ros-args", "-p", "operation.control:=torque")
    run = drive(process, profile, RUNAWAY, "--wait", "60")
    assert run.wait() == 1, run.output + gearbox.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /gearbox ended the run at ")
    assert "over-speed" in line
