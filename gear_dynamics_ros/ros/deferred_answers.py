"""Answers of services that are sent when the work is done, while the executor continues."""

from __future__ import annotations

import heapq
import inspect
import itertools
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service import Service

from gear_dynamics_ros.errors import GearboxError, one_line
from gear_dynamics_ros.system.threads import begin_thread

T = TypeVar("T")
# Calls and answers that may wait at once, as for the parameter services of rclpy. With its default of 10,
# calls that arrive faster than they are served are dropped, and their clients wait for ever.
SERVICE_QUALITY = QoSProfile(depth=1000)
# s between the answers of one service to simultaneous calls. A client queues 10 answers by default, and
# receives the answers to all clients of the service: one that stops for ten times as long loses some.
SPACING = 0.025
# s for which an answer is offered again while the middleware does not know the client's reader, and between
# two attempts. The reader and the writer of a new client are discovered independently: its first request can
# come long before its reader is known. Each attempt waits for 0.1 s inside the middleware.
DISCOVERY_PATIENCE = 10.0
DISCOVERY_INTERVAL = 0.1
UNDISCOVERED = "failed to send response (timeout)"  # how the warning of rclpy begins
SEND_RESPONSE_PARAMETERS = ["self", "response", "header"]
NOT_DEFERRED = "internal error: rclpy sent this answer before the work was done; see the log for the result"


@dataclass(order=True)
class _Answer:
    """An answer that waits: the first due is the smallest."""

    due: float  # monotonic time, s
    order: int
    send: Callable[[], bool] = field(compare=False)
    abandoned: float = field(compare=False)  # monotonic time after which it is not offered again, s


class AnswerSender:
    """Sends the answers of all services when they are due, on its own thread."""

    def __init__(self, log: Any) -> None:
        """``log`` is the logger of the node."""
        self._log = log
        self._waiting: list[_Answer] = []  # a heap
        self._order = itertools.count()
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="answers", daemon=True)
        self._thread.start()

    def put(self, due: float, send: Callable[[], bool]) -> None:
        """Call ``send``, which sends one answer, at the monotonic time ``due`` (s). For any thread.

        It is called again, for ``DISCOVERY_PATIENCE``, while it returns False: the client is not yet known.
        """
        self._wait(_Answer(due, next(self._order), send, due + DISCOVERY_PATIENCE))

    def close(self) -> None:
        """Send all waiting answers at once and end the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    def _wait(self, answer: _Answer) -> None:
        with self._changed:
            heapq.heappush(self._waiting, answer)
            self._changed.notify()

    def _work(self) -> None:
        begin_thread()
        while answer := self._next():
            try:
                sent = answer.send()
            except InvalidHandle:  # the service was destroyed
                continue
            except Exception:  # the other answers must be sent all the same
                self._log.error(traceback.format_exc())
                continue
            if not sent:
                self._offer_again(answer)

    def _offer_again(self, answer: _Answer) -> None:
        now = time.monotonic()
        if self._closing or now > answer.abandoned:
            self._log.warning("an answer was not sent: the middleware did not find the client that asked")
            return
        answer.due = now + DISCOVERY_INTERVAL
        self._wait(answer)

    def _next(self) -> _Answer | None:
        """Wait for the next answer to be due; None if the sender is closed and no answer waits."""
        with self._changed:
            while not self._closing:
                wait = self._waiting[0].due - time.monotonic() if self._waiting else None
                if wait is not None and wait <= 0.0:
                    break
                self._changed.wait(wait)
            return heapq.heappop(self._waiting) if self._waiting else None


class Spacing:
    """When the answers of one service are due: at once, or ``SPACING`` after another to a simultaneous call.

    A client that waits for each answer gets it at once. It is told by the number of its request, one more
    than that of the request before: clients number their requests each for themselves. Time does not tell it:
    of several clients in one program, each may send its request after the one before was answered, and none
    has read an answer yet.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0.0  # when the last answer is due, monotonic time, s
        self._number = 0  # of the request that it answers

    def due(self, received_ns: int, number: int) -> float:
        """Monotonic time, s, at which to answer request ``number`` of a client.

        It was received at the system time ``received_ns``.
        """
        with self._lock:
            now = time.monotonic()
            received = now - max(0, time.time_ns() - received_ns) * 1e-9
            waited = received > self._last and number == self._number + 1
            self._last = now if waited else max(now, self._last + SPACING)
            self._number = number
            return self._last


class DeferredAnswers:
    """Sends the answers of one service after its callback has returned.

    rclpy sends at once what a callback returns, and its events executor does not support coroutines. All its
    executors call ``Service.send_response`` with what the callback returned: that method is replaced, for
    this one object. Raises GearboxError if this method is not that of Jazzy.
    """

    def __init__(self, service: Service, sender: AnswerSender) -> None:
        require_send_response()
        self._sender = sender
        self._spacing = Spacing()
        self._send = service.send_response
        self._deferred: dict[int, tuple[Future[Any], Callable[[], None]]] = {}
        service.send_response = self._send_when_done  # type: ignore[method-assign]

    def defer(self, response: Any, work: Future[Any], complete: Callable[[], None]) -> None:
        """Send ``response``, which the callback then returns, when ``work`` is done.

        Before, ``complete`` is called on the thread of the sender to fill in the result.
        """
        self._deferred[id(response)] = work, complete

    def _send_when_done(self, response: Any, header: Any) -> None:
        def send() -> bool:
            return is_sent(lambda: self._send(response, header))

        deferred = self._deferred.pop(id(response), None)
        if deferred is None:
            self._put(header, send)
            return
        work, complete = deferred

        def complete_and_send() -> bool:
            complete()
            return send()

        work.add_done_callback(lambda _: self._put(header, complete_and_send))

    def _put(self, header: Any, send: Callable[[], bool]) -> None:
        due = self._spacing.due(header.received_timestamp, header.request_id.sequence_number)
        self._sender.put(due, send)


def is_sent(send: Callable[[], None]) -> bool:
    """Call ``send``; whether rclpy did not warn that the middleware does not know the client's reader.

    rclpy does not raise an error then, and the answer is lost.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        send()
    undiscovered = [str(warning.message).startswith(UNDISCOVERED) for warning in caught]
    for warning, known in zip(caught, undiscovered, strict=True):
        if not known:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return not any(undiscovered)


def require_send_response() -> None:
    """Raise GearboxError unless rclpy has the method that ``DeferredAnswers`` replaces."""
    method = getattr(Service, "send_response", None)
    parameters = None if method is None else list(inspect.signature(method).parameters)
    if parameters != SEND_RESPONSE_PARAMETERS:
        raise GearboxError(
            f"rclpy: Service.send_response has the parameters {parameters}, expected "
            f"{SEND_RESPONSE_PARAMETERS}: use the rclpy of ROS 2 Jazzy"
        )


def answer_when_done(
    node: Node, sender: AnswerSender, kind: Any, name: str, start: Callable[[Any], Future[str]]
) -> None:
    """Create the service ``name`` of type ``kind``, whose answer has ``success`` and ``message``.

    ``start`` gets the request and starts the work; its result is the message. If ``start`` or the work raises
    an error, the answer is ``success: false`` with the error.
    """

    def callback(request: Any, response: Any) -> Any:
        try:
            work = start(request)
        except Exception as error:
            response.message = _message(node, error)
            return response
        response.message = NOT_DEFERRED
        answers.defer(response, work, lambda: _fill(node, response, work))
        return response

    service = node.create_service(kind, name, callback, qos_profile=SERVICE_QUALITY)
    answers = DeferredAnswers(service, sender)


def defer_parameter_answers(
    node: Node, sender: AnswerSender, work_begun: Callable[[], Future[Any] | None]
) -> None:
    """Make the services that set parameters of ``node`` answer when the change is in force.

    ``work_begun`` is called after each request and returns the work that the request began, if any. If that
    work fails, or rclpy raises an error, the answer says that nothing was set, and why.
    """
    for service in list(node.services):
        if service.srv_type in (SetParameters, SetParametersAtomically):
            _defer_parameter_answers(node, sender, service, work_begun)


def _defer_parameter_answers(
    node: Node, sender: AnswerSender, service: Service, work_begun: Callable[[], Future[Any] | None]
) -> None:
    answers, set_parameters = DeferredAnswers(service, sender), service.callback

    def refuse(request: Any, response: Any, error: BaseException) -> None:
        result = SetParametersResult(successful=False, reason=_message(node, error))
        if service.srv_type is SetParameters:
            response.results = [result] * len(request.parameters)
        else:
            response.result = result

    def callback(request: Any, response: Any) -> Any:
        try:
            _require_known_types(request.parameters)
            set_parameters(request, response)
        except Exception as error:
            refuse(request, response, error)
        work = work_begun()
        if work is not None:

            def complete(error: Callable[[], BaseException | None] = work.exception) -> None:
                failure = error()
                if failure is not None:
                    refuse(request, response, failure)

            answers.defer(response, work, complete)
        return response

    service.callback = callback


def _require_known_types(parameters: Sequence[Any]) -> None:
    known = {kind.value for kind in Parameter.Type}
    for parameter in parameters:
        if parameter.value.type not in known:
            raise GearboxError(
                f"{parameter.name}: value.type = {parameter.value.type} is no type of a parameter: it must "
                f"be {min(known)} to {max(known)}, as in rcl_interfaces/msg/ParameterType"
            )


def guard_services(node: Node, sender: AnswerSender) -> None:
    """Make the services of ``node`` that rclpy created, those of its life cycle too, answer as its own do.

    Their answers are spaced like all others. If rclpy raises an error on a request, such as a transition that
    is not possible in the present state, the answer is empty (``success: false``, if there is such a field)
    and the log has a warning. Without this, the error would leave the spin and end the node.
    """
    for service in list(node.services):
        if "send_response" not in vars(service):
            _guard(node, sender, service)


def _guard(node: Node, sender: AnswerSender, service: Service) -> None:
    DeferredAnswers(service, sender)
    answer, kind = service.callback, service.srv_type

    def callback(request: Any, response: Any) -> Any:
        try:
            return answer(request, response)
        except Exception as error:
            log: Any = node.get_logger()
            log.warning(f"{service.service_name}: refused: {one_line(error) or repr(error)}")
            return kind.Response()  # type: ignore[attr-defined]

    service.callback = callback


def on_executor(node: Node, first: Future[T], act: Callable[[], None]) -> Future[T]:
    """Result of ``first``, after ``act`` was called on the thread that spins ``node``."""
    result: Future[T] = Future()

    def proceed() -> None:
        try:
            act()
            value = first.result()
        except Exception as error:
            result.set_exception(error)
        else:
            result.set_result(value)

    def schedule(_: Future[T]) -> None:
        if node.executor is not None:
            node.executor.create_task(proceed)

    first.add_done_callback(schedule)
    return result


def _fill(node: Node, response: Any, work: Future[str]) -> None:
    try:
        response.message = work.result()
        response.success = True
    except Exception as error:
        response.message = _message(node, error)
        response.success = False


def _message(node: Node, error: BaseException) -> str:
    if isinstance(error, GearboxError | OSError):
        return str(error)
    log: Any = node.get_logger()
    log.error("".join(traceback.format_exception(error)))
    return f"internal error: {str(error) or repr(error)}: see the log of the gearbox"
