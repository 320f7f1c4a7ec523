"""Plays a profile to a running gearbox over ROS 2 topics: the rclpy half of the harness."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64, Float64MultiArray, String

from gear_dynamics_ros.discovery import stay_local
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness import Player, Profile, Result
from gear_dynamics_ros.messages import TOPICS, resolve, waveform_samples
from gear_dynamics_ros.node_topics import quality

# s of wall time after which a value that stays is said again: a gearbox may have a command timeout.
REPEAT = 0.1
# s of wall time in which chunks under way may still arrive after the gearbox ended or left the graph.
DRAIN = 0.5
POLL = 0.1


class Outcome(NamedTuple):
    """How a run went; ``failure`` tells why the profile was not played to its end, empty if it was."""

    results: tuple[Result, ...]
    published: int
    failure: str


def play(
    profile: Profile,
    node: str,
    wait: float,
    timeout: float,
    watch: Callable[[Player], None],
    ros_arguments: Sequence[str] = (),
) -> Outcome:
    """Play ``profile`` to the gearbox with the full name ``node``; ``watch`` is called after each chunk.

    Waits ``wait`` s for the gearbox to be ready, and later at most ``timeout`` s for its next chunk.
    Raises UsageError on an impossible name, GearboxError where no gearbox is there or it can't be followed.
    """
    with _session(profile, node, watch, ros_arguments) as session:
        session.join(wait)
        failure = session.follow(timeout)
        return session.outcome(failure)


@contextmanager
def _session(
    profile: Profile, node: str, watch: Callable[[Player], None], ros_arguments: Sequence[str]
) -> Iterator[_Session]:
    stay_local()
    context = Context()
    try:
        rclpy.init(args=list(ros_arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # what rclpy raises on arguments it can't read
        raise UsageError(f"ROS did not start: {' '.join(str(error).split())}") from error
    try:
        yield _Session(context, profile, node, watch)
    except InvalidTopicNameException as error:
        raise UsageError(f"--node is {node!r}, no name of a ROS node: give one like /gearbox") from error
    finally:
        context.try_shutdown()


class _Session:
    """One run: subscriptions, publishers and the player between them, all on the caller's thread."""

    def __init__(
        self, context: Context, profile: Profile, node: str, watch: Callable[[Player], None]
    ) -> None:
        self._name = node
        self._profile = profile
        self._watch = watch
        self._ros = Node("drive", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._ros)
        self._publishers = {name: self._command_publisher(name) for name in profile.commands}
        self._waveform = self._ros.create_subscription(
            Float64MultiArray, self._topic("waveform"), self._take_chunk, quality(TOPICS["waveform"])
        )
        self._events = self._ros.create_subscription(
            String, self._topic("event"), self._take_event, quality(TOPICS["event"])
        )
        self._player: Player | None = None
        self._joined = False
        self._last_chunk = 0.0  # wall time
        self._last_time = 0.0  # simulated time
        self._end = (-1.0, "")  # simulated time and reason of the last end told
        self._said: dict[str, tuple[float, float]] = {}  # command: value, wall time
        self._published = 0

    def join(self, wait: float) -> None:
        """Return once the gearbox listens to every command of the profile and sends its waveform."""
        deadline = time.monotonic() + wait
        while not self._ready():
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise GearboxError(self._absence(wait))
            self._executor.spin_once(timeout_sec=min(POLL, left))
        self._joined = True
        self._last_chunk = time.monotonic()

    def follow(self, timeout: float) -> str:
        """Play to the end of the profile; returns why that end was not reached, or nothing."""
        while not (self._player is not None and self._player.finished):
            try:
                self._executor.spin_once(timeout_sec=POLL)
            except GearboxError as error:
                return str(error)
            silence = time.monotonic() - self._last_chunk
            if silence > min(DRAIN, timeout) and (self._ended or not self._senders()):
                return self._ending()
            if silence > timeout:
                return (
                    f"{self._name} sent no waveform for {timeout:g} s after {self._progress()}: "
                    "see whether it is paused, stuck or killed, or give a longer --timeout"
                )
        return ""

    def outcome(self, failure: str) -> Outcome:
        """The results so far; the last commands are on their way by then."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DRAIN))
        results = self._profile.unreached() if self._player is None else self._player.results()
        return Outcome(results, self._published, failure)

    @property
    def _ended(self) -> str:
        """Why the run ended, if nothing came after that."""
        at, reason = self._end
        return reason if at >= self._last_time else ""

    def _topic(self, key: str) -> str:
        return resolve(TOPICS[key], self._name)

    def _command_publisher(self, command: str) -> Publisher:
        key = f"{command}_command"
        return self._ros.create_publisher(Float64, self._topic(key), quality(TOPICS[key]))

    def _senders(self) -> int:
        return int(self._ros.count_publishers(self._waveform.topic_name))

    def _listening(self) -> bool:
        return all(publisher.get_subscription_count() for publisher in self._publishers.values())

    def _ready(self) -> bool:
        return self._last_chunk > 0.0 and self._listening()

    def _absence(self, wait: float) -> str:
        if not self._senders():
            return (
                f"no gearbox {self._name} was seen for {wait:g} s: start it, name it with --node, compare "
                "ROS_DOMAIN_ID, or give a longer --wait"
            )
        if not self._listening():
            return (
                f"{self._name} does not listen to {', '.join(self._publishers)} after {wait:g} s: see its log"
            )
        told = f" It said: {self._ended}." if self._ended else ""
        return (
            f"{self._name} is there, but sent no waveform for {wait:g} s: it may be starting, inactive, "
            f"paused or ended; see its log, or give a longer --wait.{told}"
        )

    def _ending(self) -> str:
        if self._ended:
            return f"{self._name} ended the run at {self._progress()}: {self._ended}"
        return f"{self._name} vanished at {self._progress()}: see its log"

    def _progress(self) -> str:
        played = self._player.time if self._player is not None else 0.0
        return f"{played:.6g} s of the profile's {self._profile.duration:g} s"

    def _take_event(self, message: String) -> None:
        event = json.loads(message.data)
        if event["event"] == "end":
            self._end = (float(event["time"]), str(event["message"]) or "no reason given")

    def _take_chunk(self, message: Float64MultiArray) -> None:
        channels, samples = waveform_samples(message)
        self._last_chunk = time.monotonic()
        self._last_time = float(samples[-1, 0])
        if not self._joined or (self._player is not None and self._player.finished):
            return
        if self._player is None:
            self._player = Player(self._profile, channels)
        self._publish(self._player.feed(samples))
        self._watch(self._player)

    def _publish(self, values: dict[str, float]) -> None:
        now = time.monotonic()
        for name, value in values.items():
            said, at = self._said.get(name, (None, 0.0))
            if value != said or now - at >= REPEAT:
                self._publishers[name].publish(Float64(data=value))
                self._said[name] = (value, now)
                self._published += 1
