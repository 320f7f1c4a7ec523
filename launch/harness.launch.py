"""Start a gearbox and play a profile: ``ros2 launch gear_dynamics_ros harness.launch.py profile:=FILE``.

It also takes the arguments of gearbox.launch.py. It ends with the profile, or with a gearbox that
fails. The exit code is 0 if the profile was played to its end and all expectations passed, else 1.
"""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory("gear_dynamics_ros"))
    profile = share / "config" / "profiles" / "load_step.yaml"
    gearbox = share / "launch" / "gearbox.launch.py"
    return LaunchDescription(
        [
            DeclareLaunchArgument("profile", default_value=str(profile), description="profile to play"),
            DeclareLaunchArgument(
                "junit", default_value="", description="file for the results as JUnit XML; empty: none"
            ),
            DeclareLaunchArgument(
                "report", default_value="", description="file for the report, an HTML page; empty: none"
            ),
            DeclareLaunchArgument(
                "lockstep",
                default_value="false",
                description="true: step the gearbox, so that each command acts at exactly its sample",
            ),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(str(gearbox))),
            OpaqueFunction(function=_drive),
        ]
    )


def _drive(context: LaunchContext) -> list[Node]:
    chosen = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("profile", "junit", "report", "lockstep", "namespace", "name")
    }
    node = f"/{chosen['namespace'].strip('/')}/{chosen['name']}".replace("//", "/")
    # How long the start of the gearbox takes does not count. If it fails, its launch file ends the launch.
    arguments = [chosen["profile"], "--node", node, "--wait", "60"]
    if chosen["lockstep"].lower() in ("true", "1"):
        arguments.append("--lockstep")
    for option in ("junit", "report"):
        if chosen[option]:
            arguments += [f"--{option}", chosen[option]]
    return [
        Node(
            package="gear_dynamics_ros",
            executable="drive",
            arguments=arguments,
            output="screen",
            on_exit=_end,
        )
    ]


def _end(event: Any, context: LaunchContext) -> list[Shutdown]:
    """An error is the only way to make ``ros2 launch`` exit with a code other than 0."""
    if event.returncode != 0:
        raise RuntimeError(f"drive ended with exit code {event.returncode}, see above")
    return [Shutdown(reason="the profile was played, all expectations passed")]
