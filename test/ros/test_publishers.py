"""What the node publishes: nothing of a chunk that nobody listens to."""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.ros.node_topics import Listeners, PublisherSink, create_publishers
from gear_dynamics_ros.simulation.engine import Engine
from support.gearbox import Peer


def publisher_sink(peer: Peer) -> PublisherSink:
    listeners = Listeners(["clock"])
    group = MutuallyExclusiveCallbackGroup()
    return PublisherSink(dict(create_publishers(peer.node, group, listeners, clock=True)), listeners)


def test_only_topics_with_a_listener_are_asked_for_and_published(ros_domain: int) -> None:
    with Peer("gearbox") as gearbox, Peer("listener") as listener:
        sink = publisher_sink(gearbox)
        assert set(sink.wanted()) == {"clock"}, "its last message waits for who joins in a pause"
        heard: list[Any] = []
        subscription = listener.subscribe("dte", heard.append)
        gearbox.until(lambda: "dte" in sink.wanted())
        assert set(sink.wanted()) == {"clock", "dte"}
        parameters = Parameters()
        chunk = Engine(parameters).advance()
        sink.write(chunk, Encoder(parameters, 0).chunk(chunk))
        listener.until(lambda: heard)
        assert heard[0].data == chunk["dte"][-1]
        listener.node.destroy_subscription(subscription)
        # Both must let messages in: one to drop its subscription, the other to hear of that.
        gearbox.until(lambda: listener.executor.spin_once(timeout_sec=0.0) or set(sink.wanted()) == {"clock"})
