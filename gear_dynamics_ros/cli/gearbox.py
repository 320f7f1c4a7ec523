"""``gearbox``: the virtual gearbox as a ROS 2 node."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from gear_dynamics_ros.cli.ros import needing_ros, split_ros_arguments
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.system.command import FAILURE


def gearbox_main(argv: Sequence[str] | None = None) -> int:
    """Run the node until it is stopped; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="gearbox",
        description="The virtual gearbox as a ROS 2 node. Parameters: --ros-args --params-file FILE, "
        "--ros-args -p name:=value.",
    )
    own, _ = split_ros_arguments(sys.argv[1:] if argv is None else argv)
    parser.parse_args(own)
    try:
        # Imported here: help needs neither ROS nor the kernel.
        with needing_ros():
            from gear_dynamics_ros.ros.node_process import run_gearbox_node
    except GearboxError as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return FAILURE
    return run_gearbox_node(argv)


if __name__ == "__main__":
    sys.exit(gearbox_main())
