"""Start the gearbox: ``ros2 launch gear_dynamics_ros gearbox.launch.py params_file:=FILE name:=NAME``.

With ``viewer:=true`` a Rerun viewer shows it.
"""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

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
            ExecuteProcess(
                cmd=["rerun", "--bind", "127.0.0.1", "--port", VIEWER_PORT], condition=IfCondition(viewer)
            ),
            _gearbox([LaunchConfiguration("params_file"), feeding], IfCondition(viewer)),
            _gearbox([LaunchConfiguration("params_file")], UnlessCondition(viewer)),
        ]
    )


def _gearbox(parameters: list[Any], condition: Any) -> Node:
    return Node(
        package="gear_dynamics_ros",
        executable="gearbox",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        parameters=parameters,
        condition=condition,
        output="screen",
        # The node completes its recording on SIGINT, which takes time.
        sigterm_timeout="30",
        sigkill_timeout="30",
    )
