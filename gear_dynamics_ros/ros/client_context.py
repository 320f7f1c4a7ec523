"""What every player to a gearbox over ROS 2 needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.signals import SignalHandlerOptions

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.ros.discovery import stay_local


@contextmanager
def ros_context(node: str, arguments: Sequence[str]) -> Iterator[Context]:
    """A context to make entities below the name ``node`` in; ``arguments`` are those from --ros-args on.

    Raises UsageError where ROS can't read them, or on an impossible name.
    """
    stay_local()
    context = Context()
    try:
        rclpy.init(args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # what rclpy raises on arguments it can't read
        raise UsageError(f"ROS did not start: {' '.join(str(error).split())}") from error
    try:
        yield context
    except (InvalidTopicNameException, InvalidServiceNameException) as error:
        raise UsageError(f"--node is {node!r}, no name of a ROS node: give one like /gearbox") from error
    finally:
        context.try_shutdown()
