"""Plays a profile to a paused gearbox over ROS 2, stepping it: each command acts at exactly its sample."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from rclpy.context import Context
from std_msgs.msg import Float64MultiArray

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness.lockstep import profile_script
from gear_dynamics_ros.harness.outcome import ProfileOutcome
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import unreached
from gear_dynamics_ros.messages.decoder import waveform_samples
from gear_dynamics_ros.ros.gearbox_client import require_take_message, ros_context, take_waiting
from gear_dynamics_ros.ros.lockstep_client import LockstepClient, play_and_leave
from gear_dynamics_ros.script import LockstepScript
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.topics import TOPICS


def play_profile_in_lockstep(
    profile: Profile,
    node: str,
    wait: float,
    timeout: float,
    watch: Callable[[Player], None],
    ros_arguments: Sequence[str] = (),
) -> ProfileOutcome:
    """As ``play_profile``, but each command acts at exactly its sample.

    At the end, also after a failure, the gearbox runs or is paused as before. Also raises UsageError if an
    entry of the profile starts or ends within a chunk of the gearbox.
    """
    with noted_signals() as received, ros_context(node, ros_arguments) as context:
        player = _LockstepProfileClient(context, profile, node, timeout, watch, received)
        return player.outcome(play_and_leave(player, node, wait))


class _LockstepProfileClient(LockstepClient):
    """Plays one profile in lockstep, and measures the waveform of each step before the next one."""

    # A step makes no more chunks than the queue of the waveform holds.
    most_chunks = TOPICS["waveform"].depth // 2

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
        self._player: Player | None = None
        self._arrived_ns = 0  # time of the script up to which the waveform has come
        self._began = self._ended = 0.0  # wall time

    def outcome(self, failure: str) -> ProfileOutcome:
        """Results of the play; ``failure`` is empty if it succeeded so far."""
        failure = self._failure(failure)
        player, elapsed = self._player, self._ended - self._began
        factor = self._arrived_ns / 1e9 / elapsed if elapsed > 0.0 else 0.0
        results = unreached(self._profile.expectations) if player is None else player.results()
        samples = None if player is None else player.samples()
        state, signal = self._left_state, self._signal(failure)
        return ProfileOutcome(
            results, self._published, [], factor, state, failure, signal, samples, self._described
        )

    def _connect(self) -> None:
        # Before the events: the gearbox that has sent an event of the pause knows this subscription too.
        self._waveform = self._listen("waveform", self._take_chunks)
        require_take_message(self._waveform)
        super()._connect()

    def _make_script(self) -> LockstepScript:
        return profile_script(self._profile, self._known.chunk_ns)

    def _note_progress(self) -> None:
        """Measure what the step made."""
        self._began = self._began or time.monotonic()
        if not self._until(lambda: self._arrived_ns >= self._time_ns, self._timeout):
            raise GearboxError(
                f"{self._name} sent no waveform of {self._arrived_ns / 1e9:.9g} to "
                f"{self._time_ns / 1e9:.9g} s of the profile within {self._timeout:g} s: see its log"
            )
        self._ended = time.monotonic()
        if self._player is not None:
            self._watch(self._player)

    def _take_chunks(self, message: Float64MultiArray) -> None:
        if self._origin < 0:
            return
        for chunk in take_waiting(self._waveform, message, TOPICS["waveform"].depth):
            channels, samples = waveform_samples(chunk)
            player = self._joined_player(channels)
            first = round(float(samples[0, channels.index("time")]) * 1e9 / self._known.interval_ns)
            if first < self._origin:  # made before the pause
                continue
            player.feed(samples)
            self._arrived_ns = (first + len(samples) - self._origin) * self._known.interval_ns

    def _joined_player(self, channels: Sequence[str]) -> Player:
        if self._player is None:
            # The script has the commands: time on the axis of this player is simulated time.
            self._player = Player(replace(self._profile, commands={}), channels)
            self._player.begin(self._origin, self._known.interval_ns)
        return self._player
