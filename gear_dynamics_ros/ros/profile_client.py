"""Plays a profile to a running gearbox over ROS 2: the part of the harness that needs rclpy."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import END, PAUSE, RESET, RESUME
from gear_dynamics_ros.harness.outcome import ProfileOutcome
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import unreached
from gear_dynamics_ros.messages.cdr import stamp_ns
from gear_dynamics_ros.messages.decoder import AppliedCommands, applied_commands, waveform_samples
from gear_dynamics_ros.parameters import command_bounds
from gear_dynamics_ros.ros.gearbox_client import (
    POLL,
    GearboxClient,
    not_seen,
    require_take_message,
    ros_context,
    take_waiting,
)
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.topics import TOPICS

# s of wall time after which an unchanged value is published again: the gearbox may have a command time-out.
REPEAT = 0.1
# s of wall time to wait for further chunks after the gearbox has ended or disappeared.
DRAIN = 0.5
# Messages about commands in force that are taken at once.
APPLIED_AT_ONCE = 100


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
        self._publishers: dict[str, Publisher] = {}
        self._player: Player | None = None
        self._joined = False
        self._reset_time = -1.0  # simulated time of the last reset event
        self._last_chunk = 0.0  # wall time
        self._first_chunk = 0.0  # wall time of profile time 0
        self._last_time = 0.0  # simulated time
        self._in_force: AppliedCommands | None = None
        self._paused = False
        self._acted_at = 0.0  # wall time since which commands are awaited
        self._end = (-1.0, "")  # simulated time and reason of the last end event
        self._last_published: dict[str, tuple[float, float]] = {}  # command: value, wall time
        self._published = 0

    def _connect(self) -> None:
        self._publishers = {name: self._advertise(f"{name}_command") for name in self._profile.commands}
        self._applied = self._listen("applied_command", self._take_applied)
        self._waveform = self._listen("waveform", self._take_chunks)
        require_take_message(self._waveform)
        self._listen("event", self._take_event)

    def join(self, wait: float) -> None:
        """Wait until the gearbox offers what the profile needs and sends its waveform."""
        if not self._await_gearbox(self._ready, wait):
            raise GearboxError(self._absence(wait))

    def configure(self) -> None:
        """Set the parameters of the profile, all or none; then reset the gearbox, if the profile says so."""
        refusal = self._refusal(self._profile.parameters) if self._profile.parameters else ""
        if refusal:
            raise GearboxError(f"{self._name} refused the profile's parameters: {refusal}")
        self._in_force = self._changed_by(self._profile.parameters)
        if self._profile.reset:
            self._reset_gearbox()
            self._in_force = self._changed_by({**self._present, **self._profile.parameters})
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

    def _changed_by(self, parameters: Mapping[str, Any]) -> AppliedCommands | None:
        """The commands in force after ``parameters`` were set, of which some are commands."""
        if self._in_force is None:
            return None
        values = {name: parameters.get(f"operation.{name}") for name in Commands._fields}
        given = {name: float(value) for name, value in values.items() if value is not None}
        return self._in_force._replace(commands=self._in_force.commands._replace(**given))

    def follow(self) -> None:
        """Play until the profile has ended."""
        while not (self._player is not None and self._player.finished):
            self._spin(POLL)
            self._require_chunks()
            self._require_commands()

    def _require_chunks(self) -> None:
        """Raise GearboxError if no more chunks will come: a gearbox that is paused or slow is waited for."""
        self._require_life()
        silence = time.monotonic() - self._last_chunk
        if silence > min(DRAIN, self._timeout) and (self._ended or not self._waveform_publishers()):
            raise GearboxError(self._ending())
        # Only what was heard after that time tells that it lives: otherwise wait for the answer.
        answered_after = self._heard_at - self._last_chunk
        if not self._paused and answered_after > self._timeout + self._chunk_time():
            raise GearboxError(
                f"{self._name} answers, but sent no waveform for {silence:.3g} s after {self._progress()}: "
                "see its log, or give a longer --timeout"
            )

    def _chunk_time(self) -> float:
        """Wall time that a chunk takes at the pace of the gearbox, s."""
        factor = float(self._present["pacing.real_time_factor"])
        return self._known.chunk_ns / 1e9 / factor if factor > 0.0 else 0.0

    def _require_commands(self) -> None:
        """Raise GearboxError if the gearbox goes on without the commands for which the player waits."""
        player, in_force = self._player, self._in_force
        waits = player is not None and player.awaiting and self._profile.expectations
        if player is None or in_force is None or not waits or self._paused:
            self._acted_at = time.monotonic()
            return
        if self._last_chunk - self._acted_at <= self._timeout + 2.0 * self._chunk_time():
            return
        # A value that replaced another one before the next chunk may be the one in force before both: no
        # message tells that it acted.
        player.acted(player.next_sample, in_force.commands)
        if player.awaiting:
            awaited = ", ".join(f"{name} {value:g}" for name, value in player.awaiting.items())
            raise GearboxError(
                f"{self._name} did not put {awaited} in force within {self._timeout:g} s at "
                f"{self._progress()}: it refused it (see its log), or another client commands it"
            )

    def outcome(self, failure: str) -> ProfileOutcome:
        """The results so far, after all published commands were acknowledged."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DRAIN))
        player = self._player
        results = unreached(self._profile.expectations) if player is None else player.results()
        lateness = [] if player is None else player.lateness
        elapsed = self._last_chunk - self._first_chunk
        factor = 0.0 if player is None or elapsed <= 0.0 else player.simulated / elapsed
        samples = None if player is None else player.samples()
        signal = self._signal(failure)
        return ProfileOutcome(
            results, self._published, lateness, factor, "", failure, signal, samples, self._described
        )

    @property
    def _ended(self) -> str:
        """Reason of the end of the run; empty if it has not ended, or continues after a reset."""
        time, reason = self._end
        return reason if time >= self._last_time else ""

    def _waveform_publishers(self) -> int:
        return int(self._ros.count_publishers(self._waveform.topic_name))

    def _listening(self) -> bool:
        return all(publisher.get_subscription_count() for publisher in self._publishers.values())

    def _settable(self) -> bool:
        return not self._profile.parameters or bool(self._parameters.service_is_ready())

    def _resettable(self) -> bool:
        return not self._profile.reset or bool(self._reset.service_is_ready())

    def _ready(self) -> bool:
        heard = self._last_chunk > 0.0 and self._in_force is not None
        return heard and self._listening() and self._settable() and self._resettable()

    def _absence(self, wait: float) -> str:
        if not self._seen:
            return not_seen(self._name, wait)
        if self._info is None:
            return (
                f"{self._name} is there, but published no ~/model_info for {wait:g} s: it may be starting, "
                "inactive, or have that topic remapped; see its log, give the same --ros-args -r, or a "
                "longer --wait"
            )
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
        if event["event"] in (PAUSE, RESUME):
            self._note_pause(paused=event["event"] == PAUSE)
        elif event["event"] == RESET:
            self._reset_time = float(event["time"])
        elif event["event"] == END:
            self._end = (float(event["time"]), str(event["message"]) or "no reason given")

    def _note_pause(self, *, paused: bool) -> None:
        self._paused = paused
        self._last_chunk = time.monotonic()
        if paused and self._player is not None:
            self._ros.get_logger().info(f"{self._name} is paused at {self._progress()}: waiting for it")

    def _take_applied(self, message: Any) -> None:
        for applied in take_waiting(self._applied, message, APPLIED_AT_ONCE):
            self._note_applied(AppliedCommands(stamp_ns(applied.header.stamp), applied_commands(applied)))
        if self._player is not None:
            self._publish(self._player.commands())

    def _note_applied(self, applied: AppliedCommands) -> None:
        self._in_force = applied
        self._acted_at = time.monotonic()
        if self._player is not None:
            self._player.acted(self._known.sample(applied.time_ns), applied.commands)

    def _take_chunks(self, message: Float64MultiArray) -> None:
        """Take all chunks that have arrived, then publish the commands that are due."""
        waiting = take_waiting(self._waveform, message, TOPICS["waveform"].depth)
        if self._joined and self._player is None:
            # Begin with the newest chunk. With an older one, the first commands would be late.
            del waiting[:-1]
        for chunk in waiting:
            self._take_chunk(chunk)
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
            self._player = Player(self._profile, channels, self._accepts)
            self._first_chunk = self._last_chunk
            if self._in_force is not None:
                self._player.acted(self._known.sample(self._in_force.time_ns), self._in_force.commands)
        self._player.feed(samples)

    def _accepts(self, name: str, value: float) -> bool:
        """Whether the gearbox takes the command: it refuses one that is out of bounds and keeps the last."""
        lowest, highest = command_bounds(float(self._present["operation.speed_limit"]))[name]
        return lowest <= value <= highest

    def _publish(self, values: dict[str, float]) -> None:
        now = time.monotonic()
        for name, value in values.items():
            last, published_at = self._last_published.get(name, (None, 0.0))
            if value != last or now - published_at >= REPEAT:
                self._publishers[name].publish(Float64(data=value))
                self._last_published[name] = (value, now)
                self._published += 1
