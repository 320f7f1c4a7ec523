"""Plays a profile to a running gearbox over ROS 2 topics: the rclpy half of the harness."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import END, RESET
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import Result, unreached
from gear_dynamics_ros.messages.decoder import waveform_samples
from gear_dynamics_ros.ros.client_context import ros_context
from gear_dynamics_ros.ros.node_topics import quality
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.topics import TOPICS, resolve

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
    signal: int  # the number of the signal that broke the run off, 0 if none did


def play(
    profile: Profile,
    node: str,
    wait: float,
    timeout: float,
    watch: Callable[[Player], None],
    ros_arguments: Sequence[str] = (),
) -> Outcome:
    """Play ``profile`` to the gearbox with the full name ``node``; ``watch`` is called when chunks have come.

    Waits ``wait`` s for the gearbox to be ready, then at most ``timeout`` s for each answer and chunk.
    SIGINT and SIGTERM break the run off; call it on the main thread. Raises UsageError on an impossible name.
    """
    with noted_signals() as received, ros_context(node, ros_arguments) as context:
        session = _Session(context, profile, node, watch, received)
        failure = ""
        try:
            session.join(wait)
            session.configure(timeout)
            session.follow(timeout)
        except GearboxError as error:
            failure = str(error)
        return session.outcome(failure)


class _Session:
    """One run: subscriptions, publishers and the player between them, all on the caller's thread."""

    def __init__(
        self,
        context: Context,
        profile: Profile,
        node: str,
        watch: Callable[[Player], None],
        received: Sequence[int],
    ) -> None:
        self._name = node
        self._profile = profile
        self._watch = watch
        self._received = received
        self._ros = Node("drive", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._ros)
        self._publishers = {name: self._command_publisher(name) for name in profile.commands}
        self._waveform = self._ros.create_subscription(
            Float64MultiArray, self._topic("waveform"), self._take_chunks, quality(TOPICS["waveform"])
        )
        self._events = self._ros.create_subscription(
            String, self._topic("event"), self._take_event, quality(TOPICS["event"])
        )
        self._parameters: Any = self._ros.create_client(
            SetParametersAtomically, f"{node}/set_parameters_atomically"
        )
        self._reset: Any = self._ros.create_client(Trigger, f"{node}/reset")
        self._player: Player | None = None
        self._joined = False
        self._reset_time = -1.0  # simulated time of the last reset told
        self._last_chunk = 0.0  # wall time
        self._last_time = 0.0  # simulated time
        self._end = (-1.0, "")  # simulated time and reason of the last end told
        self._said: dict[str, tuple[float, float]] = {}  # command: value, wall time
        self._published = 0

    def join(self, wait: float) -> None:
        """Return once the gearbox takes everything the profile sets and sends its waveform."""
        deadline = time.monotonic() + wait
        while not self._ready():
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise GearboxError(self._absence(wait))
            self._spin(left)

    def configure(self, timeout: float) -> None:
        """Set the profile's parameters, all or none; then put the gearbox back, if the profile wants that."""
        if self._profile.parameters:
            request = SetParametersAtomically.Request()
            request.parameters = [
                Parameter(name, value=value).to_parameter_msg()
                for name, value in self._profile.parameters.items()
            ]
            answer = self._answer(
                self._parameters.call_async(request), "whether it takes the parameters", timeout
            )
            if not answer.result.successful:
                raise GearboxError(
                    f"{self._name} refused the profile's parameters: {' '.join(answer.result.reason.split())}"
                )
        if self._profile.reset:
            self._put_back(timeout)
        self._joined = True
        self._last_chunk = time.monotonic()

    def _put_back(self, timeout: float) -> None:
        """Reset the gearbox, and learn when that was: chunks made before may arrive after the answer."""
        before = self._last_time
        answer = self._answer(self._reset.call_async(Trigger.Request()), "that it was reset", timeout)
        if not answer.success:
            raise GearboxError(f"{self._name} was not reset: {' '.join(answer.message.split())}")
        deadline = time.monotonic() + timeout
        while self._reset_time <= before:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise GearboxError(f"{self._name} told no event of its reset for {timeout:g} s: see its log")
            self._spin(left)

    def follow(self, timeout: float) -> None:
        """Return when the profile was played to its end."""
        while not (self._player is not None and self._player.finished):
            self._spin(POLL)
            silence = time.monotonic() - self._last_chunk
            if silence > min(DRAIN, timeout) and (self._ended or not self._senders()):
                raise GearboxError(self._ending())
            if silence > timeout:
                raise GearboxError(
                    f"{self._name} sent no waveform for {timeout:g} s after {self._progress()}: "
                    "see whether it is paused, stuck or killed, or give a longer --timeout"
                )

    def _spin(self, longest: float) -> None:
        """Serve what comes within ``longest`` s, POLL s at most."""
        if self._received:
            name = signal.Signals(self._received[0]).name
            raise GearboxError(f"interrupted by {name} at {self._progress()}")
        self._executor.spin_once(timeout_sec=min(POLL, longest))

    def _answer(self, future: Any, what: str, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not future.done():
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise GearboxError(
                    f"{self._name} did not say within {timeout:g} s {what}: see its log, or give a longer "
                    "--timeout"
                )
            self._spin(left)
        return future.result()

    def outcome(self, failure: str) -> Outcome:
        """The results so far; the last commands are on their way by then."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DRAIN))
        player = self._player
        results = unreached(self._profile.expectations) if player is None else player.results()
        number = self._received[0] if failure and self._received else 0
        return Outcome(results, self._published, failure, number)

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

    def _settable(self) -> bool:
        return not self._profile.parameters or bool(self._parameters.service_is_ready())

    def _resettable(self) -> bool:
        return not self._profile.reset or bool(self._reset.service_is_ready())

    def _ready(self) -> bool:
        return self._last_chunk > 0.0 and self._listening() and self._settable() and self._resettable()

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
        if not self._settable():
            return f"{self._name} offers no service to set its parameters after {wait:g} s: see its log"
        if not self._resettable():
            return f"{self._name} offers no service to reset it after {wait:g} s: see its log"
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
        if event["event"] == RESET:
            self._reset_time = float(event["time"])
        elif event["event"] == END:
            self._end = (float(event["time"]), str(event["message"]) or "no reason given")

    def _take_chunks(self, message: Float64MultiArray) -> None:
        """Take all chunks that wait, then say what is due now.

        An executor turns once for each message, which costs more than the chunk itself: after a hold-up the
        harness would stay behind.
        """
        waiting = [message]
        with self._waveform.handle:
            for _ in range(TOPICS["waveform"].depth):
                taken = self._waveform.handle.take_message(Float64MultiArray, False)
                if taken is None:
                    break
                waiting.append(taken[0])
        if self._joined and self._player is None:
            # Time 0 is now: from the oldest on, the first commands would come late by all that waited.
            del waiting[:-1]
        for message in waiting:
            self._take_chunk(message)
        if self._player is not None:
            self._publish(self._player.commands())
            self._watch(self._player)

    def _take_chunk(self, message: Float64MultiArray) -> None:
        channels, samples = waveform_samples(message)
        self._last_chunk = time.monotonic()
        self._last_time = float(samples[-1, 0])
        if not self._joined or (self._player is not None and self._player.finished):
            return
        if self._player is None and self._last_time < self._reset_time:
            return
        if self._player is None:
            self._player = Player(self._profile, channels)
        self._player.feed(samples)

    def _publish(self, values: dict[str, float]) -> None:
        now = time.monotonic()
        for name, value in values.items():
            said, at = self._said.get(name, (None, 0.0))
            if value != said or now - at >= REPEAT:
                self._publishers[name].publish(Float64(data=value))
                self._said[name] = (value, now)
                self._published += 1
