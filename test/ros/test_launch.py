"""The launch files, carried out on stand-ins for `launch`, which is not on the package index: what they start
is compared with the real executables, arguments and parameters of the package."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from gear_dynamics_ros.cli import drive
from gear_dynamics_ros.parameters import Parameters
from support.paths import ROOT
from support.processes import StartProcess

MODULES: Mapping[str, tuple[str, ...]] = {
    "ament_index_python.packages": (),
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": (
        "DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription", "OpaqueFunction", "Shutdown",
    ),
    "launch.conditions": ("IfCondition", "UnlessCondition"),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros.actions": ("Node",),
}  # fmt: skip


class Action:
    """Keeps what it was made of; a LaunchConfiguration looks itself up in the context."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments = arguments
        self.options = options

    def perform(self, context: Mapping[str, str]) -> str:
        return context[self.arguments[0]]


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, classes in MODULES.items():
        module = ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (Action,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(
        sys.modules["ament_index_python.packages"],
        "get_package_share_directory",
        lambda package: str(ROOT),
        raising=False,
    )


def actions(path: Path) -> list[Any]:
    (entities,) = runpy.run_path(str(path))["generate_launch_description"]().arguments
    return list(entities)


def of_kind(kind: str, entities: list[Any]) -> list[Any]:
    return [entity for entity in entities if type(entity).__name__ == kind]


def defaults(entities: list[Any]) -> dict[str, str]:
    declared = of_kind("DeclareLaunchArgument", entities)
    return {action.arguments[0]: action.options["default_value"] for action in declared}


def started_drive(**chosen: str) -> Any:
    """The drive that harness.launch.py starts; what is not ``chosen`` has its default."""
    entities = actions(ROOT / "launch" / "harness.launch.py")
    (include,) = of_kind("IncludeLaunchDescription", entities)
    included = actions(Path(include.arguments[0].arguments[0]))
    (function,) = of_kind("OpaqueFunction", entities)
    (node,) = function.options["function"]({**defaults(included), **defaults(entities), **chosen})
    return node


def test_the_gearbox_is_started_with_or_without_a_viewer() -> None:
    entities = actions(ROOT / "launch" / "gearbox.launch.py")
    assert Path(defaults(entities)["params_file"]).is_file()
    watched, alone = of_kind("Node", entities)
    (viewer,) = of_kind("ExecuteProcess", entities)
    conditions = [type(action.options["condition"]).__name__ for action in (watched, alone, viewer)]
    assert conditions == ["IfCondition", "UnlessCondition", "IfCondition"]
    assert "127.0.0.1" in viewer.options["cmd"]
    scripts = metadata.distribution("gear_dynamics_ros").entry_points.select(group="console_scripts").names
    assert watched.options["executable"] in scripts
    (overrides,) = watched.options["parameters"]
    assert Parameters.from_flat(overrides).rerun.mode == "connect"
    assert viewer.options["cmd"][-1] in overrides["rerun.url"]


def gearbox_words(**chosen: str) -> list[str]:
    """The ROS arguments with which gearbox.launch.py starts the gearbox."""
    entities = actions(ROOT / "launch" / "gearbox.launch.py")
    values = {**defaults(entities), **chosen}
    *_, node = of_kind("Node", entities)
    words = node.options["ros_arguments"]
    return [word if isinstance(word, str) else word.perform(values) for word in words]


def test_a_file_of_parameters_that_does_not_exist_stops_the_gearbox(
    ros_domain: int, process: StartProcess
) -> None:
    gearbox = process("gearbox", "--ros-args", *gearbox_words(params_file="mistyped.yaml"))
    assert gearbox.wait() == 2
    assert "mistyped.yaml" in gearbox.stderr.splitlines()[-1]


def test_launch_ends_in_an_error_if_the_gearbox_failed() -> None:
    for node in of_kind("Node", actions(ROOT / "launch" / "gearbox.launch.py")):
        end = node.options["on_exit"]
        assert end(SimpleNamespace(returncode=0), {}) is None
        with pytest.raises(RuntimeError, match="the gearbox ended with exit code 2"):
            end(SimpleNamespace(returncode=2), {})


def test_a_missing_viewer_is_told_before_anything_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    entities = actions(ROOT / "launch" / "gearbox.launch.py")
    (check,) = of_kind("OpaqueFunction", entities)
    (viewer,) = of_kind("ExecuteProcess", entities)
    assert entities.index(check) < entities.index(viewer)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(RuntimeError, match="viewer:=true, but the program rerun is not in PATH"):
        check.options["function"]({})


def test_drive_understands_what_it_is_started_with() -> None:
    node = started_drive()
    assert node.options["executable"] == "drive"
    arguments = drive._parser().parse_args(node.options["arguments"])
    assert arguments.profile.is_file()
    assert (arguments.node, arguments.junit) == ("/gearbox", None)
    node = started_drive(profile="my.yaml", junit="results.xml", namespace="rig", name="left")
    arguments = drive._parser().parse_args(node.options["arguments"])
    assert (arguments.profile, arguments.junit) == (Path("my.yaml"), Path("results.xml"))
    assert arguments.node == "/rig/left"
    assert arguments.play is not drive._play_in_lockstep
    node = started_drive(lockstep="true")
    arguments = drive._parser().parse_args(node.options["arguments"])
    assert arguments.play is drive._play_in_lockstep


def test_launch_ends_with_drive_and_in_an_error_if_it_failed() -> None:
    end = started_drive().options["on_exit"]
    (shutdown,) = end(SimpleNamespace(returncode=0), {})
    assert type(shutdown).__name__ == "Shutdown"
    with pytest.raises(RuntimeError, match="drive ended with exit code 1"):
        end(SimpleNamespace(returncode=1), {})
