"""Start the gearbox: ``ros2 launch gear_dynamics_ros gearbox.launch.py params_file:=FILE name:=NAME``.

With ``viewer:=true`` a Rerun viewer shows it. The exit code is 1 if the gearbox fails, else 0.
"""

import shutil
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

VIEWER = "rerun"
VIEWER_PORT = "9876"


def generate_launch_description() -> LaunchDescription:
    default_parameters = Path(get_package_share_directory("gear_dynamics_ros")) / "config" / "gearbox.yaml"
    viewer = LaunchConfiguration("viewer")
    # The gearbox sends data as soon as the viewer answers, so the order of the two starts does not matter.
    feeding = {"rerun.mode": "connect", "rerun.url": f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"}
    return LaunchDescription(
        [
            DeclareLaunchArgument("name", default_value="gearbox", description="name of the node"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
            DeclareLaunchArgument(
                "params_file", default_value=str(default_parameters), description="ROS parameter file"
            ),
            DeclareLaunchArgument(
                "viewer", default_value="false", description="whether to start a Rerun viewer"
            ),
            OpaqueFunction(function=_require_viewer, condition=IfCondition(viewer)),
            ExecuteProcess(
                cmd=[VIEWER, "--bind", "127.0.0.1", "--port", VIEWER_PORT], condition=IfCondition(viewer)
            ),
            _gearbox([feeding], IfCondition(viewer)),
            _gearbox([], UnlessCondition(viewer)),
        ]
    )


def _require_viewer(context: LaunchContext) -> None:
    if shutil.which(VIEWER) is None:
        raise RuntimeError(f"viewer:=true, but the program {VIEWER} is not in PATH: pip install rerun-sdk")


def _gearbox(overrides: list[dict[str, str]], condition: Any) -> Node:
    return Node(
        package="gear_dynamics_ros",
        executable="gearbox",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        # Not in parameters: there launch leaves a file out that does not exist. The gearbox refuses it.
        ros_arguments=["--params-file", LaunchConfiguration("params_file")],
        parameters=overrides,
        condition=condition,
        output="screen",
        on_exit=_end,
        # The node completes its recording on SIGINT, which takes time.
        sigterm_timeout="30",
        sigkill_timeout="30",
    )


def _end(event: Any, context: LaunchContext) -> None:
    """An error ends the launch, and is the only way to make ``ros2 launch`` exit with a code other than 0."""
    if event.returncode != 0:
        raise RuntimeError(f"the gearbox ended with exit code {event.returncode}, see above")
