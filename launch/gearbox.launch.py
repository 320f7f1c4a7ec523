"""Start the gearbox: ``ros2 launch gear_dynamics_ros gearbox.launch.py params_file:=FILE name:=NAME``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    default_parameters = Path(get_package_share_directory("gear_dynamics_ros")) / "config" / "gearbox.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("name", default_value="gearbox", description="name of the node"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
            DeclareLaunchArgument(
                "params_file", default_value=str(default_parameters), description="ROS parameter file"
            ),
            Node(
                package="gear_dynamics_ros",
                executable="gearbox",
                name=LaunchConfiguration("name"),
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
                # A recording is finalised on SIGINT; leave it the time.
                sigterm_timeout="30",
                sigkill_timeout="30",
            ),
        ]
    )
