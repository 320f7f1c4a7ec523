"""`replay publish` against the real node over DDS: bit for bit in lockstep, near enough when it follows."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from std_msgs.msg import Float64

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.messages.decoder import applied_commands
from gear_dynamics_ros.parameters import Parameters, change_values, updated
from support.gearbox import PATIENCE, Client, start_gearbox
from support.processes import Process, StartProcess
from support.recordings import record

# A viscous load, so that no command makes the speed run away.
SETTINGS = {
    "operation.control": "torque",
    "operation.speed": 400.0,
    "operation.drive_torque": 60.0,
    "operation.load_torque": 20.0,
    "operation.load_viscous": 0.1,
}
PARAMETERS = updated(Parameters(), SETTINGS)
PROFILE = """
duration: 0.3
commands:
  load_torque: [{at: 0.0, value: 20.0}, {from: 0.1, to: 0.2, value: 25.0}]
  drive_torque: [{at: 0.05, value: 25.0}]
  speed: [{at: 0.15, value: 410.0}]
"""


class Operator(Client):
    """The shared gearbox's operator."""

    def told(self, kind: str) -> bool:
        """Whether an event of that kind was heard."""
        return any(event["event"] == kind for event in self.events())

    def told_before_a_pause(self) -> list[str]:
        """Kinds of all events so far; pauses the gearbox, which tells so after them."""
        assert self.switch("pause", True).success
        self.until(lambda: self.told("pause"))
        kinds = [event["event"] for event in self.events()]
        assert kinds.pop() == "pause"
        return kinds

    def paused_by(self, run: Process) -> None:
        """Return when ``run`` has paused the gearbox."""
        self.until(lambda: self.told("pause") or run.returncode is not None)
        assert run.returncode is None, run.output

    def loads(self) -> list[float]:
        """Load torques that were in force, in order."""
        return [applied_commands(message).load_torque for message in self.heard["applied_command"]]

    def stepping(self) -> list[float]:
        return list(self.get_all(["stepping.chunks", "stepping.timeout"]).values())


class Shared(NamedTuple):
    """A running gearbox that records to ``bag`` in a folder on demand."""

    process: Process
    operator: Operator
    parameters: dict[str, Any]


@pytest.fixture(scope="module")
def shared(
    module_ros_domain: int, module_process: StartProcess, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Shared]:
    path = tmp_path_factory.mktemp("gearbox") / "bag"
    words = (f"{name}:={value}" for name, value in SETTINGS.items())
    process = start_gearbox(module_process, *words, f"recording.path:={path}")
    with Operator(hears=("event", "applied_command")) as operator:
        operator.in_force()
        yield Shared(process, operator, operator.changeable())


@pytest.fixture
def gearbox(shared: Shared) -> Process:
    return shared.process


@pytest.fixture
def operator(shared: Shared) -> Operator:
    """The shared gearbox has just begun anew and records nothing."""
    shared.operator.switch("record", False)
    shared.operator.put_back(shared.parameters)
    shared.operator.heard["event"].clear()
    return shared.operator


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
    answer = operator.switch("record", False)
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
    words = (f"{name}:={value}" for name, value in SETTINGS.items())
    bag_path = f"recording.path:={tmp_path / 'bag'}"
    first = start_gearbox(process, *words, bag_path, remap=["__node:=first"])
    drive = process("drive", tmp_path / "profile.yaml", "--node", "first", "--wait", str(PATIENCE))
    assert drive.wait() == 0, drive.output
    assert first.stop() == 0
    bag = recording.open(tmp_path / "bag")
    assert len(bag.commands) > 1

    assert operator.switch("record", True).success
    run = publish(process, bag.path, "--lockstep")
    assert run.wait() == 0, run.output + gearbox.output
    assert run.stderr == ""
    assert "/gearbox runs again, as before" in run.stdout
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
            run.change(
                change_values(run.engine.parameters, {"oil.viscosity": 0.05, "operation.load_torque": 20.0})
            )
        if chunk == 10:
            run.reset()
        if chunk in (15, 25):
            return run.engine.commands._replace(drive_torque=20.0 + chunk)
        if chunk == 30:
            run.change(change_values(run.engine.parameters, {"oil.viscosity": 2.28e-2, "stepping.chunks": 9}))
        return None

    whole = record(tmp_path / "whole", PARAMETERS, 40, act)
    before = record(tmp_path / "before", PARAMETERS, 20, act)
    after = record(tmp_path / "after", PARAMETERS, 40, act, begin=20)
    assert operator.switch("record", True).success
    assert operator.switch("pause", True).success

    first = publish(process, before.path, "--lockstep")
    assert first.wait() == 0, first.output
    assert first.stderr == ""
    second = publish(process, after.path, "--lockstep", "--no-reset")
    assert second.wait() == 0, second.output
    assert second.stderr == "replay: not played: 1 changes of pacing or stepping\n"
    assert "/gearbox stays paused, as before" in second.stdout
    assert origin(second) - origin(first) == after.first_sample
    assert_same(whole, recorded_by(operator), origin(first))
    assert operator.switch("pause", False).success


def test_it_follows_at_the_gearbox_own_pace(
    process: StartProcess, operator: Operator, tmp_path: Path
) -> None:
    def act(run: Any, chunk: int) -> Commands | None:
        if chunk in (30, 60):
            return run.engine.commands._replace(load_torque=float(chunk), drive_torque=25.0)
        if chunk == 80:
            run.change(change_values(run.engine.parameters, {"oil.viscosity": 0.05}))
        return None

    bag = record(tmp_path / "bag", PARAMETERS, 100, act)
    run = publish(process, bag.path)
    assert run.wait() == 0, run.output
    assert run.stderr == "replay: not played: 1 parameter changes; with --lockstep resets and changes are\n"
    assert "commands published over 0.2 s of simulated time" in run.stdout
    operator.until(lambda: operator.loads()[-1:] == [60.0])
    assert operator.in_force() == Commands(25.0, 60.0, 400.0)
    assert [event["event"] for event in operator.events()] == ["reset"]
    loads = operator.loads()
    assert loads.index(30.0) < loads.index(60.0)

    operator.heard["event"].clear()
    run = publish(process, bag.path, "--no-reset")
    assert run.wait() == 0, run.output
    assert operator.told_before_a_pause() == []


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
    assert "/gearbox runs again, as before" in run.stdout
    operator.until(lambda: operator.told("resume"))
    assert operator.stepping() == [1, 10.0]


def test_somebody_else_who_commands_is_noticed(
    process: StartProcess, operator: Operator, dense: Path
) -> None:
    run = publish(process, dense, "--lockstep")
    operator.paused_by(run)
    while run.returncode is None:
        operator.publishers["load_torque_command"].publish(Float64(data=-5.0))
        operator.executor.spin_once(timeout_sec=0.0)
    assert run.wait() == 1, run.output
    (line,) = run.stderr.splitlines()
    assert "load -5 N m" in line and "another client commands it" in line


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
    assert operator.told_before_a_pause() == []


def test_an_absent_gearbox_and_impossible_options_are_told(
    ros_domain: int, process: StartProcess, dense: Path
) -> None:
    absent = publish(process, dense, "--node", "nobody", "--wait", "0.5", "--lockstep")
    misnamed = publish(process, dense, "--node", "no body")
    misread = publish(process, dense, "--ros-args", "-r", "nonsense")
    assert absent.wait() == 1
    assert "no gearbox /nobody was seen for 0.5 s" in absent.stderr
    assert misnamed.wait() == misread.wait() == 2
    assert "--node is '/no body'" in misnamed.stderr
    assert "nonsense" in misread.stderr
