"""The process of the node ``gearbox``: arguments, signals, spinning, exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from gear_dynamics_ros.errors import UsageError, one_line
from gear_dynamics_ros.ros.discovery import start_failure, stay_local
from gear_dynamics_ros.ros.node import GearboxNode
from gear_dynamics_ros.simulation.warm_up import warm_up
from gear_dynamics_ros.system.command import FAILURE, run_reporting
from gear_dynamics_ros.system.processes import Signals, ignore_signals
from gear_dynamics_ros.system.threads import share_lock_promptly, wake_punctually

SPIN = 1.0  # longest wait for callbacks, s


def run_gearbox_node(argv: Sequence[str] | None = None) -> int:
    """Run the node until it is stopped; returns the exit code."""
    signals = Signals()
    return run_reporting(lambda: _serve(argv, signals), "gearbox")


def _serve(argv: Sequence[str] | None, signals: Signals) -> int:
    stay_local()
    try:
        rclpy.init(
            args=None if argv is None else ["gearbox", *argv], signal_handler_options=SignalHandlerOptions.NO
        )
    except Exception as error:  # rclpy has no common class for errors of arguments and files
        raise UsageError(f"ROS did not start: {start_failure(error)}") from error
    try:
        return _spin(signals)
    finally:
        ignore_signals()
        try_shutdown()


def _spin(signals: Signals) -> int:
    wake_punctually()
    share_lock_promptly()
    executor = _executor()
    reasons: list[str] = []

    def stop(reason: str) -> None:
        reasons.append(reason)
        executor.wake()

    node = _node(stop)
    try:
        log: Any = node.get_logger()  # type: ignore[no-untyped-call]
        warm_up(log.info, log.warning)
        signals.report_to(stop)
        executor.add_node(node)
        if node.parameters.autostart:
            node.bring_up()
        while not reasons:
            executor.spin_once(timeout_sec=SPIN)
    finally:
        node.end(reasons[0] if reasons else "failed")
        node.destroy_node()  # type: ignore[no-untyped-call]
    return FAILURE if node.recording_failed else 0


def _executor() -> Executor:
    """The events executor, if rclpy has it: the other one takes many times as long for a request."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def _node(stop: Callable[[str], None]) -> GearboxNode:
    try:
        return GearboxNode(stop)
    except RuntimeError as error:
        raise UsageError(f"ROS did not start: {start_failure(error)}") from error
    except (ValueError, NameValidationException) as error:
        remedy = "an array must have an entry, a name must be one of ROS"
        raise UsageError(f"ROS arguments: {one_line(error)}: {remedy}") from error
