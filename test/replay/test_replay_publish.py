"""`replay publish` against the real node over DDS: bit for bit in lockstep, near enough when it follows."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from conftest import Process, StartProcess
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros import recording
from gear_dynamics_ros.messages import applied_commands
from gear_dynamics_ros.node_topics import quality
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.signals import Commands
from gear_dynamics_ros.topics import TOPICS, resolve
from support.played import record

# A viscous load, so that no command makes the speed run away.
SETTINGS = {
    "operation.control": "torque",
    "operation.speed": 400.0,
    "operation.drive_torque": 60.0,
    "operation.load_torque": 20.0,
    "operation.load_viscous": 0.1,
}
PARAMETERS = updated(Parameters(), SETTINGS)
OPTIONS = ("--ros-args", *(word for item in SETTINGS.items() for word in ("-p", "{}:={}".format(*item))))
PATIENCE = 60.0
PROFILE = """
duration: 0.3
commands:
  load_torque: [{at: 0.0, value: 20.0}, {from: 0.1, to: 0.2, value: 25.0}]
  drive_torque: [{at: 0.05, value: 25.0}]
  speed: [{at: 0.15, value: 410.0}]
"""


class Operator:
    """Calls the gearbox's services and hears its events and the commands in force."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("operator", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events: list[dict[str, Any]] = []
        self.in_force: list[Commands] = []
        kinds = {"event": (String, self._hear), "applied_command": (JointState, self._apply)}
        for key, (kind, take) in kinds.items():
            every = quality(TOPICS[key])
            every.depth = 100
            self.node.create_subscription(kind, resolve(TOPICS[key]), take, every)
        load = TOPICS["load_torque_command"]
        self.load = self.node.create_publisher(Float64, resolve(load), quality(load))

    def _hear(self, message: String) -> None:
        self.events.append(json.loads(message.data))

    def _apply(self, message: JointState) -> None:
        self.in_force.append(applied_commands(message))

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "the awaited never came"
            self.executor.spin_once(timeout_sec=0.05)

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        client = self.node.create_client(kind, f"/gearbox/{name}")
        assert client.wait_for_service(PATIENCE)
        future = client.call_async(request or kind.Request())
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def told(self, kind: str) -> bool:
        """Whether an event of that kind was heard."""
        return any(event["event"] == kind for event in self.events)

    def paused_by(self, run: Process) -> None:
        """Return when ``run`` has paused the gearbox."""
        self.until(lambda: self.told("pause") or run.returncode is not None)
        assert run.returncode is None, run.output

    def begin(self) -> None:
        """Put the gearbox back, and forget what it told so far."""
        self.events.clear()
        assert self.call(Trigger, "reset").success
        self.until(lambda: self.told("reset"))
        self.events.clear()
        self.in_force.clear()

    def stepping(self) -> list[float]:
        request = GetParameters.Request(names=["stepping.chunks", "stepping.timeout"])
        chunks, timeout = self.call(GetParameters, "get_parameters", request).values
        return [chunks.integer_value, timeout.double_value]


@pytest.fixture(scope="module")
def gearbox(
    module_ros_domain: int, module_process: StartProcess, tmp_path_factory: pytest.TempPathFactory
) -> Process:
    """A gearbox that all tests here may play to; it records to ``bag`` in its folder on demand."""
    folder = tmp_path_factory.mktemp("gearbox")
    run = module_process("gearbox", *OPTIONS, "-p", f"recording.path:={folder / 'bag'}")
    run.wait_for("recording to")
    return run


@pytest.fixture(scope="module")
def module_operator(gearbox: Process) -> Iterator[Operator]:
    operator = Operator()
    operator.until(lambda: operator.told("start"))
    yield operator
    operator.context.try_shutdown()


@pytest.fixture
def operator(module_operator: Operator) -> Operator:
    """The gearbox runs from its start state."""
    module_operator.begin()
    return module_operator


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """500 chunks with other commands in each: it takes long to play."""

    def act(run: Any, chunk: int) -> Commands:
        return run.engine.commands._replace(load_torque=20.0 + 1e-3 * chunk)

    return record(tmp_path_factory.mktemp("dense") / "bag", PARAMETERS, 500, act).path


def publish(process: StartProcess, bag: Path, *options: str) -> Process:
    return process("replay", "publish", bag, "--wait", str(PATIENCE), *options)


def origin(run: Process) -> int:
    """Sample at which the recording's time 0 was, as told."""
    return int(run.stdout.partition("recording is sample ")[2].split()[0])


def recorded_by(operator: Operator) -> recording.Recording:
    """The gearbox's recording, finished."""
    answer = operator.call(SetBool, "record", SetBool.Request(data=False))
    assert answer.success
    return recording.open(answer.message.removeprefix("recorded "))


def assert_same(bag: recording.Recording, other: recording.Recording, begin: int) -> None:
    """All channels but the time have the same bits, ``begin`` being the sample of ``other`` to begin at."""
    rows = bag.waveform()[:, 1:]
    again = other.waveform(begin, begin + len(rows))[:, 1:]
    assert len(rows)
    assert again.tobytes() == rows.tobytes()


def test_what_a_node_recorded_comes_out_the_same_in_lockstep(
    module_ros_domain: int, process: StartProcess, gearbox: Process, operator: Operator, tmp_path: Path
) -> None:
    (tmp_path / "profile.yaml").write_text(PROFILE)
    first = process("gearbox", *OPTIONS, "-r", "__node:=first", "-p", f"recording.path:={tmp_path / 'bag'}")
    drive = process("drive", tmp_path / "profile.yaml", "--node", "first", "--wait", str(PATIENCE))
    assert drive.wait() == 0, drive.output
    assert first.stop() == 0
    bag = recording.open(tmp_path / "bag")
    assert len(bag.commands) > 1

    run = publish(process, bag.path, "--lockstep")
    assert run.wait() == 0, run.output + gearbox.output
    assert run.stderr == ""
    assert "/gearbox goes on running, as it was found" in run.stdout
    again = recorded_by(operator)
    assert_same(bag, again, origin(run))
    shift = origin(run) - bag.first_sample
    played = [(sample - shift, commands) for sample, commands in again.commands if sample >= origin(run)]
    assert played == bag.commands[1:]  # the first are those of the parameters, in force after the reset
    assert operator.stepping() == [1, 10.0]


def test_resets_changes_and_parts_come_out_the_same(
    process: StartProcess, operator: Operator, tmp_path: Path
) -> None:
    def act(run: Any, chunk: int) -> Commands | None:
        if chunk == 5:
            run.change(updated(run.engine.parameters, {"oil.viscosity": 0.05, "operation.load_torque": 20.0}))
        if chunk == 10:
            run.reset()
        if chunk in (15, 25):
            return run.engine.commands._replace(drive_torque=20.0 + chunk)
        if chunk == 30:
            run.change(updated(run.engine.parameters, {"oil.viscosity": 2.28e-2, "stepping.chunks": 9}))
        return None

    whole = record(tmp_path / "whole", PARAMETERS, 40, act)
    before = record(tmp_path / "before", PARAMETERS, 20, act)
    after = record(tmp_path / "after", PARAMETERS, 40, act, begin=20)
    assert operator.call(SetBool, "record", SetBool.Request(data=True)).success
    assert operator.call(SetBool, "pause", SetBool.Request(data=True)).success

    first = publish(process, before.path, "--lockstep")
    assert first.wait() == 0, first.output
    assert first.stderr == ""
    second = publish(process, after.path, "--lockstep", "--no-reset")
    assert second.wait() == 0, second.output
    assert second.stderr == "replay: not played: 1 changes of pacing or stepping\n"
    assert "/gearbox stays paused, as it was found" in second.stdout
    assert origin(second) - origin(first) == after.first_sample
    assert_same(whole, recorded_by(operator), origin(first))
    assert operator.call(SetBool, "pause", SetBool.Request(data=False)).success


def test_it_follows_at_the_gearbox_own_pace(
    process: StartProcess, operator: Operator, tmp_path: Path
) -> None:
    def act(run: Any, chunk: int) -> Commands | None:
        if chunk in (30, 60):
            return run.engine.commands._replace(load_torque=float(chunk), drive_torque=25.0)
        if chunk == 80:
            run.change(updated(run.engine.parameters, {"oil.viscosity": 0.05}))
        return None

    bag = record(tmp_path / "bag", PARAMETERS, 100, act)
    run = publish(process, bag.path)
    assert run.wait() == 0, run.output
    assert run.stderr == "replay: not played: 1 parameter changes; with --lockstep resets and changes are\n"
    assert "commands published over 0.2 s of simulated time" in run.stdout
    operator.until(lambda: operator.in_force[-1:] == [Commands(25.0, 60.0, 400.0)])
    assert [event["event"] for event in operator.events] == ["reset"]
    loads = [commands.load_torque for commands in operator.in_force]
    assert loads.index(30.0) < loads.index(60.0)

    operator.events.clear()
    run = publish(process, bag.path, "--no-reset")
    assert run.wait() == 0, run.output
    assert operator.call(Trigger, "reset").success
    operator.until(lambda: bool(operator.events))
    assert [event["event"] for event in operator.events] == ["reset"]


def test_an_interrupted_lockstep_leaves_the_gearbox_as_it_was(
    process: StartProcess, operator: Operator, dense: Path
) -> None:
    run = publish(process, dense, "--lockstep")
    operator.paused_by(run)
    run.signal_group(signal.SIGINT)
    assert run.wait() == 130, run.output
    (line,) = run.stderr.splitlines()
    assert line.startswith("replay: interrupted by SIGINT at ")
    assert line.endswith(" s of the recording's 1 s")
    assert "/gearbox goes on running, as it was found" in run.stdout
    operator.until(lambda: operator.told("resume"))
    assert operator.stepping() == [1, 10.0]


def test_somebody_else_who_commands_is_noticed(
    process: StartProcess, operator: Operator, dense: Path
) -> None:
    run = publish(process, dense, "--lockstep")
    operator.paused_by(run)
    while run.returncode is None:
        operator.load.publish(Float64(data=-5.0))
        operator.executor.spin_once(timeout_sec=0.0)
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert "load -5 N m" in line and "somebody else commands it" in line


def test_commands_that_the_gearbox_refuses_are_told(
    process: StartProcess, operator: Operator, tmp_path: Path
) -> None:
    fast = updated(PARAMETERS, {"operation.speed_limit": 9000.0})
    bag = record(tmp_path / "bag", fast, 5, lambda run, _: run.engine.commands._replace(speed=6000.0))
    run = publish(process, bag.path, "--lockstep", "--timeout", "2")
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert "it may have refused one" in line
    assert operator.stepping() == [1, 10.0]


def test_commands_within_chunks_are_refused_before_anything_is_done(
    process: StartProcess, operator: Operator, tmp_path: Path
) -> None:
    fine = updated(PARAMETERS, {"solver.chunk": 1e-3})

    def act(run: Any, chunk: int) -> Commands | None:
        return run.engine.commands._replace(load_torque=25.0) if chunk == 3 else None

    bag = record(tmp_path / "bag", fine, 5, act)
    run = publish(process, bag.path, "--lockstep")
    assert run.wait() == 2, run.output
    (line,) = run.stderr.splitlines()
    assert "solver.chunk = 0.002 s" in line and line.endswith("solver.chunk = 0.001 s")
    assert not operator.events


def test_an_absent_gearbox_and_impossible_options_are_told(
    module_ros_domain: int, process: StartProcess, dense: Path
) -> None:
    absent = publish(process, dense, "--node", "nobody", "--wait", "0.5", "--lockstep")
    misnamed = publish(process, dense, "--node", "no body")
    misread = publish(process, dense, "--ros-args", "-r", "nonsense")
    assert absent.wait() == 1
    assert "no gearbox /nobody was seen for 0.5 s" in absent.stderr
    assert misnamed.wait() == misread.wait() == 2
    assert "--node is '/no body'" in misnamed.stderr
    assert "nonsense" in misread.stderr
