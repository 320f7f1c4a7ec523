"""Plays a script to a paused gearbox over ROS 2, stepping it, so that each action is at its exact sample."""

from __future__ import annotations

import json
import math
import random
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from rclpy.context import Context
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError, one_line
from gear_dynamics_ros.events import CHANGE, PAUSE
from gear_dynamics_ros.messages.cdr import stamp_ns
from gear_dynamics_ros.messages.decoder import AppliedCommands, applied_commands
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.ros.gearbox_client import GearboxClient, not_seen, ros_context
from gear_dynamics_ros.script import (
    LockstepScript,
    ResetAction,
    ScriptAction,
    ScriptStep,
    agree,
    require_chunk_edges,
)
from gear_dynamics_ros.system.processes import noted_signals

# Longest simulated time of one call of ~/step. Signals and progress are handled between two calls.
LONGEST_STEP_NS = 200_000_000
MOST_CHUNKS = 1_000_000  # upper bound of stepping.chunks
_DOUBT = "see its log: it may have refused one or received it late, or another client commands it"
# Parameters of the gearbox that this client sets, and sets back at the end.
STEP_CHUNKS, STEP_TIMEOUT = "stepping.chunks", "stepping.timeout"


class ScriptOutcome(NamedTuple):
    """Result of playing a script."""

    origin: int  # sample of the gearbox at time 0 of the script; -1 if that was not reached
    time_ns: int  # simulated since then
    published: int  # commands
    state: str  # of the gearbox, as before the play: "runs again" or "stays paused"; empty if not changed
    failure: str  # why it was not played to its end; empty if it was
    signal: int  # number of the signal that interrupted it, 0 if none did


def play_script(
    script: LockstepScript,
    node: str,
    wait: float,
    timeout: float,
    watch: Callable[[int], None],
    ros_arguments: Sequence[str] = (),
) -> ScriptOutcome:
    """Play ``script`` to the gearbox with the full name ``node``; ``watch`` gets the time played, ns.

    Waits ``wait`` s for the gearbox to be ready, not counting its start, then at most ``timeout`` s for
    each answer. SIGINT and SIGTERM interrupt it; call it on the main thread. At the end, also after a
    failure, the gearbox runs or is paused as before. Raises UsageError on an invalid name, and if a step of
    the script lies within a chunk.
    """
    with noted_signals() as received, ros_context(node, ros_arguments) as context:
        player = _ScriptClient(context, script, node, timeout, watch, received)
        return player.outcome(play_and_leave(player, node, wait))


def play_and_leave(client: LockstepClient, node: str, wait: float) -> str:
    """Play with ``client`` and put the gearbox ``node`` back as before; returns what failed, or "".

    Raises UsageError if the script does not fit the gearbox.
    """
    failures: list[str] = []
    try:
        client.join(wait)
        client.play()
    except UsageError:
        raise
    except GearboxError as error:
        failures.append(str(error))
    try:
        client.leave()
    except GearboxError as error:
        failures.append(f"{node} was not put back as before: {error}")
    return "; ".join(failures)


class LockstepClient(GearboxClient):
    """Plays one script to a gearbox that it pauses and steps, all on the caller's thread.

    A command is published before the step that must use it, but ROS does not guarantee that it arrives first.
    So this is checked: ``~/command/applied`` names the sample from which commands are in force.
    """

    # Upper bound of the chunks of one call of ~/step.
    most_chunks = MOST_CHUNKS

    def __init__(
        self, context: Context, client: str, gearbox: str, timeout: float, received: Sequence[int]
    ) -> None:
        """As ``GearboxClient``."""
        super().__init__(context, client, gearbox, timeout, received)
        self._pause: Any = self._ros.create_client(SetBool, f"{gearbox}/pause")
        self._step: Any = self._ros.create_client(Trigger, f"{gearbox}/step")
        self._services = (self._pause, self._step, self._reset, self._parameters)
        self._script: LockstepScript | None = None
        self._events: list[Mapping[str, Any]] = []
        self._in_force: AppliedCommands | None = None
        self._expected: dict[int, Commands] = {}  # by stamp
        self._unexpected: AppliedCommands | None = None
        self._stepping: dict[str, Any] = {}  # as set here
        self._found_running = False
        self._origin = -1
        self._origin_ns = 0  # stamp
        self._time_ns = 0
        self._published = 0

    @abstractmethod
    def _make_script(self) -> LockstepScript:
        """The script to play, for the gearbox as it is now known. Raises UsageError if it does not fit."""

    @abstractmethod
    def _note_progress(self) -> None:
        """The gearbox has been stepped to the time ``_time_ns`` of the script."""

    def _connect(self) -> None:
        self._commands = self._advertise("joint_command")
        self._listen("event", self._take_event)
        self._listen("applied_command", self._take_applied)

    # The phases of a play, in this order

    def join(self, wait: float) -> None:
        """Wait until the gearbox offers all services and listens to commands."""
        if not self._await_gearbox(self._ready, wait):
            raise GearboxError(self._absence(wait))

    def play(self) -> None:
        """Play the script to its end, rounded up to a whole chunk."""
        gearbox = self._known
        self._script = script = self._make_script()
        require_chunk_edges(script, gearbox.chunk_ns)
        steps = script.steps
        self._pause_and_locate(resets=ResetAction() in steps[0].actions)
        ends = [step.time_ns for step in steps[1:]]
        last = -(-script.duration_ns // gearbox.chunk_ns) * gearbox.chunk_ns
        for step, end_ns in zip(steps, [*ends, last], strict=True):
            for action in step.actions:
                self._perform(action)
            self._command(step)
            self._advance(end_ns)
            self._check(step)

    def leave(self) -> None:
        """Let the gearbox run again if it ran before, and set its parameters back."""
        self._interruptible = False
        if not self._stepping:
            return
        if self._found_running:
            self._succeed(self._pause, SetBool.Request(data=False), "to continue")
        self._set({name: self._known.parameters[name] for name in (STEP_CHUNKS, STEP_TIMEOUT)})

    @property
    def _left_state(self) -> str:
        """How the gearbox is left, as it was before the play; empty if it was not paused here."""
        if self._origin < 0:
            return ""
        return "runs again" if self._found_running else "stays paused"

    def _failure(self, failure: str) -> str:
        """``failure``, or that other commands were in force; empty if all went well."""
        if not failure and self._unexpected is not None:
            return self._other_commands(self._unexpected)
        return failure

    # The gearbox

    def _pause_and_locate(self, *, resets: bool) -> None:
        """Pause the gearbox; note its next sample, and whether it ran before.

        ``resets``: whether the script begins with a reset.
        """
        self._interruptible = False
        self._set({STEP_TIMEOUT: min(self._timeout, specifications()[STEP_TIMEOUT].maximum or self._timeout)})
        self._next_sample()
        self._events.clear()
        self._pause_gearbox(resets=resets)
        # Events arrive in order: if the gearbox ran, an event of the pause has arrived before this one.
        self._origin = self._next_sample()
        self._origin_ns = self._known.epoch_ns + self._origin * self._known.interval_ns
        self._found_running = any(event["event"] == PAUSE for event in self._events)
        self._interruptible = True

    def _pause_gearbox(self, *, resets: bool) -> None:
        request = SetBool.Request(data=True)
        answer = self._answer(self._pause, request, "to pause")
        if not answer.success and resets:
            # A run that has ended can be paused only after a reset.
            self._perform(ResetAction())
            answer = self._answer(self._pause, request, "to pause")
        if not answer.success:
            raise GearboxError(f"{self._name} did not pause: {one_line(answer.message)}")

    def _next_sample(self) -> int:
        """The next sample of the gearbox, from the event of a change of parameters that this makes."""
        # Latched events of an earlier play may still arrive: a random value identifies the event.
        number = random.randrange(2, MOST_CHUNKS)
        samples: list[int] = []

        def arrived() -> bool:
            samples.extend(
                int(event["sample"])
                for event in self._events
                if event["event"] == CHANGE and event.get("parameters", {}).get(STEP_CHUNKS) == number
            )
            return bool(samples)

        self._set({STEP_CHUNKS: number})
        if not self._until(arrived, self._timeout):
            raise GearboxError(f"{self._name} published no event for {self._timeout:g} s: see its log")
        return samples[0]

    def _perform(self, action: ScriptAction) -> None:
        if isinstance(action, ResetAction):
            self._succeed(self._reset, Trigger.Request(), "to reset")
        else:
            self._set(action.parameters)

    def _command(self, step: ScriptStep) -> None:
        commands = step.commands
        self._expected[self._origin_ns + step.time_ns] = commands
        if all(map(math.isnan, commands)):
            return
        message = JointState(
            name=list(self._known.joints),
            velocity=[commands.speed, math.nan],
            effort=[commands.drive_torque, commands.load_torque],
        )
        message.header.stamp = self._ros.get_clock().now().to_msg()
        self._commands.publish(message)
        self._published += 1

    def _advance(self, end_ns: int) -> None:
        """Step the gearbox to the time ``end_ns`` of the script."""
        chunk_ns = self._known.chunk_ns
        most = min(max(1, LONGEST_STEP_NS // chunk_ns), self.most_chunks)
        while self._time_ns < end_ns:
            chunks = min(most, (end_ns - self._time_ns) // chunk_ns)
            if self._stepping[STEP_CHUNKS] != chunks:
                self._set({STEP_CHUNKS: chunks})
            self._succeed(self._step, Trigger.Request(), f"to make {chunks} chunks")
            self._time_ns += chunks * chunk_ns
            self._note_progress()

    def _check(self, step: ScriptStep) -> None:
        """Raise GearboxError unless the commands of ``step`` acted from its sample on."""

        def reported() -> bool:
            in_force = self._in_force is not None and agree(step.commands, self._in_force.commands)
            return in_force or self._unexpected is not None

        self._until(reported, self._timeout)
        if self._unexpected is not None:
            raise GearboxError(self._other_commands(self._unexpected))
        if not reported():
            raise GearboxError(
                f"{self._name} did not put the commands of {step.time_ns / 1e9:.9g} s in force: "
                f"{step.commands}; {_DOUBT}"
            )

    def _other_commands(self, found: AppliedCommands) -> str:
        seconds = (found.time_ns - self._origin_ns) / 1e9
        return (
            f"{self._name} has commands in force from {seconds:.9g} s of {self._source} on that are not "
            f"those of that moment: {found.commands}; {_DOUBT}"
        )

    def _set(self, values: Mapping[str, Any]) -> None:
        refusal = self._refusal(values)
        if refusal:
            raise GearboxError(f"{self._name} refused to set {', '.join(values)}: {refusal}")
        for name in values.keys() & {STEP_CHUNKS, STEP_TIMEOUT}:
            self._stepping[name] = values[name]

    @property
    def _source(self) -> str:
        return "the script" if self._script is None else self._script.source

    def _progress(self) -> str:
        if self._script is None:
            return "its start"
        played, whole = self._time_ns / 1e9, self._script.duration_ns / 1e9
        return f"{played:.6g} s of {self._source}'s {whole:.6g} s"

    # Messages of the gearbox

    def _take_event(self, message: String) -> None:
        self._events.append(json.loads(message.data))

    def _take_applied(self, message: Any) -> None:
        self._in_force = applied = AppliedCommands(stamp_ns(message.header.stamp), applied_commands(message))
        if self._origin < 0 or applied.time_ns < self._origin_ns:
            return
        wanted = self._expected.get(applied.time_ns)
        if wanted is None or not agree(wanted, applied.commands):
            self._unexpected = self._unexpected or applied

    def _ready(self) -> bool:
        return (
            self._info is not None
            and bool(self._commands.get_subscription_count())
            and all(client.service_is_ready() for client in self._services)
        )

    def _absence(self, wait: float) -> str:
        if not self._seen:
            return not_seen(self._name, wait)
        return (
            f"{self._name} is there, but was not ready for {wait:g} s: it may be starting, inactive, "
            "or have ~/model_info remapped; see its log, give the same --ros-args -r, or a longer --wait"
        )


class _ScriptClient(LockstepClient):
    """Plays a script that does not depend on the gearbox."""

    def __init__(
        self,
        context: Context,
        script: LockstepScript,
        node: str,
        timeout: float,
        watch: Callable[[int], None],
        received: Sequence[int],
    ) -> None:
        super().__init__(context, "replay_publish", node, timeout, received)
        self._given = script
        self._watch = watch

    def outcome(self, failure: str) -> ScriptOutcome:
        """Result of the play; ``failure`` is empty if it succeeded so far."""
        failure = self._failure(failure)
        return ScriptOutcome(
            self._origin,
            self._time_ns,
            self._published,
            self._left_state,
            failure,
            self._signal(failure),
        )

    def _make_script(self) -> LockstepScript:
        return self._given

    def _note_progress(self) -> None:
        self._watch(min(self._time_ns, self._given.duration_ns))
