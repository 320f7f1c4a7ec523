"""The node's services: each asks one thing of the session and answers what was done, or why it was not."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future as RosFuture
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.session import Session

Act = Callable[[Any], str]
Find = Callable[[], Session]


def create_services(node: Node, active: Find, restored: Callable[[Session], None]) -> list[Any]:
    """Every service of the node, below its name.

    ``active`` finds the session that is active, or raises GearboxError; ``restored`` is called after a
    checkpoint has been restored.
    """

    def restore(_: Any) -> str:
        session = active()
        answer = session.restore_checkpoint()
        restored(session)
        return answer

    plain: dict[str, tuple[Any, Act]] = {
        "reset": (Trigger, lambda _: active().reset()),
        "split": (Trigger, lambda _: active().split()),
        "save_checkpoint": (Trigger, lambda _: active().save_checkpoint()),
        "restore_checkpoint": (Trigger, restore),
        "pause": (SetBool, lambda request: active().pause(request.data)),
        "record": (SetBool, lambda request: active().record(request.data)),
    }
    services = [node.create_service(kind, f"~/{name}", _serve(act)) for name, (kind, act) in plain.items()]
    # In a group of its own: what resumes or resets must be heard while steps are made.
    step = node.create_service(
        Trigger, "~/step", _serve_steps(node, active), callback_group=ReentrantCallbackGroup()
    )
    return [*services, step]


def _serve(act: Act) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        try:
            response.message = act(request)
            response.success = True
        except GearboxError as error:
            response.message = str(error)
            response.success = False
        return response

    return answer


def _serve_steps(node: Node, active: Find) -> Callable[[Any, Any], Any]:
    async def answer(_: Any, response: Any) -> Any:
        try:
            steps = active().step()
            await _settled(node, steps)
            response.message = f"simulated {steps.result():.9g} s"
            response.success = True
        except GearboxError as error:
            response.message = str(error)
            response.success = False
        return response

    return answer


def _settled(node: Node, future: Future[Any]) -> RosFuture:
    """What a coroutine of the node's executor can await until ``future`` is done on another thread."""
    executor = node.executor
    done = RosFuture(executor=executor)

    def settle(_: object) -> None:
        done.set_result(None)
        if executor is not None:
            executor.wake()

    future.add_done_callback(settle)
    return done
