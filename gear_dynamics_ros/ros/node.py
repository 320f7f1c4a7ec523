"""The node ``gearbox``: parameters, topics, services and the transitions of one live run; wiring only."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.serialization import serialize_message

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.decoder import changes_meant
from gear_dynamics_ros.parameters import require_changeable
from gear_dynamics_ros.physics import step_check
from gear_dynamics_ros.physics.advice import parameter_warnings
from gear_dynamics_ros.realtime.engine_thread import warm_up
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.realtime.session import Session
from gear_dynamics_ros.ros import diagnostics, node_parameters, node_topics
from gear_dynamics_ros.ros.node_services import create_services
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.sinks import ViewerSink
from gear_dynamics_ros.viewer import Viewer, open_viewer

WARN_EVERY = 5.0  # s
MOST_STRANGERS = 100  # names of unknown joints remembered
Transition = Callable[[], None]


class GearboxNode(LifecycleNode):
    """Managed node around one session. Raises UsageError if a parameter can't be."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """``stop`` is called with the reason, on the engine's thread, when ``pacing.duration`` is over."""
        super().__init__("gearbox", automatically_declare_parameters_from_overrides=True)
        self._stop = stop
        self._log: Any = self.get_logger()  # type: ignore[no-untyped-call]
        self.parameters = node_parameters.declare(self)
        self.failure: GearboxError | None = None
        self._tell_failure = True
        self._ignore_sim_time()
        self.add_pre_set_parameters_callback(node_parameters.numbers_to_floats)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        # A steady clock: diagnostics go on whatever happens to the time of the system or to /clock.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._told: set[str] = set()  # names of unknown joints and crowded topics
        self._owned: list[Callable[[], Any]] = []  # what releases the entities of the configured node
        self._publishers_by_key: dict[str, Any] = {}
        self._engine: Engine | None = None
        self._viewer: Viewer | None = None
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._session: Session | None = None
        self._recorded_before = False
        self.recorder_errors: list[str] = []  # of all recordings
        # They outlive the session, so that a call under way when it ends is answered.
        create_services(self, self._active_session, self._follow)

    def bring_up(self) -> None:
        """Configure and activate. Raises GearboxError with the reason if that fails."""
        self._tell_failure = False
        triggers: tuple[Any, ...] = (self.trigger_configure, self.trigger_activate)
        for trigger in triggers:
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self.failure or GearboxError("the node could not be brought up: see its log")
        self._tell_failure = True

    def end(self, reason: str) -> None:
        """Finish everything; the node is of no use afterwards."""
        if self._session is not None:
            self._log.info(f"ending: {reason}")
        self._release(reason)

    # Transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._transition(self._configure)
        if result == TransitionCallbackReturn.FAILURE:
            self._release("failed")
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(lambda: self._release("cleaned up"))

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(lambda: self._release("shut down"))

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(lambda: self._release("error"))

    def _transition(self, act: Transition) -> TransitionCallbackReturn:
        try:
            act()
        except GearboxError as error:
            self.failure = error
            if self._tell_failure:
                self._log.error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self._log.error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        self._warn(parameter_warnings(self.parameters))
        if self.parameters.checkpoint.path:
            checkpoint.require_place(Path(self.parameters.checkpoint.path).absolute())
        warm_up(self.parameters, self._log.info)
        self._engine = Engine(self.parameters)
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._viewer = open_viewer(self.parameters)
        # A group is never rid of the entities it had: one that outlived them would grow with each configure.
        group = MutuallyExclusiveCallbackGroup()
        try:
            clock = self.parameters.clock_rate > 0.0
            for key, publisher in node_topics.create_publishers(self, group, clock=clock):
                self._publishers_by_key[key] = publisher
                self._own(self.destroy_publisher, publisher)
            for subscription in node_topics.create_subscriptions(self, group, self._take_command):
                self._own(self.destroy_subscription, subscription)
        except (InvalidQosOverridesError, ParameterException, RuntimeError) as error:
            raise UsageError(f"qos_overrides: {error}") from error
        timer = self.create_timer(1.0, self._report, callback_group=group, clock=self._steady)
        self._own(self.destroy_timer, timer)

    def _activate(self) -> None:
        if self._session is None:
            self._session = self._begin_session()
        live = self._session.live
        state = "ended, with" if live.ended else "paused, with" if live.paused else "running"
        self._log.info(f"{state} the {self.parameters.model} model from {live.time:.9g} s on")
        self._session.start()

    def _deactivate(self) -> None:
        if self._session is not None:
            self._session.stop()

    def _begin_session(self) -> Session:
        if self._engine is None:
            raise GearboxError("the gearbox is not configured: configure it first")
        sinks: list[Any] = [node_topics.PublisherSink(self._publishers_by_key)]
        if self._viewer is not None:
            sinks.append(ViewerSink(self._viewer))
        node = self.get_fully_qualified_name()
        session = Session(self._engine, self._mailbox, sinks, node, self._run_ended)
        if session.recordings.wanted:
            done = session.begin_recording(beside=self._recorded_before)
            self._recorded_before = True
            if not session.recordings.errors:
                self._log.info(done)
        self._tell_recorder_errors(session)
        return session

    def _release(self, reason: str) -> None:
        session, self._session = self._session, None
        if session is not None:
            try:
                session.finish(reason)
            finally:
                self._tell_recorder_errors(session)
        elif self._viewer is not None:
            self._viewer.close()
        self._viewer = self._engine = None
        while self._owned:
            self._owned.pop()()
        self._publishers_by_key = {}

    def _own(self, destroy: Callable[[Any], Any], entity: Any) -> None:
        self._owned.append(partial(destroy, entity))

    def _run_ended(self, session: Session) -> None:
        if session.completed:
            self._stop(session.live.ended)
        else:
            self._log.error(f"run ended: {session.live.ended}; call ~/reset to recover")
            if session.recordings.ring is not None:
                self._log.info(f"what led to it is in {session.recordings.snapshot_path or 'no recording'}")

    def _active_session(self) -> Session:
        if self._session is None or not self._session.live.active:
            raise GearboxError("the gearbox is not active: activate it first")
        return self._session

    # Commands

    def _take_command(self, key: str, data: bytes) -> None:
        try:
            message = node_topics.read_command(key, data)
        except GearboxError as error:
            self._mailbox.refuse(str(error))
            self._log.warning(str(error), throttle_duration_sec=WARN_EVERY)
            return
        changes, strangers = changes_meant(key, message, self.parameters.joint_prefix)
        for name in strangers:
            self._tell_once(name, f"~/command/joint: joint '{name}' takes no commands (said once)")
        refusal = self._mailbox.offer(key, changes, data, time.monotonic_ns())
        if refusal:
            self._log.warning(refusal, throttle_duration_sec=WARN_EVERY)

    def _tell_once(self, name: str, warning: str) -> None:
        if name not in self._told and len(self._told) < MOST_STRANGERS:
            self._told.add(name)
            self._log.warning(warning)

    # Parameters

    def _ignore_sim_time(self) -> None:
        if self.get_parameter("use_sim_time").value:
            self._log.info("use_sim_time is ignored: the gearbox makes time and never follows /clock")
            off = Parameter("use_sim_time", Parameter.Type.BOOL, False)
            self.set_parameters([off])

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        if any(parameter.name == "use_sim_time" and parameter.value for parameter in parameters):
            reason = "use_sim_time must stay false: the gearbox makes time and never follows /clock"
            return SetParametersResult(successful=False, reason=reason)
        try:
            require_changeable(self.parameters, node_parameters.changed(self.parameters, parameters))
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: list[Parameter]) -> None:
        old, self.parameters = self.parameters, node_parameters.changed(self.parameters, parameters)
        known = parameter_warnings(old)
        self._warn(line for line in parameter_warnings(self.parameters) if line not in known)
        if self._session is not None:
            self._session.change(self.parameters)
        elif self._engine is not None:
            self._engine = Engine(self.parameters)
            self._mailbox.limit(self.parameters)

    def _follow(self, session: Session) -> None:
        """Let the node's parameters be those of a session that has restored others."""
        restored = node_parameters.to_set(self.parameters, session.parameters)
        self.parameters = session.parameters
        if restored:
            result = self.set_parameters_atomically(restored)
            if not result.successful:
                raise GearboxError(f"restored, but the parameters do not show it: {result.reason}")

    # Diagnostics

    def _tell_recorder_errors(self, session: Session) -> None:
        for error in session.recordings.errors:
            if error not in self.recorder_errors:
                self.recorder_errors.append(error)
                self._log.error(error)

    def _warn(self, lines: Iterable[str]) -> None:
        for line in lines:
            self._log.warning(line)

    def _crowded(self) -> list[str]:
        """Command topics that several publish on."""
        topics = [name for name in node_topics.command_names(self) if self.count_publishers(name) > 1]
        for name in topics:
            self._tell_once(
                name,
                f"{name} has several publishers: the last message before a chunk edge counts (said once)",
            )
        return topics

    def _report(self) -> None:
        session = self._session
        if session is None:
            return
        self._tell_recorder_errors(session)
        pace = session.live.pace()
        speed = session.live.run.engine.commands.speed
        found = diagnostics.statuses(
            self.get_name(),
            self.get_fully_qualified_name(),
            diagnostics.health(session, pace, self._viewer, self._crowded()),
            diagnostics.surface(self.parameters, speed),
            step_check.checks(self.parameters, speed),
        )
        array = diagnostics.array(found, session.now_ns)
        session.report(pace, bytes(serialize_message(array)))
