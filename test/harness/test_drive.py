"""`drive` against the real node over DDS: commands reach it, failures are told with numbers."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
from conftest import Process, StartProcess
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from support.paths import CONFIG

# `make demo` plays demo.yaml.
SHIPPED = sorted(path for path in (CONFIG / "profiles").glob("*.yaml") if path.stem != "demo")

STEP = """
commands:
  load_torque:
    - {at: 0.0, value: 20.0}
    - {at: 0.3, value: 45.0}
  speed:
    - {at: 0.0, value: 400.0}
expectations:
  - {name: not early, every: load_torque, from: 0.15, to: 0.3, target: 20.0, tolerance: 0.0}
  - {name: step applied, every: load_torque, from: 0.45, to: 0.6, target: 45.0, tolerance: 0.0}
  - {name: speed governed, mean: driving_speed, from: 0.2, to: 0.3, target: 400.0, tolerance: 20.0}
"""
IMPOSSIBLE = """
commands: {load_torque: [{at: 0.0, value: 20.0}]}
expectations:
  - {name: impossible torque, largest: load_torque, from: 0.15, to: 0.25, minimum: 1e3}
  - {name: drive flank, share: drive, from: 0.15, to: 0.25, minimum: 0.0, maximum: 1.0}
"""
RUNAWAY = """
duration: 1000.0
commands: {drive_torque: [{at: 0.0, value: 190.0}]}
"""
REPLAYED = """
commands: {load_torque: [{from: 0.0, csv: load.csv, interpolation: held}]}
expectations:
  - {name: first row, every: load_torque, from: 0.15, to: 0.3, target: 12.0, tolerance: 0.0}
  - {name: second row, every: load_torque, from: 0.45, to: 0.6, target: 34.0, tolerance: 0.0}
"""
CONFIGURED = """
parameters: {PARAMETERS}
commands: {load_torque: [{at: 0.0, value: 20.0}]}
expectations:
  - {name: load applied, every: load_torque, from: 0.5, to: 0.6, target: 20.0, tolerance: 0.0}
"""
RESET = """
reset: true
commands: {load_torque: [{at: 0.1, value: 20.0}]}
expectations:
  - {name: load of the start state, every: load_torque, from: 0.0, to: 0.1, target: 30.0, tolerance: 0.0}
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
    report = profile.with_suffix(".xml")
    run = drive(process, profile, IMPOSSIBLE, "--wait", "60", "--junit", str(report))
    assert run.wait() == 1, run.output
    assert "1 of 2 expectations passed" in run.stdout
    assert run.stderr.splitlines() == [
        "drive: failed: impossible torque: largest of load_torque in 0.15 to 0.25 s is 20 N m, "
        "expected >= 1000 N m"
    ]

    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["failure"], []]


def test_a_recorded_command_is_replayed(gearbox: Process, process: StartProcess, profile: Path) -> None:
    (profile.parent / "load.csv").write_text("time,load_torque\n0,12\n0.3,34\n")
    run = drive(process, profile, REPLAYED, "--wait", "60")
    assert run.wait() == 0, run.output


def test_a_reset_before_time_0_brings_back_the_commands_of_the_parameters(
    gearbox: Process, process: StartProcess, profile: Path
) -> None:
    loaded = "duration: 0.1\ncommands: {load_torque: [{at: 0.0, value: 45.0}]}"
    before = drive(process, profile, loaded, "--wait", "60")
    assert before.wait() == 0, before.output
    run = drive(process, profile, RESET)
    assert run.wait() == 0, run.output


def real_time_factor(node: str) -> float:
    """The parameter as ``node`` tells it."""
    context = Context()
    rclpy.init(context=context)
    try:
        asking = Node("asking", context=context)
        client = asking.create_client(GetParameters, f"{node}/get_parameters")
        assert client.wait_for_service(timeout_sec=30.0)
        answer = client.call_async(GetParameters.Request(names=["pacing.real_time_factor"]))
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(asking)
        executor.spin_until_future_complete(answer, timeout_sec=30.0)
        return float(answer.result().values[0].double_value)
    finally:
        context.try_shutdown()


def test_parameters_are_set_before_the_start_all_or_none(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    process("gearbox", "--ros-args", "-r", "__ns:=/rig", "-r", "__node:=left")
    options = ("--node", "rig/left", "--wait", "60")

    def text(parameters: str) -> str:
        return CONFIGURED.replace("PARAMETERS", parameters)

    run = drive(process, profile, text("pacing.real_time_factor: 1"), *options)
    assert run.wait() == 0, run.output
    run = drive(process, profile, text("pacing.real_time_factor: 0.5"), *options)
    assert run.wait() == 0, run.output
    assert real_time_factor("/rig/left") == 0.5

    report = profile.with_suffix(".xml")
    refused = text("pacing.real_time_factor: 0.25, operation.speed_limit: -1.0")
    run = drive(process, profile, refused, *options, "--junit", str(report))
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /rig/left refused the profile's parameters: ")
    assert "operation.speed_limit" in line
    assert "0 commands published" in run.stdout
    assert real_time_factor("/rig/left") == 0.5
    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["skipped"], ["error"]]
    assert suite[-1][0].get("message") == line.removeprefix("drive: error: ")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_tells_how_far_it_came(
    gearbox: Process, process: StartProcess, profile: Path, number: signal.Signals
) -> None:
    report = profile.with_suffix(".xml")
    run = drive(process, profile, LONG, "--wait", "60", "--junit", str(report))
    run.wait_for("joined")
    run.signal_group(number)
    assert run.wait() == 128 + number, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith(f"drive: interrupted by {number.name} at ")
    assert line.endswith(" s of the profile's 1000 s")
    assert "\nopen  never reached  " in run.stdout
    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["skipped"], ["error"]]


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


@pytest.fixture(scope="module")
def shipped_gearbox(module_ros_domain: int, module_process: StartProcess) -> Process:
    """One gearbox for all shipped profiles, which set the parameters that they need.

    Slowed down: on a busy machine the waveform reaches drive up to a second of wall time late, and so do its
    commands the gearbox.
    """
    return module_process(
        "gearbox", "--ros-args", "-r", "__node:=shipped", "-p", "pacing.real_time_factor:=0.25"
    )


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_profile_holds(shipped_gearbox: Process, process: StartProcess, path: Path) -> None:
    run = process("drive", path, "--node", "shipped", "--wait", "60")
    assert run.wait() == 0, run.output + shipped_gearbox.output
    assert "\nFAIL" not in run.stdout
