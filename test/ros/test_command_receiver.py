"""Commands reach the mailbox in the order of their arrival, whoever takes them."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator

import pytest
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_msgs.msg import Float64

from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.ros.command_receiver import CommandReceiver
from gear_dynamics_ros.ros.node_topics import create_subscriptions
from gear_dynamics_ros.topics import FLOAT64, FLOAT_COMMANDS
from support.gearbox import Peer

COUNT = 60  # on each topic; less than COMMAND_DEPTH


@pytest.fixture
def mailbox() -> Mailbox:
    return Mailbox(Parameters(), time.monotonic_ns())


@pytest.fixture
def receiver(ros_domain: int, mailbox: Mailbox) -> Iterator[CommandReceiver]:
    with Peer("gearbox") as gearbox:
        receiver = CommandReceiver(gearbox.node, mailbox, "")
        receiver.listen(dict(create_subscriptions(gearbox.node, MutuallyExclusiveCallbackGroup())))
        yield receiver


@pytest.fixture
def client(receiver: CommandReceiver) -> Iterator[Peer]:
    with Peer("client") as client:
        yield client


def publish_in_turns(client: Peer) -> list[tuple[str, float]]:
    """Publish on all topics of one number in a mixed order; returns key in TOPICS and value of each."""
    publishers = {key: client.publisher(key) for key in FLOAT_COMMANDS}
    client.until(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))
    keys = [*publishers] * COUNT
    random.Random(3).shuffle(keys)
    sent = [(key, float(number)) for number, key in enumerate(keys)]
    for key, value in sent:
        publishers[key].publish(Float64(data=value))
    return sent


def accepted(mailbox: Mailbox) -> int:
    return mailbox.counts(time.monotonic_ns()).accepted


def received(mailbox: Mailbox) -> list[tuple[str, float]]:
    return [(key, deserialize(FLOAT64, data).data) for key, data in mailbox.take(0).received]


def test_what_waits_is_taken_in_the_order_of_arrival(
    receiver: CommandReceiver, client: Peer, mailbox: Mailbox
) -> None:
    sent = publish_in_turns(client)

    def all_taken() -> bool:
        receiver.collect()
        return accepted(mailbox) == len(sent)

    client.until(all_taken)
    assert received(mailbox) == sent


def test_two_threads_that_take_commands_keep_their_order(
    receiver: CommandReceiver, client: Peer, mailbox: Mailbox
) -> None:
    ended = threading.Event()

    def take() -> None:
        while not ended.is_set():
            receiver.collect()

    threads = [threading.Thread(target=take) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        sent = publish_in_turns(client)
        client.until(lambda: accepted(mailbox) == len(sent))
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    assert received(mailbox) == sent
