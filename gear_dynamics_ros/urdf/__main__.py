"""``python -m gear_dynamics_ros.urdf``: print the URDF of a gearbox."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.cli.options import add_settings
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import GEARBOX_NODE_NAME, load_parameters
from gear_dynamics_ros.system.command import run_command
from gear_dynamics_ros.system.share import share_file
from gear_dynamics_ros.urdf.description import HARDWARE_PLUGINS, robot_description


def urdf_main(argv: Sequence[str] | None = None) -> int:
    """Print the URDF; returns the exit code."""
    parser = argparse.ArgumentParser(prog="urdf", description="Print the URDF of a gearbox.")
    parser.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    add_settings(parser)
    parser.add_argument(
        "--node",
        default=GEARBOX_NODE_NAME,
        metavar="NAME",
        help="full name of the gearbox's node (default: %(default)s)",
    )
    parser.add_argument(
        "--plugin",
        choices=HARDWARE_PLUGINS,
        default=HARDWARE_PLUGINS[0],
        help="plugin that ros2_control loads (default: %(default)s)",
    )
    return run_command(_print_urdf, parser, argv)


def _print_urdf(arguments: argparse.Namespace) -> int:
    if not arguments.node.startswith("/") or arguments.node.endswith("/"):
        raise UsageError(
            f"--node is {arguments.node!r}, not the full name of a node: write it like {GEARBOX_NODE_NAME}"
        )
    parameters = load_parameters(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)
    print(robot_description(parameters, arguments.node, arguments.plugin), end="")
    return 0


if __name__ == "__main__":
    sys.exit(urdf_main())
