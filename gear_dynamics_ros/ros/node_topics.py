"""The topics of the node: publishers of encoded messages, subscriptions to commands."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.topics import CHUNK_TOPICS, COMMAND_TOPICS, TOPICS, NodeNames, Topic

Publishers = Mapping[str, Publisher]


class Listeners:
    """Which topics of CHUNK_TOPICS somebody listens to. The middleware tells it; any thread may ask."""

    def __init__(self, always: Collection[str] = ()) -> None:
        """Topics in ``always`` count as heard."""
        self._always = always
        self._counts: dict[str, int] = {}
        self.heard = frozenset(always)

    def note(self, topic: str, matched: QoSPublisherMatchedInfo) -> None:
        """Take in how many subscriptions ``topic`` (in CHUNK_TOPICS) has. On one thread."""
        self._counts[topic] = matched.current_count
        self.heard = frozenset([*self._always, *(key for key, count in self._counts.items() if count)])


class PublisherSink:
    """Publishes the messages of a run that somebody hears; without a subscription DDS would drop them.

    Not those without a publisher, such as received commands.
    """

    def __init__(self, publishers: Publishers, listeners: Listeners) -> None:
        self._publishers = publishers
        self._listeners = listeners
        self._last_clock: bytes | None = None
        self._clock_is_old = False

    def wanted(self) -> Collection[str]:
        return self._listeners.heard

    def write(self, _: Chunk | None, records: Sequence[Record]) -> None:
        heard = self._listeners.heard
        for record in records:
            topic = record.topic
            publisher = self._publishers.get(topic)
            if publisher is not None and (topic in heard or topic not in CHUNK_TOPICS):
                publisher.publish(record.data)
                if topic == "clock":
                    self._last_clock, self._clock_is_old = record.data, False

    def repeat_clock(self) -> None:
        """Publish the last ``/clock`` again unless one came since the last call, as in a pause.

        Who joins late and follows ``/clock`` would know no time. Call it on the thread of ``write``.
        """
        if self._clock_is_old and self._last_clock is not None:
            self._publishers["clock"].publish(self._last_clock)
        self._clock_is_old = True

    def close(self) -> None:
        """Do nothing: the node destroys its publishers."""


def create_publishers(
    node: Node, group: CallbackGroup, listeners: Listeners, *, clock: bool
) -> Iterator[tuple[str, Publisher]]:
    """Publishers of all outputs with their keys in TOPICS; parameters may override quality of service.

    ``listeners`` learns of their subscriptions; ``/clock`` only if ``clock`` is true.
    """
    for key, topic in TOPICS.items():
        if key not in COMMAND_TOPICS and (clock or key != "clock"):
            yield (
                key,
                node.create_publisher(
                    message_type(topic.type),
                    _expanded(node, topic),
                    quality(topic),
                    callback_group=group,
                    event_callbacks=_events(key, listeners),
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                ),
            )


def _events(key: str, listeners: Listeners) -> PublisherEventCallbacks:
    if key not in CHUNK_TOPICS:
        return PublisherEventCallbacks()
    return PublisherEventCallbacks(matched=partial(listeners.note, key))


def create_subscriptions(node: Node, group: CallbackGroup) -> Iterator[tuple[str, Subscription]]:
    """Subscriptions to all commands with their keys in TOPICS, to be asked for messages in CDR."""
    for key in COMMAND_TOPICS:
        topic = TOPICS[key]
        yield (
            key,
            node.create_subscription(
                message_type(topic.type),
                _expanded(node, topic),
                lambda _: None,
                quality(topic),
                callback_group=group,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                raw=True,
            ),
        )


def _expanded(node: Node, topic: Topic) -> str:
    """Full name of ``topic`` before remapping: rclpy's warnings have the name that it was given."""
    return node.resolve_topic_name(topic.name, only_expand=True)


def read_command(key: str, data: bytes) -> Any:
    """Message on the command topic ``key``, from CDR. Raises GearboxError if ``data`` is not one."""
    topic = TOPICS[key]
    try:
        return deserialize(topic.type, data)
    except GearboxError as error:
        raise GearboxError(f"message refused: {error}") from error


def node_names(node: Node) -> NodeNames:
    """Full names of the node and its topics in the graph, after remapping."""
    names = NodeNames(node.get_fully_qualified_name())
    resolved = {key: node.resolve_topic_name(topic.name) for key, topic in TOPICS.items()}
    return names._replace(remapped={key: name for key, name in resolved.items() if name != names.topic(key)})


def quality(topic: Topic) -> QoSProfile:
    """Quality of service of a topic."""
    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


def message_type(name: str) -> Any:
    """Class of the message type ``name``, such as std_msgs/msg/Float64."""
    package, _, message = name.split("/")
    return getattr(import_module(f"{package}.msg"), message)
