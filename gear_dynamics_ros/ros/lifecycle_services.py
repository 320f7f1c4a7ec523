"""The services of the life cycle, with a queue as long as that of the other services of the node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.lifecycle import LifecycleNodeMixin
from rclpy.node import Node

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.ros.deferred_answers import SERVICE_QUALITY

KINDS: dict[str, Any] = {
    "change_state": ChangeState,
    "get_state": GetState,
    "get_available_states": GetAvailableStates,
    "get_available_transitions": GetAvailableTransitions,
    "get_transition_graph": GetAvailableTransitions,
}
# The callbacks of rclpy are private.
CALLBACK = "_LifecycleNodeMixin__on_{}"


def create_lifecycle_services(node: Node) -> None:
    """Create the services of the life cycle of ``node``, with the callbacks of rclpy.

    ``node`` is a LifecycleNode without a communication interface: in that of rcl, 10 calls of a service may
    wait, calls beyond that are dropped, and no option changes it. Raises GearboxError if rclpy lacks one of
    the callbacks.
    """
    for name, kind in KINDS.items():
        node.create_service(kind, f"~/{name}", _callback(node, name), qos_profile=SERVICE_QUALITY)


def _callback(node: Node, name: str) -> Callable[[Any, Any], Any]:
    callback: Callable[[Any, Any], Any] | None = getattr(node, CALLBACK.format(name), None)
    if callback is None:
        raise GearboxError(
            f"rclpy: {LifecycleNodeMixin.__name__} has no callback for {name}: use the rclpy of ROS 2 Jazzy"
        )
    return callback
