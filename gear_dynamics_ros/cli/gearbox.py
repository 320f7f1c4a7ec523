"""``gearbox``: the virtual gearbox as a ROS 2 node."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from gear_dynamics_ros.system.command import FAILURE


def gearbox_main(argv: Sequence[str] | None = None) -> int:
    """Run the node until it is stopped; returns the exit code."""
    try:
        from gear_dynamics_ros.ros.node_process import run_gearbox_node
    except ModuleNotFoundError as error:
        if error.name != "rclpy":
            raise
        remedy = "source your ROS 2 installation, or pip install 'gear_dynamics_ros[ros]'"
        print(f"gearbox: error: rclpy: not found; {remedy}", file=sys.stderr)
        return FAILURE
    return run_gearbox_node(argv)


if __name__ == "__main__":
    sys.exit(gearbox_main())
