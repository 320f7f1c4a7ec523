"""Priority, processors and memory of the real node, as the system tells them."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import PacingParameters, Parameters
from gear_dynamics_ros.realtime.scheduling import require_schedulable
from support.gearbox import Client, start_gearbox
from support.processes import StartProcess

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has these settings")

CAPABILITIES = {"CAP_IPC_LOCK": 14, "CAP_SYS_NICE": 23}
PR_CAPBSET_DROP = 24


def threads(pid: int) -> dict[str, int]:
    """Numbers of the threads of a process by their names."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return {(task / "comm").read_text(encoding="utf-8").strip(): int(task.name) for task in tasks}


PROBE = """
from gear_dynamics_ros.parameters import PacingParameters
from gear_dynamics_ros.realtime.scheduling import require_schedulable

require_schedulable(PacingParameters(priority=20, lock_memory=True))
"""


def test_the_engine_alone_gets_priority_and_processor(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    processor = min(os.sched_getaffinity(0))
    probe = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, timeout=120)
    if probe.returncode:
        pytest.skip(probe.stderr.splitlines()[-1])
    node = start_gearbox(
        process,
        "pacing.priority:=20",
        f"pacing.processors:='{processor}'",
        "pacing.lock_memory:=true",
        f"recording.path:={tmp_path / 'bag'}",
    )
    with Client(hears=["event", "applied_command"]) as client:
        client.in_force()
        assert client.switch("record", False).success
        assert client.switch("record", True).success  # begun on the engine's thread
        found = threads(node.pid)
        assert os.sched_getscheduler(found["engine"]) == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        assert os.sched_getparam(found["engine"]).sched_priority == 20
        assert os.sched_getaffinity(found["engine"]) == {processor}
        for name, number in found.items():
            if name != "engine":
                assert os.sched_getscheduler(number) == os.SCHED_OTHER, name
                assert os.sched_getaffinity(number) == os.sched_getaffinity(node.pid), name
        locked = next(line for line in status_lines(node.pid) if line.startswith("VmLck"))
        assert int(locked.split()[1]) > 100_000  # kB
        node.signal(signal.SIGINT)
        assert node.wait() == 0, node.output


def status_lines(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize(
    ("setting", "remedy"),
    [("pacing.priority:=20", "grant CAP_SYS_NICE"), ("pacing.lock_memory:=true", "raise the limit memlock")],
)
def test_what_the_system_refuses_is_told_before_anything_is_recorded(
    ros_domain: int, tmp_path: Path, setting: str, remedy: str
) -> None:
    """The node without the capabilities of root and with its limits at 0."""
    bag = tmp_path / "bag"
    words = ("--ros-args", "-p", setting, "-p", f"recording.path:={bag}")
    done = subprocess.run(
        [sys.executable, "-m", "gear_dynamics_ros.cli.gearbox", *words],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=give_up_capabilities,
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("\n") == 1
    name = setting.partition(":=")[0]
    assert f"gearbox: error: {name} = " in done.stderr and remedy in done.stderr
    assert not bag.exists()


def give_up_capabilities() -> None:
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK):
        resource.setrlimit(limit, (0, 0))
    for capability in CAPABILITIES.values():
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)  # fails for who has none


def test_processors_that_are_not_there_are_told() -> None:
    with pytest.raises(GearboxError, match=r"pacing\.processors = '4000' is refused by the system \(Invalid"):
        require_schedulable(PacingParameters(processors="4000"))


@pytest.mark.parametrize(("text", "numbers"), [("", set()), ("2", {2}), ("0, 2-4", {0, 2, 3, 4})])
def test_processors_are_a_list_of_ranges(text: str, numbers: set[int]) -> None:
    assert PacingParameters(processors=text).processor_numbers == numbers
    Parameters.from_flat({"pacing.processors": text})


@pytest.mark.parametrize("text", ["two", "1-", "-1", "3-2", "0,3-2", "1.5", ",", "0-1000000000000"])
def test_what_is_no_list_of_processors_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not a list of processors: write numbers and ranges"):
        Parameters.from_flat({"pacing.processors": text})


def test_a_priority_without_a_pace_is_refused() -> None:
    with pytest.raises(UsageError, match="would leave no other thread its processor"):
        Parameters.from_flat({"pacing.priority": 1, "pacing.real_time_factor": 0.0})
