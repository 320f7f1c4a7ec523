"""The node's services: each asks one thing of the session and answers what was done, or why it was not."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.realtime.session import Session

Act = Callable[[Any], str]
Find = Callable[[], Session]
T = TypeVar("T")


def create_services(node: Node, active: Find, restored: Callable[[Session], None]) -> None:
    """Make every service of the node, below its name.

    ``active`` finds the session that is active, or raises GearboxError; ``restored`` is called after a
    checkpoint has been restored, as far as that went.
    """

    def restore(_: Any) -> str:
        session = active()
        try:
            return session.restore_checkpoint()
        finally:
            restored(session)

    def step(_: Any) -> float | Future[float]:
        return active().step()

    def snapshot(_: Any) -> str | Future[str]:
        return active().snapshot()

    def record(request: Any) -> str | Future[str]:
        return active().start_recording() if request.data else active().end_recording()

    plain: dict[str, tuple[Any, Act]] = {
        "reset": (Trigger, lambda _: active().reset()),
        "split": (Trigger, lambda _: active().split()),
        "save_checkpoint": (Trigger, lambda _: active().save_checkpoint()),
        "restore_checkpoint": (Trigger, restore),
        "pause": (SetBool, lambda request: active().pause(request.data)),
    }
    for name, (kind, act) in plain.items():
        node.create_service(kind, f"~/{name}", _serve(act))
    _create_slow_service(node, Trigger, "step", step, lambda time: f"simulated {time:.9g} s")
    _create_slow_service(node, Trigger, "snapshot", snapshot, str)
    _create_slow_service(node, SetBool, "record", record, str)


def _serve(act: Act) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        try:
            response.message = act(request)
            response.success = True
        except (GearboxError, OSError) as error:
            response.message = str(error)
            response.success = False
        return response

    return answer


def _create_slow_service(
    node: Node, kind: Any, name: str, start: Callable[[Any], T | Future[T]], tell: Callable[[T], str]
) -> None:
    """A service answered, in words, when what it starts is done; meanwhile all other calls are served.

    rclpy sends what a callback returns at once, and its executor driven by events knows no coroutines. So
    the sending itself is put off until then.
    """
    under_way: dict[int, Future[T]] = {}

    def begin(request: Any, response: Any) -> Any:
        try:
            started = start(request)
        except (GearboxError, OSError) as error:
            response.message = str(error)
            return response
        if isinstance(started, Future):
            under_way[id(response)] = started
        else:
            response.message, response.success = tell(started), True
        return response

    service = node.create_service(kind, f"~/{name}", begin)
    send = service.send_response

    def send_when_done(response: Any, header: Any) -> None:
        future = under_way.pop(id(response), None)
        if future is None:
            send(response, header)
        else:
            future.add_done_callback(lambda done: send(_result(done, tell, response), header))

    service.send_response = send_when_done  # type: ignore[method-assign]


def _result(done: Future[T], tell: Callable[[T], str], response: Any) -> Any:
    try:
        response.message = tell(done.result())
        response.success = True
    except Exception as error:  # whatever went wrong on that thread, the caller waits for an answer
        response.message = str(error) or repr(error)
    return response
