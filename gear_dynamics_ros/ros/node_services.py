"""The node's services: each asks one thing of the session and answers what was done, or why it was not."""

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
    """Make every service of the node, below its name.

    ``active`` finds the session that is active, or raises GearboxError. Restoring a checkpoint concerns the
    node's parameters too, and is therefore the node's own work.
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
