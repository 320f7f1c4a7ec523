"""The real node in a process of its own, and clients beside it over real DDS."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Self

import numpy as np
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.messages.cdr import stamp_ns
from gear_dynamics_ros.messages.decoder import applied_commands
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.ros.node_topics import message_type, quality
from gear_dynamics_ros.topics import COMMAND_TOPICS, TOPICS, full_topic_name
from support.processes import Process, StartProcess

PATIENCE = 120.0  # s of wall time; a first start compiles the kernel
OUTPUTS = [key for key in TOPICS if key not in COMMAND_TOPICS and key != "clock"]
DEPTH = 100  # messages that come while a client does not listen
INTERVAL_NS = 10_000  # the default solver.sample_interval


def start_gearbox(
    start: StartProcess, *parameters: str, remap: Sequence[str] = (), **variables: str
) -> Process:
    """Start the node; ``parameters`` as "name:=value", ``variables`` of its environment."""
    words = [word for rule in remap for word in ("-r", rule)]
    words += [word for parameter in parameters for word in ("-p", parameter)]
    return start("gearbox", "--ros-args", *words, **variables)


class Peer:
    """A ROS 2 node of the test's own; only ``until`` and what calls it let messages in."""

    def __init__(self, name: str, gearbox: str = "/gearbox") -> None:
        self.gearbox = gearbox
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, context=self.context)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def until(self, condition: Callable[[], object]) -> None:
        """Take in what comes until ``condition`` holds."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "the awaited never came"
            self.executor.spin_once(timeout_sec=0.1)

    def subscribe(self, key: str, take: Callable[[Any], object], profile: QoSProfile | None = None) -> Any:
        """Let ``take`` have every message of a topic (key in TOPICS)."""
        topic = TOPICS[key]
        name = full_topic_name(topic, self.gearbox)
        return self.node.create_subscription(message_type(topic.type), name, take, profile or quality(topic))

    def publisher(self, key: str) -> Publisher:
        """Publisher of a topic (key in TOPICS)."""
        topic = TOPICS[key]
        name = full_topic_name(topic, self.gearbox)
        return self.node.create_publisher(message_type(topic.type), name, quality(topic))

    def ask(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service of the gearbox; returns the future of its answer."""
        client = self.node.create_client(kind, f"{self.gearbox}/{name}")
        assert client.wait_for_service(PATIENCE)
        future = client.call_async(request or kind.Request())
        future.add_done_callback(lambda _: self.node.destroy_client(client))
        return future

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service of the gearbox; returns its answer."""
        future = self.ask(kind, name, request)
        self.until(future.done)
        return future.result()

    def trigger(self, name: str) -> Any:
        return self.call(Trigger, name)

    def switch(self, name: str, wanted: bool) -> Any:
        return self.call(SetBool, name, SetBool.Request(data=wanted))

    def transition(self, number: int) -> Any:
        """Ask for a transition of the lifecycle."""
        return self.call(ChangeState, "change_state", ChangeState.Request(transition=Transition(id=number)))

    def put(self, name: str, value: Any) -> Any:
        """Set a parameter; returns the result with its reason."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, "set_parameters", request).results[0]

    def put_all(self, values: Mapping[str, Any]) -> Any:
        """Set parameters, all or none; returns the result with its reason."""
        wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=wanted)
        return self.call(SetParametersAtomically, "set_parameters_atomically", request).result

    def get_all(self, names: Sequence[str]) -> dict[str, Any]:
        """Values of parameters, arrays as lists."""
        answer = self.call(GetParameters, "get_parameters", GetParameters.Request(names=list(names)))
        values = map(parameter_value_to_python, answer.values)
        plain = (value.tolist() if hasattr(value, "tolist") else value for value in values)
        return dict(zip(names, plain, strict=True))

    def get(self, name: str) -> Any:
        return self.get_all([name])[name]


class Client(Peer):
    """Hears what the gearbox sends, commands it and calls its services."""

    def __init__(self, gearbox: str = "/gearbox", hears: Sequence[str] = OUTPUTS) -> None:
        """``hears``: the topics (keys in TOPICS) to hear; the fewer, the less the machine is loaded."""
        super().__init__("client", gearbox)
        self.heard: dict[str, list[Any]] = {key: [] for key in hears}
        for key in hears:
            profile = quality(TOPICS[key])
            profile.depth = max(profile.depth, DEPTH)
            self.subscribe(key, self.heard[key].append, profile)
        self.publishers = {key: self.publisher(key) for key in COMMAND_TOPICS}

    def hear(self, key: str, count: int = 1) -> list[Any]:
        """The next ``count`` messages of a topic."""
        known = len(self.heard[key])
        self.until(lambda: len(self.heard[key]) >= known + count)
        return self.heard[key][known : known + count]

    def command(self, key: str, message: Any) -> None:
        self.until(lambda: self.publishers[key].get_subscription_count() > 0)
        self.publishers[key].publish(message)

    def in_force(self) -> Commands:
        """The commands in force, as told last."""
        self.until(lambda: self.heard["applied_command"])
        return applied_commands(self.heard["applied_command"][-1])

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in self.heard["event"]]

    def info(self) -> dict[str, Any]:
        """Content of the last model_info."""
        return dict(json.loads(self.heard["model_info"][-1].data))

    def sample_at(self, stamp: Any) -> int:
        """Index of the sample at a stamp."""
        return round((stamp_ns(stamp) - self.info()["epoch_ns"]) / INTERVAL_NS)

    def rows(self) -> NDArray[np.float64]:
        """Samples heard, shape (n, 28)."""
        return np.vstack([rows_of(message) for message in self.heard["waveform"]])

    def indices(self) -> NDArray[np.int64]:
        """Index of each sample heard."""
        return indices_of(self.rows())

    def sample(self) -> int:
        """Index of the last sample heard."""
        return int(indices_of(rows_of(self.heard["waveform"][-1]))[-1])

    def sample_after(self, index: int) -> bool:
        """Whether that sample or one after it was heard."""
        return bool(self.heard["waveform"]) and self.sample() >= index

    def statuses(self) -> dict[str, Any]:
        """The next diagnostics by task; of several that came at once the last."""
        self.hear("diagnostics")
        return {
            status.name.removeprefix("gearbox: "): status for status in self.heard["diagnostics"][-1].status
        }

    def status(self, task: str) -> tuple[Any, dict[str, str]]:
        """The next diagnostics of a task, and its values."""
        found = self.statuses()[task]
        return found, {entry.key: entry.value for entry in found.values}

    def changeable(self) -> dict[str, Any]:
        """Every parameter that may change while the gearbox runs."""
        return self.get_all([row.name for row in specifications().values() if row.runtime])

    def put_back(self, parameters: Mapping[str, Any]) -> None:
        """Let a running gearbox start anew with ``parameters`` (of ``changeable``); forget what was heard.

        The client must hear events and the commands in force. Of topics that tell it to latecomers the last
        message stays.
        """
        self.switch("pause", False)
        now = self.changeable()
        changed = {name: value for name, value in parameters.items() if now[name] != value}
        if changed:
            result = self.put_all(changed)
            assert result.successful, result.reason
        known = len(self.heard["event"])
        answer = self.trigger("reset")
        assert answer.success, answer.message
        self.until(lambda: any(event["event"] == "reset" for event in self.events()[known:]))
        at = self.events()[-1]["sample"]
        commands = Commands(*(parameters[f"operation.{name}"] for name in Commands._fields))
        self.until(lambda: self.in_force() == commands)
        for key, messages in self.heard.items():
            if key == "waveform":
                self.until(lambda: self.sample_after(at))
                messages[:] = [message for message in messages if indices_of(rows_of(message))[0] >= at]
            else:
                del messages[: -1 if TOPICS[key].latched else None]


@contextmanager
def shared_gearbox(
    start: StartProcess, *parameters: str, hears: Sequence[str] = OUTPUTS
) -> Iterator[tuple[Process, Client, dict[str, Any]]]:
    """A running gearbox for several tests, a client, and the parameters to ``put_back`` before each."""
    process = start_gearbox(start, *parameters)
    with Client(hears=hears) as client:
        client.in_force()
        yield process, client, client.changeable()


def rows_of(message: Any) -> NDArray[np.float64]:
    """Samples of a waveform message, shape (n, 28)."""
    return np.asarray(message.data).reshape(-1, len(CHANNEL_NAMES))


def indices_of(rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """Index of each sample by its time."""
    return np.rint(rows[:, 0] * 1e9 / INTERVAL_NS).astype(np.int64)
