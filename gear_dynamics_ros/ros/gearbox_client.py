"""Base of all clients of a running gearbox: a ROS context, requests with a time limit, signals."""

from __future__ import annotations

import json
import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import rclpy
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.context import Context
from rclpy.exceptions import (
    InvalidServiceNameException,
    InvalidTopicNameException,
    ParameterException,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_msgs.msg import String
from std_srvs.srv import Trigger

from gear_dynamics_ros.errors import GearboxError, UsageError, one_line
from gear_dynamics_ros.ros.discovery import start_failure, stay_local
from gear_dynamics_ros.ros.node_topics import message_type, quality
from gear_dynamics_ros.topics import TOPICS, full_topic_name

POLL = 0.1  # s of wall time between two checks for a signal
ASK = 1.0  # s of wall time between two questions whether the gearbox has started
SLOW_START = 5.0  # s of wall time after which a log message says that the gearbox is starting


@contextmanager
def ros_context(node: str, arguments: Sequence[str]) -> Iterator[Context]:
    """ROS context for a client of ``node``; ``arguments`` are those from --ros-args on.

    Raises UsageError on invalid arguments, or if ``node`` is not a valid name.
    """
    wrong_name = UsageError(f"--node is {node!r}, not the name of a ROS node: give one such as /gearbox")
    if not node.isascii():  # rclpy fails on bytes that are no text with a TypeError
        raise wrong_name
    stay_local()
    context = Context()
    try:
        rclpy.init(args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, UnicodeEncodeError) as error:  # what rclpy raises on arguments it can't read
        raise UsageError(f"ROS did not start: {start_failure(error)}") from error
    try:
        yield context
    except (InvalidTopicNameException, InvalidServiceNameException) as error:
        raise wrong_name from error
    finally:
        context.try_shutdown()


class GearboxInfo(NamedTuple):
    """Content of the first ``~/model_info`` of a gearbox."""

    epoch_ns: int  # stamp of simulated time 0
    interval_ns: int
    chunk_samples: int
    joints: tuple[str, str]  # driving, driven
    topics: Mapping[str, str]  # full names in the graph, by key in TOPICS
    parameters: Mapping[str, Any]

    @property
    def chunk_ns(self) -> int:
        """Simulated time of a chunk, ns."""
        return self.chunk_samples * self.interval_ns

    def sample(self, stamp_ns: int) -> int:
        """Index of the sample with a stamp."""
        return round((stamp_ns - self.epoch_ns) / self.interval_ns)


def _client_node(name: str, context: Context) -> Node:
    try:
        return Node(name, context=context)
    except (RuntimeError, ParameterException) as error:  # of the middleware, or of a parameter given to it
        raise UsageError(f"ROS did not start: {start_failure(error)}") from error


class GearboxClient(ABC):
    """A node that sends requests to one gearbox and listens to it, all on the caller's thread.

    ``~/model_info`` names the topics of the gearbox, so that those can be remapped; a rule for this node
    (``-r``) comes first.

    While ``_interruptible``, a signal in ``received`` raises GearboxError at the next wait.
    """

    def __init__(
        self, context: Context, client: str, gearbox: str, timeout: float, received: Sequence[int]
    ) -> None:
        """``client`` is the name of this node, ``gearbox`` a full name; ``timeout`` is for each answer, s."""
        self._name = gearbox
        self._timeout = timeout
        self._received = received
        self._interruptible = True
        self._ros = _client_node(client, context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._ros)
        self._reset: Any = self._ros.create_client(Trigger, f"{gearbox}/reset")
        self._parameters: Any = self._ros.create_client(
            SetParametersAtomically, f"{gearbox}/set_parameters_atomically"
        )
        self._start = _StartWatch(self._ros, gearbox)
        self._info: GearboxInfo | None = None  # the first one
        self._described: Mapping[str, Any] = {}  # content of the first ~/model_info
        self._present: Mapping[str, Any] = {}  # parameters in force
        self._heard_at = 0.0  # wall time of the last message or answer, 0 for none
        self._listen("model_info", self._take_info)

    @abstractmethod
    def _connect(self) -> None:
        """Create publishers and subscriptions: called once, when the names of the topics are known."""

    @property
    def _known(self) -> GearboxInfo:
        if self._info is None:
            raise GearboxError(f"{self._name} has not published ~/model_info: see its log")
        return self._info

    def _take_info(self, message: String) -> None:
        info = json.loads(message.data)
        self._present = info["parameters"]
        if self._info is not None:
            return
        self._described = info
        keys = {topic.name: key for key, topic in TOPICS.items()}
        self._info = GearboxInfo(
            epoch_ns=info["epoch_ns"],
            interval_ns=info["sample_interval_ns"],
            chunk_samples=info["samples_per_chunk"],
            joints=tuple(info["joints"][:2]),
            topics={
                keys[entry["declared"]]: name
                for name, entry in info["topics"].items()
                if entry["declared"] in keys
            },
            parameters=info["parameters"],
        )
        self._connect()

    def _topic_name(self, key: str) -> str:
        """Name of the topic ``key`` (in TOPICS) of the gearbox, to give to this node."""
        declared = full_topic_name(TOPICS[key], self._name)
        remapped_here = self._ros.resolve_topic_name(declared) != declared
        if self._info is None or remapped_here:
            return declared
        return self._info.topics.get(key, declared)

    @property
    def _seen(self) -> bool:
        """Whether a node with the name of the gearbox was in the graph."""
        return self._start.seen

    @abstractmethod
    def _progress(self) -> str:
        """Progress of the client as text, such as "2 s of the profile's 10 s"."""

    def _listen(self, key: str, take: Callable[[Any], None]) -> Subscription:
        """Call ``take`` with each message on the topic ``key`` (in TOPICS)."""
        topic = TOPICS[key]

        def heard(message: Any) -> None:
            self._heard_at = time.monotonic()
            take(message)

        return self._ros.create_subscription(
            message_type(topic.type), self._topic_name(key), heard, quality(topic)
        )

    def _advertise(self, key: str) -> Publisher:
        """Publisher of commands on the topic ``key`` (in TOPICS)."""
        topic = TOPICS[key]
        return self._ros.create_publisher(message_type(topic.type), self._topic_name(key), quality(topic))

    def _require_life(self) -> None:
        """Ask a silent gearbox whether it lives. Raises GearboxError if it does not answer in time."""
        silence = time.monotonic() - self._heard_at
        if silence > self._timeout + ASK:
            raise GearboxError(
                f"{self._name} sent nothing and answered nothing for {self._timeout:g} s, at "
                f"{self._progress()}: it is stuck, stopped or killed; see its log, or give a longer --timeout"
            )
        if silence > min(ASK, self._timeout):
            self._start.ask(self._note_life)

    def _note_life(self, _: object) -> None:
        self._heard_at = time.monotonic()

    def _await_gearbox(self, ready: Callable[[], bool], wait: float) -> bool:
        """Serve callbacks until ``ready`` holds; returns False if it does not within ``wait`` s.

        The time in which the gearbox starts does not count: a first start compiles the kernel. Raises
        GearboxError if the gearbox disappears.
        """
        left, last = wait, time.monotonic()
        while not ready():
            if left <= 0.0:
                return False
            self._spin(left)
            now = time.monotonic()
            if not self._start.in_progress():
                left -= now - last
            last = now
        return True

    def _until(self, condition: Callable[[], bool], longest: float) -> bool:
        """Serve callbacks until ``condition`` holds; returns False if it does not within ``longest`` s."""
        deadline = time.monotonic() + longest
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return False
            self._spin(left)
        return True

    def _spin(self, longest: float) -> None:
        """Serve callbacks for at most ``longest`` s, and at most POLL s."""
        if self._interruptible and self._received:
            name = signal.Signals(self._received[0]).name
            raise GearboxError(f"interrupted by {name} at {self._progress()}")
        self._executor.spin_once(timeout_sec=min(POLL, longest))

    def _refusal(self, values: Mapping[str, Any]) -> str:
        """Set parameters, all or none; returns the reason if the gearbox refuses, else an empty text."""
        request = SetParametersAtomically.Request()
        request.parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        result = self._answer(self._parameters, request, f"to set {', '.join(values)}").result
        return "" if result.successful else one_line(result.reason) or "no reason given"

    def _succeed(self, client: Any, request: Any, what: str) -> None:
        """Call a service. Raises GearboxError if it refuses or does not answer in time."""
        answer = self._answer(client, request, what)
        if not answer.success:
            raise GearboxError(f"{self._name} was asked {what}: {one_line(answer.message)}")

    def _answer(self, client: Any, request: Any, what: str) -> Any:
        future = client.call_async(request)
        # The gearbox itself aborts a step after the time limit, and answers then.
        longest = self._timeout + POLL
        if not self._until(lambda: future.done() or not client.service_is_ready(), longest):
            raise GearboxError(
                f"{self._name} was asked {what} and did not answer within {self._timeout:g} s: see its log, "
                "or give a longer --timeout"
            )
        if not future.done():
            raise GearboxError(f"{self._name} disappeared when it was asked {what}: see its log")
        return future.result()

    def _signal(self, failure: str) -> int:
        """Number of the signal that caused ``failure``; 0 if none did, or ``failure`` is empty."""
        return self._received[0] if failure and self._received else 0


class _StartWatch:
    """Tells whether a gearbox is starting: it is in the graph, and answers no request yet."""

    def __init__(self, node: Node, gearbox: str) -> None:
        self._ros = node
        self._name = gearbox
        self._state: Any = node.create_client(GetState, f"{gearbox}/get_state")
        self._seen_at = 0.0  # wall time, as the other; 0 for never
        self._asked_at = 0.0
        self._answered = self._told = False

    @property
    def seen(self) -> bool:
        """Whether the gearbox was in the graph."""
        return self._seen_at > 0.0

    def in_progress(self) -> bool:
        """Whether the gearbox is starting. Raises GearboxError if it was in the graph and no longer is."""
        if not self._is_in_graph():
            if self.seen:
                raise GearboxError(f"{self._name} disappeared before it was ready: see its log")
            return False
        now = time.monotonic()
        self._seen_at = self._seen_at or now
        if self._answered:
            return False
        self.ask(self._note_answer)
        if now - self._seen_at > SLOW_START and not self._told:
            self._told = True
            self._ros.get_logger().info(f"{self._name} is starting, waiting until it answers: see its log")
        return True

    def ask(self, note: Callable[[object], None]) -> None:
        """Ask the gearbox for its state, at most once in ASK s; ``note`` is called with the answer."""
        now = time.monotonic()
        if now - self._asked_at > ASK and self._state.service_is_ready():
            self._asked_at = now
            self._state.call_async(GetState.Request()).add_done_callback(note)

    def _note_answer(self, _: object) -> None:
        self._answered = True

    def _is_in_graph(self) -> bool:
        nodes = self._ros.get_node_names_and_namespaces()
        return self._name in (f"{namespace.rstrip('/')}/{name}" for name, namespace in nodes)


def not_seen(gearbox: str, wait: float) -> str:
    """Message for a gearbox that was not found within ``wait`` s."""
    return (
        f"no gearbox {gearbox} was seen for {wait:g} s: start it, name it with --node, compare "
        "ROS_DOMAIN_ID, or give a longer --wait"
    )


def take_waiting(subscription: Subscription, first: Any, most: int) -> list[Any]:
    """``first`` and up to ``most`` further messages that have arrived.

    An executor takes one message at a time, which is slow: after a delay a client would stay behind.
    """
    kind, messages = type(first), [first]
    with subscription.handle:
        for _ in range(most):
            taken = subscription.handle.take_message(kind, False)
            if taken is None:
                break
            messages.append(taken[0])
    return messages


def require_take_message(subscription: Subscription) -> None:
    """Raise GearboxError unless rclpy offers to take all messages that have arrived."""
    if not callable(getattr(subscription.handle, "take_message", None)):
        raise GearboxError(
            "rclpy: a subscription has no handle.take_message(type, raw): use the rclpy of ROS 2 Jazzy"
        )
