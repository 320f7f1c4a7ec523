"""What every player to a gearbox over ROS 2 needs: a context, and signals that break off in order."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.signals import SignalHandlerOptions

from gear_dynamics_ros.discovery import stay_local
from gear_dynamics_ros.errors import UsageError


@contextmanager
def noted_signals() -> Iterator[list[int]]:
    """The signals that came, which so break nothing off by themselves: look there between short waits.

    For the main thread.
    """
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
