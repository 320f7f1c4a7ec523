"""Passes command messages from their topics to the mailbox of the engine."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.subscription import Subscription

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.decoder import requested_changes
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.ros import node_topics
from gear_dynamics_ros.topics import COMMAND_TOPICS, JOINT_COMMAND, TOPICS

WARNING_INTERVAL = 5.0  # s
MOST_NAMES = 1000  # of joints and topics in warnings
MOST_SHOWN = 5  # of joints in one warning


class CommandPublishers(NamedTuple):
    """What is odd about the publishers of commands."""

    several: Sequence[str]  # full names of topics with several publishers
    wrong_type: Sequence[str]  # such topics and the types, as "/gearbox/command/speed: std_msgs/msg/Float32"


class _Arrival(NamedTuple):
    time_ns: int  # of the system's clock
    topic: str  # key in TOPICS
    data: bytes  # CDR


class CommandReceiver:
    """Takes commands from the middleware to the mailbox, and warns of invalid ones.

    The thread that needs the commands takes them: a command that waited for the executor to pass it on would
    miss the edge of a chunk that begins meanwhile.
    """

    def __init__(self, node: Node, mailbox: Mailbox, joint_prefix: str) -> None:
        self._node = node
        self._log: Any = node.get_logger()
        self._mailbox = mailbox
        self._joint_prefix = joint_prefix
        self._warned: set[str] = set()
        self._collecting = threading.Lock()
        self._sources: list[tuple[str, Any, Any]] = []  # key in TOPICS, message type, what takes a message

    def listen(self, subscriptions: Mapping[str, Subscription]) -> None:
        """Take commands from ``subscriptions`` (by key in TOPICS), which no executor may serve."""
        self._sources = [
            (key, subscription.msg_type, subscription.handle.take_message)
            for key, subscription in subscriptions.items()
        ]

    def collect(self) -> None:
        """Pass on everything that has arrived, in the order of arrival; for any thread."""
        with self._collecting:
            arrived: list[_Arrival] = []
            # While the others are asked, one may arrive on a topic that was asked already.
            while found := self._taken():
                arrived += found
            for _, key, data in sorted(arrived, key=itemgetter(0)):
                self._receive(key, data)

    def _taken(self) -> list[_Arrival]:
        """At most one message of each topic."""
        taken = [(key, take(kind, True)) for key, kind, take in self._sources]
        return [_Arrival(found[1]["received_timestamp"], key, found[0]) for key, found in taken if found]

    def _receive(self, key: str, data: bytes) -> None:
        """Pass on the message ``data`` (CDR) on the command topic ``key`` (in TOPICS), or refuse it."""
        try:
            message = node_topics.read_command(key, data)
        except GearboxError as error:
            refusal = f"{node_topics.node_names(self._node).topic(key)}: {error}"
            self._mailbox.refuse(refusal)
            self._log.warning(refusal, throttle_duration_sec=WARNING_INTERVAL)
            return
        changes, unknown_joints = requested_changes(key, message, self._joint_prefix)
        self._warn_of_joints(unknown_joints)
        refusal = self._mailbox.offer(key, changes, data, time.monotonic_ns())
        if refusal:
            self._log.warning(refusal, throttle_duration_sec=WARNING_INTERVAL)

    def publishers(self) -> CommandPublishers:
        """Command topics whose publishers need a look; a warning the first time."""
        names = node_topics.node_names(self._node)
        several: list[str] = []
        wrong_type: list[str] = []
        for key in COMMAND_TOPICS:
            name, wanted = names.topic(key), TOPICS[key].type
            types = [publisher.topic_type for publisher in self._node.get_publishers_info_by_topic(name)]
            if types.count(wanted) > 1:
                several.append(name)
                self._warn_once(
                    name,
                    f"{name} has several publishers: the last message before a chunk edge counts "
                    "(reported once)",
                )
            for other in sorted(set(types) - {wanted}):
                wrong_type.append(f"{name}: {other}")
                self._warn_once(
                    wrong_type[-1],
                    f"{name} has a publisher of {other}, whose messages do not arrive: publish {wanted} "
                    "(reported once)",
                )
        return CommandPublishers(several, wrong_type)

    def _warn_of_joints(self, names: Sequence[str]) -> None:
        """Warn once of each joint without commands, of all new ones of a message in one line."""
        new = [name for name in dict.fromkeys(names) if name not in self._warned]
        new = new[: MOST_NAMES - len(self._warned)]
        if new:
            self._warned.update(new)
            shown = ", ".join(f"{name!r:.80}" for name in new[:MOST_SHOWN])
            more = f" and {len(new) - MOST_SHOWN} more" if len(new) > MOST_SHOWN else ""
            noun, verb = ("joint", "takes") if len(new) == 1 else ("joints", "take")
            topic = node_topics.node_names(self._node).topic(JOINT_COMMAND)
            self._log.warning(f"{topic}: {noun} {shown}{more} {verb} no commands (reported once)")

    def _warn_once(self, name: str, warning: str) -> None:
        if name not in self._warned and len(self._warned) < MOST_NAMES:
            self._warned.add(name)
            self._log.warning(warning)
