"""Passes command messages from their topics to the mailbox of the engine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.decoder import requested_changes
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.ros import node_topics
from gear_dynamics_ros.topics import COMMAND_TOPICS, JOINT_COMMAND

WARNING_INTERVAL = 5.0  # s
MOST_NAMES = 1000  # of joints and topics in warnings
MOST_SHOWN = 5  # of joints in one warning


class CommandReceiver:
    """Decodes commands, passes them to the mailbox, and warns of invalid ones."""

    def __init__(self, node: Node, mailbox: Mailbox, joint_prefix: str) -> None:
        self._node = node
        self._log: Any = node.get_logger()
        self._mailbox = mailbox
        self._joint_prefix = joint_prefix
        self._warned: set[str] = set()

    def receive(self, key: str, data: bytes) -> None:
        """Take the message ``data`` (CDR) on the command topic ``key`` (in TOPICS)."""
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

    def topics_with_several_publishers(self) -> list[str]:
        """Full names of the command topics that have several publishers."""
        names = node_topics.node_names(self._node)
        commands = [names.topic(key) for key in COMMAND_TOPICS]
        topics = [name for name in commands if self._node.count_publishers(name) > 1]
        for name in topics:
            self._warn_once(
                name,
                f"{name} has several publishers: the last message before a chunk edge counts (reported once)",
            )
        return topics

    def _warn_of_joints(self, names: Sequence[str]) -> None:
        """Warn once of each joint without commands, of all new ones of a message in one line."""
        new = [name for name in dict.fromkeys(names) if name not in self._warned]
        new = new[: MOST_NAMES - len(self._warned)]
        if new:
            self._warned.update(new)
            shown = ", ".join(f"'{name}'" for name in new[:MOST_SHOWN])
            more = f" and {len(new) - MOST_SHOWN} more" if len(new) > MOST_SHOWN else ""
            noun, verb = ("joint", "takes") if len(new) == 1 else ("joints", "take")
            topic = node_topics.node_names(self._node).topic(JOINT_COMMAND)
            self._log.warning(f"{topic}: {noun} {shown}{more} {verb} no commands (reported once)")

    def _warn_once(self, name: str, warning: str) -> None:
        if name not in self._warned and len(self._warned) < MOST_NAMES:
            self._warned.add(name)
            self._log.warning(warning)
