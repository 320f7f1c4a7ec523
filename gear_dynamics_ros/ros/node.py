"""The node ``gearbox``: connects parameters, topics, services and transitions with one session."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any, Final

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import ParameterChange, Parameters
from gear_dynamics_ros.physics import step_check
from gear_dynamics_ros.physics.advice import parameter_warnings
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.realtime.scheduling import require_schedulable
from gear_dynamics_ros.realtime.session import Session
from gear_dynamics_ros.recording.ring import require_memory
from gear_dynamics_ros.ros import diagnostics, node_topics
from gear_dynamics_ros.ros.command_receiver import CommandReceiver
from gear_dynamics_ros.ros.deferred_answers import AnswerSender, guard_services
from gear_dynamics_ros.ros.life_cycle import create_life_cycle_services
from gear_dynamics_ros.ros.node_services import create_services
from gear_dynamics_ros.ros.runtime_parameters import RuntimeParameters
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.sinks import ViewerSink
from gear_dynamics_ros.simulation.warm_up import warm_up
from gear_dynamics_ros.system.memory import available_memory
from gear_dynamics_ros.viewer import Viewer, open_viewer

# The engine takes commands at each edge of a chunk. This is for those that come while it computes nothing:
# the middleware keeps only COMMAND_DEPTH of them.
COLLECT_INTERVAL: Final = 0.1  # s


class GearboxNode(LifecycleNode):
    """Managed node around one session. Raises UsageError if a parameter is invalid."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """``stop`` is called on the engine's thread with the reason when ``pacing.duration`` is simulated."""
        super().__init__(
            "gearbox",
            enable_communication_interface=False,
            automatically_declare_parameters_from_overrides=True,
        )
        self._stop = stop
        self._log: Any = self.get_logger()  # type: ignore[no-untyped-call]
        self._answers = AnswerSender(self._log)
        self._runtime_parameters = RuntimeParameters(
            self, self._answers, self._apply, lambda: self._run_parameters
        )
        self.failure: GearboxError | None = None
        self._log_failures = True
        # Steady, so that changes of the system time or of /clock do not affect diagnostics.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._cleanups: list[Callable[[], Any]] = []  # destroy the entities of the configured node
        self._publishers_by_key: dict[str, Any] = {}
        self._command_subscriptions: dict[str, Subscription] = {}
        self._listeners = node_topics.Listeners()
        self._engine: Engine | None = None
        self._viewer: Viewer | None = None
        self._publisher: node_topics.PublisherSink | None = None
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._commands = CommandReceiver(self, self._mailbox, self.parameters.joint_prefix)
        self._session: Session | None = None
        self._recorded_before = False
        self._errors_logged = 0  # number of recording errors of the present session in the log
        self.recording_failed = False  # whether any recording of any session failed
        # Services exist longer than the session, so that a call in progress when it ends is answered.
        create_services(self, self._answers, self._active_session, self._restore_checkpoint)
        create_life_cycle_services(self)
        guard_services(self, self._answers)

    @property
    def parameters(self) -> Parameters:
        """Parameters of the node."""
        return self._runtime_parameters.current

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor serves: commands are taken by ``CommandReceiver``."""
        kept = self._command_subscriptions.values()
        return (subscription for subscription in super().subscriptions if subscription not in kept)

    def bring_up(self) -> None:
        """Configure and activate. Raises GearboxError with the reason if that fails."""
        self._log_failures = False
        triggers: tuple[Any, ...] = (self.trigger_configure, self.trigger_activate)
        for trigger in triggers:
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self.failure or GearboxError("the node could not be brought up: see its log")
        self._log_failures = True

    def end(self, reason: str) -> None:
        """Finish everything. The node can't be used afterwards."""
        if self._session is not None:
            self._log.info(f"ending: {reason}")
        try:
            self._release(reason)
        finally:
            self._answers.close()

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

    def _transition(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            act()
        except GearboxError as error:
            self.failure = error
            if self._log_failures:
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
        if self.parameters.recording.path and self.parameters.recording.mode == "ring":
            require_memory(self.parameters, available_memory())
        require_schedulable(self.parameters.pacing)
        warm_up(self._log.info, self._log.warning)
        self._engine = Engine(self.parameters)
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._commands = CommandReceiver(self, self._mailbox, self.parameters.joint_prefix)
        self._viewer = open_viewer(self.parameters)
        if self._viewer is not None:
            self._log.info(f"viewer: {self._viewer.address}")
        # A callback group never drops its entities: one that is used again would grow with each configure.
        group = MutuallyExclusiveCallbackGroup()
        try:
            clock = self.parameters.clock_rate > 0.0
            # Who joins in a pause needs the last clock.
            self._listeners = node_topics.Listeners(["clock"] if clock else [])
            for key, publisher in node_topics.create_publishers(self, group, self._listeners, clock=clock):
                self._publishers_by_key[key] = publisher
                self._cleanups.append(partial(self.destroy_publisher, publisher))
            for key, subscription in node_topics.create_subscriptions(self, group):
                self._command_subscriptions[key] = subscription
                self._cleanups.append(partial(self.destroy_subscription, subscription))
        except (InvalidQosOverridesError, ParameterException, RuntimeError) as error:
            raise UsageError(f"qos_overrides: {error}") from error
        self._commands.listen(self._command_subscriptions)
        for interval, act in ((1.0, self._report), (COLLECT_INTERVAL, self._commands.collect)):
            timer = self.create_timer(interval, act, callback_group=group, clock=self._steady)
            self._cleanups.append(partial(self.destroy_timer, timer))

    def _activate(self) -> None:
        if self._session is None:
            self._session = self._begin_session()
        session, state = self._session, self._session.state.name
        self._log.info(
            f"{state if state == 'running' else f'{state}, with'} the {self.parameters.model} model "
            f"from {session.engine_thread.time:.9g} s on"
        )
        session.start()

    def _deactivate(self) -> None:
        if self._session is not None:
            self._session.stop()

    def _begin_session(self) -> Session:
        if self._engine is None:
            raise GearboxError("the gearbox is not configured: configure it first")
        self._publisher = node_topics.PublisherSink(self._publishers_by_key, self._listeners)
        sinks: list[Any] = [self._publisher]
        if self._viewer is not None:
            sinks.append(ViewerSink(self._viewer))
        names = node_topics.node_names(self)
        session = Session(self._engine, self._mailbox, sinks, names, self._run_ended, self._commands.collect)
        self._errors_logged = 0
        if session.recordings.wanted:
            done = session.begin_recording(beside=self._recorded_before)
            self._recorded_before = True
            if not session.recordings.errors:
                self._log.info(done)
        self._log_recording_errors(session)
        return session

    def _release(self, reason: str) -> None:
        session, self._session = self._session, None
        if session is not None:
            try:
                session.finish(reason)
            finally:
                self._log_recording_errors(session)
        elif self._viewer is not None:
            self._viewer.close()
        self._viewer = self._engine = self._publisher = None
        while self._cleanups:
            self._cleanups.pop()()
        self._publishers_by_key = {}
        self._command_subscriptions = {}

    def _run_ended(self, session: Session) -> None:
        state = session.state
        if state.completed:
            self._stop(state.reason)
            return
        self._log.error(f"run ended: {state.reason}; call ~/reset to recover")
        if session.recordings.ring is not None:
            self._log.info(f"what preceded it is in {session.recordings.snapshot_path or 'no recording'}")

    # Requests

    def _active_session(self) -> Session:
        if self._session is None or not self._session.engine_thread.active:
            raise GearboxError("the gearbox is not active: activate it first")
        return self._session

    def _restore_checkpoint(self) -> Future[str]:
        return self._runtime_parameters.restore(self._active_session().restore_checkpoint)

    @property
    def _run_parameters(self) -> Parameters:
        return self.parameters if self._session is None else self._session.parameters

    def _apply(self, change: ParameterChange) -> Future[None] | None:
        known = parameter_warnings(change.old)
        self._warn(line for line in parameter_warnings(change.new) if line not in known)
        if self._session is not None:
            return self._session.change(change)
        if self._engine is not None:
            self._engine = Engine(change.new)
            self._mailbox.limit(change.new)
        return None

    # Diagnostics

    def _warn(self, lines: Iterable[str]) -> None:
        for line in lines:
            self._log.warning(line)

    def _log_recording_errors(self, session: Session) -> None:
        errors = session.recordings.errors
        for error in errors[self._errors_logged :]:
            self._log.error(error)
        self._errors_logged = len(errors)
        self.recording_failed |= bool(errors)

    def _report(self) -> None:
        session = self._session
        if session is None:
            return
        self._log_recording_errors(session)
        if self._publisher is not None:
            session.engine_thread.request(self._publisher.repeat_clock)
        pace = session.engine_thread.pace()
        speed = session.engine_thread.run.engine.commands.speed
        statuses = diagnostics.diagnostic_statuses(
            self.get_fully_qualified_name(),
            diagnostics.collect_health(session, pace, self._viewer, self._commands.publishers()),
            diagnostics.surface_waves(self.parameters, speed),
            step_check.checks(self.parameters, speed),
        )
        message = diagnostics.diagnostic_array(statuses, session.now_ns)
        session.report(pace, bytes(serialize_message(message)))
