"""Plays a profile to a running gearbox over ROS 2: the part of the harness that needs rclpy."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import END, RESET
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import Result, unreached
from gear_dynamics_ros.messages.decoder import waveform_samples
from gear_dynamics_ros.ros.gearbox_client import POLL, GearboxClient, not_seen, ros_context
from gear_dynamics_ros.ros.node_topics import quality
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.topics import TOPICS, full_topic_name

# s of wall time after which an unchanged value is published again: the gearbox may have a command time-out.
REPEAT = 0.1
# s of wall time to wait for further chunks after the gearbox has ended or disappeared.
DRAIN = 0.5


class ProfileOutcome(NamedTuple):
    """Result of playing a profile."""

    results: tuple[Result, ...]  # of its expectations
    published: int  # commands
    failure: str  # why it was not played to its end; empty if it was
    signal: int  # number of the signal that interrupted it, 0 if none did


def play_profile(
    profile: Profile,
    node: str,
    wait: float,
    timeout: float,
    watch: Callable[[Player], None],
    ros_arguments: Sequence[str] = (),
) -> ProfileOutcome:
    """Play ``profile`` to the gearbox with the full name ``node``; ``watch`` is called after new chunks.

    Waits ``wait`` s for the gearbox to be ready, not counting its start, then at most ``timeout`` s for
    each answer and chunk. SIGINT and SIGTERM interrupt it; call it on the main thread.
    Raises UsageError on an invalid name.
    """
    with noted_signals() as received, ros_context(node, ros_arguments) as context:
        player = _ProfileClient(context, profile, node, timeout, watch, received)
        failure = ""
        try:
            player.join(wait)
            player.configure()
            player.follow()
        except GearboxError as error:
            failure = str(error)
        return player.outcome(failure)


class _ProfileClient(GearboxClient):
    """Plays one profile: subscriptions, publishers and the player, all on the caller's thread."""

    def __init__(
        self,
        context: Context,
        profile: Profile,
        node: str,
        timeout: float,
        watch: Callable[[Player], None],
        received: Sequence[int],
    ) -> None:
        super().__init__(context, "drive", node, timeout, received)
        self._profile = profile
        self._watch = watch
        self._publishers = {name: self._command_publisher(name) for name in profile.commands}
        self._waveform = self._listen("waveform", self._take_chunks)
        require_take_message(self._waveform)
        self._listen("event", self._take_event)
        self._player: Player | None = None
        self._joined = False
        self._reset_time = -1.0  # simulated time of the last reset event
        self._last_chunk = 0.0  # wall time
        self._last_time = 0.0  # simulated time
        self._end = (-1.0, "")  # simulated time and reason of the last end event
        self._last_published: dict[str, tuple[float, float]] = {}  # command: value, wall time
        self._published = 0

    def join(self, wait: float) -> None:
        """Wait until the gearbox offers what the profile needs and sends its waveform."""
        if not self._await_gearbox(self._ready, wait):
            raise GearboxError(self._absence(wait))

    def configure(self) -> None:
        """Set the parameters of the profile, all or none; then reset the gearbox, if the profile says so."""
        refusal = self._refusal(self._profile.parameters) if self._profile.parameters else ""
        if refusal:
            raise GearboxError(f"{self._name} refused the profile's parameters: {refusal}")
        if self._profile.reset:
            self._reset_gearbox()
        self._joined = True
        self._last_chunk = time.monotonic()

    def _reset_gearbox(self) -> None:
        """Reset the gearbox and wait for the event of it: chunks before it may arrive after the answer."""
        before = self._last_time
        self._succeed(self._reset, Trigger.Request(), "to reset")
        if not self._until(lambda: self._reset_time > before, self._timeout):
            raise GearboxError(
                f"{self._name} published no event of its reset for {self._timeout:g} s: see its log"
            )

    def follow(self) -> None:
        """Play until the profile has ended."""
        timeout = self._timeout
        while not (self._player is not None and self._player.finished):
            self._spin(POLL)
            silence = time.monotonic() - self._last_chunk
            if silence > min(DRAIN, timeout) and (self._ended or not self._waveform_publishers()):
                raise GearboxError(self._ending())
            if silence > timeout:
                raise GearboxError(
                    f"{self._name} sent no waveform for {timeout:g} s after {self._progress()}: "
                    "see whether it is paused, stuck or killed, or give a longer --timeout"
                )

    def outcome(self, failure: str) -> ProfileOutcome:
        """The results so far, after all published commands were acknowledged."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DRAIN))
        player = self._player
        results = unreached(self._profile.expectations) if player is None else player.results()
        return ProfileOutcome(results, self._published, failure, self._signal(failure))

    @property
    def _ended(self) -> str:
        """Reason of the end of the run; empty if it has not ended, or continues after a reset."""
        time, reason = self._end
        return reason if time >= self._last_time else ""

    def _command_publisher(self, command: str) -> Publisher:
        topic = TOPICS[f"{command}_command"]
        return self._ros.create_publisher(Float64, full_topic_name(topic, self._name), quality(topic))

    def _waveform_publishers(self) -> int:
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
        if not self._seen:
            return not_seen(self._name, wait)
        if not self._listening():
            return (
                f"{self._name} does not listen to {', '.join(self._publishers)} after {wait:g} s: see its log"
            )
        if not self._settable():
            return f"{self._name} offers no service to set its parameters after {wait:g} s: see its log"
        if not self._resettable():
            return f"{self._name} offers no service to reset it after {wait:g} s: see its log"
        ended = f" Its run has ended: {self._ended}." if self._ended else ""
        return (
            f"{self._name} is there, but sent no waveform for {wait:g} s: it may be starting, inactive, "
            f"paused or ended; see its log, or give a longer --wait.{ended}"
        )

    def _ending(self) -> str:
        if self._ended:
            return f"{self._name} ended the run at {self._progress()}: {self._ended}"
        return f"{self._name} disappeared at {self._progress()}: see its log"

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
        """Take all chunks that have arrived, then publish the commands that are due.

        An executor takes one message at a time, which is slow: after a delay the harness would stay behind.
        """
        waiting = [message]
        with self._waveform.handle:
            for _ in range(TOPICS["waveform"].depth):
                taken = self._waveform.handle.take_message(Float64MultiArray, False)
                if taken is None:
                    break
                waiting.append(taken[0])
        if self._joined and self._player is None:
            # Begin with the newest chunk. With an older one, the first commands would be late.
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
            last, published_at = self._last_published.get(name, (None, 0.0))
            if value != last or now - published_at >= REPEAT:
                self._publishers[name].publish(Float64(data=value))
                self._last_published[name] = (value, now)
                self._published += 1


def require_take_message(subscription: Subscription) -> None:
    """Raise GearboxError unless rclpy offers to take all messages that have arrived."""
    if not callable(getattr(subscription.handle, "take_message", None)):
        raise GearboxError(
            "rclpy: a subscription has no handle.take_message(type, raw): use the rclpy of ROS 2 Jazzy"
        )
