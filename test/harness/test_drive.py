"""`drive` against the real node over DDS: commands reach it, failures are told with numbers."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gear_dynamics_ros import recording
from gear_dynamics_ros.physics.kernel.sources import kernel_hash
from support.gearbox import Client, Peer, shared_gearbox, start_gearbox
from support.pages import parse_page
from support.paths import CONFIG
from support.processes import Process, StartProcess, until

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
RAMP = """
commands: {load_torque: [{at: 0.0, value: 20.0}, {from: 0.01, to: 2.0, value: 40.0}]}
expectations:
  - {name: impossible, largest: load_torque, from: 0.1, to: 2.0, minimum: 1e3}
"""
REFUSED = """
duration: 0.2
commands: {speed: [{at: 0.1, value: 6000.0}]}
expectations:
  - {name: still, mean: driving_speed, from: 0.1, to: 0.2, target: 400.0, tolerance: 100.0}
"""
LOCKSTEP = """
reset: true
parameters: {operation.control: speed}
commands:
  speed: [{at: 0.0, value: 500.0}, {at: 0.1, value: 900.0}]
  load_torque: [{at: 0.2, value: 45.0}]
expectations:
  - {name: not early, every: load_torque, from: 0.0, to: 0.2, target: 30.0, tolerance: 0.0}
  - {name: not late, every: load_torque, from: 0.2, to: 0.6, target: 45.0, tolerance: 0.0}
"""
LONG = """
expectations:
  - {name: never reached, mean: dte, from: 0.0, to: 1000.0, minimum: -1.0}
"""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    return tmp_path / "profile.yaml"


class Shared(NamedTuple):
    process: Process
    client: Client
    parameters: dict[str, Any]


@pytest.fixture(scope="module")
def shared(module_ros_domain: int, module_process: StartProcess) -> Iterator[Shared]:
    """A gearbox that all tests here may drive; it turns at 400 rad/s.

    Slowed down: on a busy machine the waveform reaches drive up to a second of wall time late, and so do its
    commands the gearbox.
    """
    words = ("operation.speed:=400.0", "pacing.real_time_factor:=0.2")
    hears = ("event", "applied_command")
    with shared_gearbox(module_process, *words, hears=hears) as (process, client, parameters):
        yield Shared(process, client, parameters)


@pytest.fixture
def gearbox(shared: Shared) -> Process:
    """It has just begun anew with the parameters it was started with."""
    shared.client.put_back(shared.parameters)
    return shared.process


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
    report, page = profile.with_suffix(".xml"), profile.with_suffix(".html")
    files = ("--junit", str(report), "--report", str(page))
    run = drive(process, profile, IMPOSSIBLE, "--wait", "60", *files)
    assert run.wait() == 1, run.output
    assert "1 of 2 expectations passed" in run.stdout
    assert run.stderr.splitlines() == [
        "drive: failed: impossible torque: largest of load_torque in 0.15 to 0.25 s is 20 N m, "
        "expected >= 1000 N m"
    ]

    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["failure"], []]
    told = parse_page(page.read_text(encoding="utf-8"))
    assert told.one(class_="verdict bad").text == "FAILED: 1 of 2 expectations do not hold."
    assert "is 20 N m, expected >= 1000 N m" in told.one("figure", id="window-1").text
    assert len(list(told.one("figure", id="window-2").all("svg"))) == 1
    assert kernel_hash() in told.text


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


def configured(parameters: str) -> str:
    """Text of a profile with these parameters."""
    return CONFIGURED.replace("PARAMETERS", parameters)


def test_parameters_are_set_before_the_start(ros_domain: int, process: StartProcess, profile: Path) -> None:
    start_gearbox(process, remap=["__ns:=/rig", "__node:=left"])
    run = drive(
        process, profile, configured("pacing.real_time_factor: 0.5"), "--node", "rig/left", "--wait", "60"
    )
    assert run.wait() == 0, run.output
    with Peer("asking", "/rig/left") as asking:
        assert asking.get("pacing.real_time_factor") == 0.5


def test_parameters_of_which_one_is_refused_are_not_set(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path
) -> None:
    report = profile.with_suffix(".xml")
    text = configured("pacing.real_time_factor: 0.25, operation.speed_limit: -1.0")
    run = drive(process, profile, text, "--wait", "60", "--junit", str(report))
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /gearbox refused the profile's parameters: ")
    assert "operation.speed_limit" in line
    assert "0 commands published" in run.stdout
    assert shared.client.changeable() == shared.parameters
    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["skipped"], ["error"]]
    assert suite[-1][0].get("message") == line.removeprefix("drive: error: ")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_run_tells_how_far_it_came(
    gearbox: Process, process: StartProcess, profile: Path, number: signal.Signals
) -> None:
    report, page = profile.with_suffix(".xml"), profile.with_suffix(".html")
    files = ("--junit", str(report), "--report", str(page))
    run = drive(process, profile, LONG, "--wait", "60", *files)
    run.wait_for("joined")
    run.signal_group(number)
    assert run.wait() == 128 + number, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith(f"drive: interrupted by {number.name} at ")
    assert line.endswith(" s of the profile's 1000 s")
    assert "\nopen  never reached  " in run.stdout
    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["skipped"], ["error"]]
    told = parse_page(page.read_text(encoding="utf-8")).one(class_="verdict bad").text
    assert told.startswith(f"INTERRUPTED: interrupted by {number.name} at ")


def test_an_absent_gearbox_is_told_within_the_wait(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    page = profile.with_suffix(".html")
    run = drive(process, profile, LONG, "--node", "nobody", "--wait", "0.5", "--report", str(page))
    assert run.wait() == 1
    told = parse_page(page.read_text(encoding="utf-8"))
    assert told.one(class_="verdict bad").text.startswith("BROKE OFF: no gearbox /nobody was seen for 0.5 s")
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: no gearbox /nobody was seen for 0.5 s: start it")


@pytest.fixture
def starting_gearbox(ros_domain: int) -> Iterator[tuple[Context, Node]]:
    """A node that is in the graph and serves nobody, as a gearbox while it compiles."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("gearbox", context=context)
    node.create_service(GetState, "~/get_state", lambda _, answer: answer)
    yield context, node
    context.try_shutdown()


def test_the_start_of_a_gearbox_may_take_longer_than_the_wait(
    starting_gearbox: tuple[Context, Node], process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, LONG, "--wait", "4")
    run.wait_for("/gearbox is starting, waiting until it answers: see its log")
    context, node = starting_gearbox
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    while run.returncode is None:
        executor.spin_once(timeout_sec=0.1)
    assert run.wait() == 1
    assert (
        "/gearbox is there, but published no ~/model_info for 4 s: it may be starting, inactive" in run.stderr
    )


def test_a_gearbox_that_ends_while_it_starts_is_not_waited_for(
    starting_gearbox: tuple[Context, Node], process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, LONG, "--wait", "1000")
    run.wait_for("/gearbox is starting")
    context, node = starting_gearbox
    node.destroy_node()
    context.try_shutdown()
    assert run.wait() == 1
    assert run.stderr.endswith("drive: error: /gearbox disappeared before it was ready: see its log\n")


def test_a_missing_channel_and_a_killed_gearbox_are_told(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    gearbox = start_gearbox(process, "waveform_channels:=['time', 'dte']")
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
    gearbox = start_gearbox(process, "operation.control:=torque")
    run = drive(process, profile, RUNAWAY, "--wait", "60")
    assert run.wait() == 1, run.output + gearbox.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /gearbox ended the run at ")
    assert "over-speed" in line


@pytest.fixture
def stopped(shared: Shared) -> Iterator[Process]:
    """The shared gearbox; its process goes on at the end."""
    shared.client.put_back(shared.parameters)
    yield shared.process
    shared.process.signal(signal.SIGCONT)


@pytest.mark.parametrize("option", [[], ["--lockstep"]], ids=["own pace", "lockstep"])
def test_a_gearbox_that_hangs_is_told_in_bounded_time(
    stopped: Process, process: StartProcess, profile: Path, option: list[str]
) -> None:
    run = drive(process, profile, LONG, "--wait", "60", "--timeout", "2", *option)
    run.wait_for("joined")
    stopped.signal(signal.SIGSTOP)
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: /gearbox ")
    assert "2 s" in line and "--timeout" in line


def test_a_gearbox_that_hangs_before_drive_has_joined_is_told_within_the_wait(
    stopped: Process, process: StartProcess, profile: Path
) -> None:
    stopped.signal(signal.SIGSTOP)
    run = drive(process, profile, LONG, "--wait", "2", "--timeout", "2")
    assert run.wait() == 1, run.output
    assert "drive: error: " in run.stderr


def test_a_gearbox_that_is_paused_is_waited_for(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path
) -> None:
    run = drive(process, profile, STEP, "--wait", "60", "--timeout", "0.5")
    run.wait_for("joined")
    assert shared.client.switch("pause", True).success
    run.wait_for("/gearbox is paused at ")
    asked = time.monotonic()
    until(lambda: time.monotonic() > asked + 3.0, "six time-outs")
    assert run.returncode is None, run.output
    assert shared.client.switch("pause", False).success
    assert run.wait() == 0, run.output


def test_a_gearbox_that_is_slow_is_waited_for(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path
) -> None:
    assert shared.client.put("pacing.real_time_factor", 2e-3).successful
    short = "commands: {load_torque: [{at: 0.0, value: 20.0}]}\nduration: 0.004"
    run = drive(process, profile, short, "--wait", "60", "--timeout", "0.3")
    assert run.wait() == 0, run.output


def test_commands_that_a_slow_machine_left_out_are_told_instead_of_the_expectation(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path
) -> None:
    report = profile.with_suffix(".xml")
    run = drive(process, profile, RAMP, "--wait", "60", "--junit", str(report))
    run.wait_for("joined")
    shared.client.until(lambda: 22.0 < shared.client.in_force().load_torque < 29.0)
    run.signal(signal.SIGSTOP)
    stopped_at = time.monotonic()
    until(lambda: time.monotonic() > stopped_at + 1.5, "the gearbox has gone on")
    run.signal(signal.SIGCONT)
    assert run.wait() == 1, run.output
    # The middleware may complain of the stop on stderr too.
    told = [line for line in run.stderr.splitlines() if line.startswith("drive: ")]
    assert len(told) == 2, run.output
    unjudged, error = told
    assert unjudged.startswith("drive: impossible: largest of load_torque in 0.1 to 2 s can't be judged: ")
    assert error.startswith("drive: error: the machine was too slow: simulated time ran at 0.")
    assert error.endswith(" s late; use --lockstep")
    (suite,) = ElementTree.parse(report).getroot()
    assert [[child.tag for child in case] for case in suite] == [["error"]]


def test_refused_commands_are_not_waited_for(gearbox: Process, process: StartProcess, profile: Path) -> None:
    run = drive(process, profile, REFUSED, "--wait", "60")
    assert run.wait() == 0, run.output


def test_a_profile_in_lockstep_gives_the_same_bits_at_any_load_and_chunk_length(
    ros_domain: int, process: StartProcess, profile: Path
) -> None:
    profile.write_text(LOCKSTEP)
    quiet = recorded_in_lockstep(process, profile, "quiet", "0.002")
    fine = recorded_in_lockstep(process, profile, "fine", "0.001")
    loops = [process(sys.executable, "-c", "while True: pass") for _ in range(2)]
    busy = recorded_in_lockstep(process, profile, "busy", "0.002")
    for loop in loops:
        loop.stop()
    for other in (fine, busy):
        diff = process("replay", "diff", quiet, other, "--align", "start")
        assert diff.wait() == 0, diff.output
    assert recording.open(quiet).end_sample - recording.open(quiet).first_sample == 60_000


def recorded_in_lockstep(process: StartProcess, profile: Path, name: str, chunk: str) -> Path:
    """Recording of what the profile makes of a gearbox ``name``, paused before and afterwards."""
    words = (f"recording.path:={profile.parent / name}", f"solver.chunk:={chunk}")
    gearbox = start_gearbox(process, *words, remap=[f"__node:={name}"])
    with Peer("operator", f"/{name}") as operator:
        assert operator.switch("pause", True).success
        assert operator.switch("record", False).success
        assert operator.switch("record", True).success
        run = process("drive", profile, "--lockstep", "--node", name, "--wait", "60")
        assert run.wait() == 0, run.output
        assert f"/{name} stays paused, as before" in run.stdout
        assert "3 commands published" in run.stdout
        answer = operator.switch("record", False)
        assert answer.success
    assert gearbox.stop() == 0
    return Path(answer.message.removeprefix("recorded "))


@pytest.mark.parametrize("paused", [True, False], ids=["paused", "running"])
def test_an_interrupted_lockstep_leaves_the_gearbox_as_it_was(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path, paused: bool
) -> None:
    assert shared.client.switch("pause", paused).success
    run = drive(process, profile, LONG, "--lockstep", "--wait", "60")
    run.wait_for("joined")
    run.signal_group(signal.SIGINT)
    assert run.wait() == 130, run.output
    assert f"/gearbox {'stays paused' if paused else 'runs again'}, as before" in run.stdout
    assert shared.client.switch("pause", paused).message.startswith("already ")
    assert shared.client.get("stepping.chunks") == 1


def test_in_lockstep_a_failed_expectation_and_a_refused_command_are_told(
    gearbox: Process, process: StartProcess, profile: Path
) -> None:
    page = profile.with_suffix(".html")
    run = drive(process, profile, IMPOSSIBLE, "--lockstep", "--wait", "60", "--report", str(page))
    assert run.wait() == 1, run.output
    told = parse_page(page.read_text(encoding="utf-8"))
    assert "each command acted at exactly its sample" in told.text
    assert len(list(told.one("figure", id="window-2").all("svg"))) == 1
    assert "drive: failed: impossible torque: largest of load_torque in 0.15 to 0.25 s is 20" in run.stderr
    run = drive(process, profile, REFUSED, "--lockstep", "--timeout", "1")
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert "it may have refused one" in line


def test_an_entry_within_a_chunk_is_refused_in_lockstep_before_anything_is_done(
    gearbox: Process, shared: Shared, process: StartProcess, profile: Path
) -> None:
    known = len(shared.client.events())
    odd = "commands: {load_torque: [{at: 0.0, value: 20.0}, {at: 0.001, value: 30.0}]}\nduration: 0.01"
    run = drive(process, profile, odd, "--lockstep", "--wait", "60")
    assert run.wait() == 2, run.output
    (line,) = run.stderr.splitlines()
    assert line.endswith("start the gearbox with solver.chunk = 0.001 s")
    assert shared.client.events()[known:] == []


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_profile_holds(gearbox: Process, process: StartProcess, path: Path) -> None:
    run = process("drive", path, "--lockstep", "--wait", "60")
    assert run.wait(300.0) == 0, run.output + gearbox.output


def test_a_shipped_profile_holds_in_real_time(
    gearbox: Process, shared: Shared, process: StartProcess
) -> None:
    assert shared.client.put("pacing.real_time_factor", 0.25).successful
    run = process("drive", CONFIG / "profiles" / "load_step.yaml", "--wait", "60")
    assert run.wait() == 0, run.output + gearbox.output
    assert " ms late (median), " in run.stdout


def test_a_parameter_of_ros_that_drive_cannot_have_is_told_in_a_line(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text("duration: 0.1\ncommands: {load_torque: [{at: 0.0, value: 30.0}]}\n")
    run = process("drive", path, "--ros-args", "-p", "use_sim_time:=3")
    assert run.wait() == 2
    (line,) = run.stderr.splitlines()
    assert line.startswith("drive: error: ROS did not start: ") and "use_sim_time" in line
