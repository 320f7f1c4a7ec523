"""The services of the node: each makes one request to the session and answers with its result."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.realtime.session import Session
from gear_dynamics_ros.ros.deferred_answers import AnswerSender, answer_when_done

Start = Callable[[Any], Future[str]]


def create_services(
    node: Node,
    sender: AnswerSender,
    active: Callable[[], Session],
    restore_checkpoint: Callable[[], Future[str]],
) -> None:
    """Create all services of the node, in the namespace of its name.

    ``active`` returns the active session, or raises GearboxError. Restoring a checkpoint also changes the
    parameters of the node; so it is not a request to the session, but to the node: ``restore_checkpoint``.
    """
    services: dict[str, tuple[Any, Start]] = {
        "reset": (Trigger, lambda _: active().reset()),
        "pause": (SetBool, lambda request: active().pause() if request.data else active().unpause()),
        "step": (Trigger, lambda _: active().step()),
        "split": (Trigger, lambda _: active().split()),
        "record": (
            SetBool,
            lambda request: active().start_recording() if request.data else active().end_recording(),
        ),
        "snapshot": (Trigger, lambda _: active().snapshot()),
        "save_checkpoint": (Trigger, lambda _: active().save_checkpoint()),
        "restore_checkpoint": (Trigger, lambda _: restore_checkpoint()),
    }
    for name, (kind, start) in services.items():
        answer_when_done(node, sender, kind, f"~/{name}", start)
