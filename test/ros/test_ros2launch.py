"""The launch files, carried out by ``ros2 launch``, where an installation of ROS 2 has it."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from gear_dynamics_ros import recording
from support.paths import ROOT
from support.processes import Process, StartProcess, executable, until

ROS2 = shutil.which("ros2")
PROFILE = """
duration: 0.2
commands: {load_torque: [{at: 0.0, value: 30.0}]}
"""

pytestmark = pytest.mark.skipif(ROS2 is None, reason="ros2 is not installed: it is not among the ROS wheels")
Launch = Callable[..., Process]


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """This checkout, laid out as an installation."""
    prefix = tmp_path / "prefix"
    for folder in ("share/ament_index/resource_index/packages", "lib"):
        (prefix / folder).mkdir(parents=True)
    (prefix / "share/ament_index/resource_index/packages/gear_dynamics_ros").touch()
    (prefix / "share/gear_dynamics_ros").symlink_to(ROOT)
    shutil.copytree(ROOT / "executables", prefix / "lib/gear_dynamics_ros")
    (prefix / "bin").symlink_to(Path(executable("gearbox")).parent)
    return prefix


@pytest.fixture
def launch(ros_domain: int, prefix: Path, process: StartProcess) -> Launch:
    known = os.environ.get("AMENT_PREFIX_PATH", "")

    def start(name: str, *arguments: str, **environment: str) -> Process:
        assert ROS2 is not None
        environment["AMENT_PREFIX_PATH"] = f"{prefix}:{known}"
        return process(ROS2, "launch", ROOT / "launch" / name, *arguments, **environment)

    return start


def parameter_file(folder: Path, line: str) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {line}\n")
    return path


def test_a_profile_is_played_to_its_end(launch: Launch, tmp_path: Path) -> None:
    profile = tmp_path / "profile.yaml"
    profile.write_text(PROFILE)
    run = launch("harness.launch.py", f"profile:={profile}")
    assert run.wait() == 0, run.output
    assert "joined at simulated time" in run.output


@pytest.mark.parametrize("name", ["gearbox.launch.py", "harness.launch.py"])
def test_a_mistyped_file_of_parameters_ends_the_launch(launch: Launch, name: str) -> None:
    run = launch(name, "params_file:=/mistyped.yaml")
    assert run.wait() == 1
    assert "gearbox: error: ROS did not start" in run.output and "/mistyped.yaml" in run.output
    assert "the gearbox ended with exit code 2" in run.output


def test_a_gearbox_that_dies_ends_the_launch(launch: Launch, tmp_path: Path) -> None:
    run = launch("harness.launch.py", f"params_file:={parameter_file(tmp_path, 'oil.viscosity: -1.0')}")
    assert run.wait() == 1
    assert "oil.viscosity = -1.0 is out of range" in run.output
    assert "the gearbox ended with exit code 2" in run.output


def test_a_terminated_launch_leaves_a_complete_recording_and_no_gearbox(
    launch: Launch, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    run = launch("gearbox.launch.py", f"params_file:={parameter_file(tmp_path, f'recording.path: {bag}')}")
    run.wait_for("recording to")
    run.signal(signal.SIGTERM)
    until((bag / "metadata.yaml").exists, "the recording is finished")
    assert recording.open(bag).complete


def test_a_viewer_that_is_not_installed_is_told_in_one_line(launch: Launch, tmp_path: Path) -> None:
    run = launch("gearbox.launch.py", "viewer:=true", PATH=str(tmp_path))
    assert run.wait() == 1
    assert "viewer:=true, but the program rerun is not in PATH" in run.output
    assert "Traceback" not in run.output
    assert "process started" not in run.output
