"""The node ``gearbox``: parameters, topics, services and threads of one live run; wiring only."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros import diagnostics, node_parameters, node_topics
from gear_dynamics_ros.commands import Mailbox, joint_changes
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.live import Live, warm_up
from gear_dynamics_ros.messages import Encoder, Record, message_class, serialize, stamp
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics import step_check
from gear_dynamics_ros.recording.writer import Recorder
from gear_dynamics_ros.recordings import Recordings
from gear_dynamics_ros.run import PAUSE, RESUME, Run, ViewerSink, advice
from gear_dynamics_ros.signals import Chunk
from gear_dynamics_ros.viewer import Viewer, open_viewer

FACTOR = "pacing.real_time_factor"
WARN_EVERY = 5.0  # s
MOST_STRANGERS = 100  # names of unknown joints remembered
Transition = Callable[[], None]


class GearboxNode(LifecycleNode):
    """Managed node around one run. Raises UsageError if a parameter can't be."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """``stop`` is called with the reason, on Live's thread, when ``pacing.duration`` is over."""
        super().__init__("gearbox", automatically_declare_parameters_from_overrides=True)
        self._stop = stop
        self._log: Any = self.get_logger()  # type: ignore[no-untyped-call]
        self.parameters = node_parameters.declare(self)
        self.failure: GearboxError | None = None
        self._tell_failure = True
        self._ignore_sim_time()
        self._factor = self.parameters.pacing.real_time_factor
        self.add_pre_set_parameters_callback(node_parameters.integers_to_floats)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        # A steady clock: diagnostics go on whatever happens to the time of the system or to /clock.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._strangers: set[str] = set()
        self._owned: list[Callable[[], Any]] = []  # what releases the entities of the configured node
        self._publishers_by_key: dict[str, Any] = {}
        self._engine: Engine | None = None
        self._viewer: Viewer | None = None
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._live: Live | None = None
        self._recordings: Recordings | None = None
        self._recorded_before = False
        self._told_error: str | None = None
        self._epoch_ns = 0
        self._next_clock_ns = 0

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
        if self._live is not None:
            self._log.info(f"ending: {reason}")
        self._release(reason)

    # Transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self._configure)

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
            if self._live is None:
                self._release("failed")
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self._log.error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        self._report_advice()
        warm_up(self.parameters, self._log.info)
        self._engine = Engine(self.parameters)
        self._mailbox = Mailbox(self.parameters, time.monotonic_ns())
        self._viewer = open_viewer(self.parameters)
        try:
            publishers = node_topics.create_publishers(self, clock=self.parameters.clock_rate > 0.0)
        except (InvalidQosOverridesError, ParameterException, RuntimeError) as error:
            raise UsageError(f"qos_overrides: {error}") from error
        self._publishers_by_key = publishers
        self._own(self.destroy_publisher, publishers.values())
        self._own(self.destroy_subscription, node_topics.create_subscriptions(self, self._take_command))
        self._own(self.destroy_service, self._create_services())
        self._own(self.destroy_timer, [self.create_timer(1.0, self._report, clock=self._steady)])

    def _activate(self) -> None:
        if self._live is None:
            self._live = self._create_live()
        else:
            self._live.run.note(RESUME, "activated")
        self._live.start()
        self._log.info(f"running the {self.parameters.model} model from {self._live.time:.9g} s on")

    def _deactivate(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live.run.note(PAUSE, "deactivated")

    def _create_live(self) -> Live:
        if self._engine is None:
            raise GearboxError("the gearbox is not configured")
        # Simulated time 0 is now, so that stamps run along with the wall clock at real-time factor 1.
        self._epoch_ns = time.time_ns()
        self._next_clock_ns = 0
        sinks: list[Any] = [node_topics.PublisherSink(self._publishers_by_key)]
        if self._viewer is not None:
            sinks.append(ViewerSink(self._viewer))
        run = Run(
            self._engine,
            Encoder(self.parameters, self._epoch_ns),
            sinks,
            duration=self.parameters.pacing.duration,
        )
        self._recordings = Recordings(
            self.parameters.recording.path,
            run,
            self._epoch_ns,
            self.get_fully_qualified_name(),
        )
        if self._recordings.wanted:
            path = self._recordings.begin(beside=self._recorded_before)
            self._recorded_before = True
            self._log.info(f"recording to {path}")
        return Live(run, self._mailbox, self._clock_records, self._run_ended)

    def _release(self, reason: str) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.stop()
            live.run.finish(reason)
            live.run.close()
        elif self._viewer is not None:
            self._viewer.close()
        self._recordings = self._viewer = self._engine = None
        while self._owned:
            self._owned.pop()()
        self._publishers_by_key = {}

    def _own(self, destroy: Callable[[Any], Any], entities: Iterable[Any]) -> None:
        self._owned.extend(partial(destroy, entity) for entity in entities)

    # Engine's thread

    def _clock_records(self, chunk: Chunk) -> list[Record]:
        if self.parameters.clock_rate == 0.0 or not len(chunk) or chunk.last_ns < self._next_clock_ns:
            return []
        self._next_clock_ns = chunk.last_ns + round(1e9 / self.parameters.clock_rate)
        time_ns = self._epoch_ns + chunk.last_ns
        kind = "rosgraph_msgs/msg/Clock"
        return [Record("clock", time_ns, serialize(kind, message_class(kind)(clock=stamp(time_ns))))]

    def _run_ended(self) -> None:
        live = self._live
        if live is None:
            return
        if live.run.completed and not live.run.tripped:
            self._stop(live.ended)
            return
        self._log.error(f"run ended: {live.ended}; call ~/reset to recover")
        recorder = self._recordings.end() if self._recordings is not None else None
        if recorder is not None:
            recorder.close()

    # Commands

    def _take_command(self, key: str, message: Any, data: bytes) -> None:
        if key == node_topics.JOINT_COMMAND:
            changes, strangers = joint_changes(
                self.parameters.joint_prefix, message.name, message.velocity, message.effort
            )
            self._report_strangers(strangers)
        else:
            changes = {node_topics.FLOAT_COMMANDS[key]: float(message.data)}
        refusal = self._mailbox.offer(key, changes, data, time.monotonic_ns())
        if refusal:
            self._log.warning(refusal, throttle_duration_sec=WARN_EVERY)

    def _report_strangers(self, names: Sequence[str]) -> None:
        for name in names:
            if name not in self._strangers and len(self._strangers) < MOST_STRANGERS:
                self._strangers.add(name)
                self._log.warning(f"~/command/joint: joint '{name}' takes no commands (said once)")

    # Services

    def _create_services(self) -> list[Any]:
        return [
            self.create_service(Trigger, "~/reset", self._serve(lambda _: self._reset())),
            self.create_service(Trigger, "~/step", self._serve(lambda _: self._step())),
            self.create_service(Trigger, "~/split", self._serve(lambda _: self._split())),
            self.create_service(SetBool, "~/pause", self._serve(lambda request: self._pause(request.data))),
            self.create_service(SetBool, "~/record", self._serve(lambda request: self._record(request.data))),
        ]

    def _serve(self, act: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            try:
                response.message = act(request)
                response.success = True
            except GearboxError as error:
                response.message = str(error)
                response.success = False
            return response

        return answer

    def _running(self) -> tuple[Live, Recordings]:
        if self._live is None or self._recordings is None or not self._live.active:
            raise GearboxError("the gearbox is not active: activate it first")
        return self._live, self._recordings

    def _reset(self) -> str:
        live, recordings = self._running()

        def reset() -> str:
            record_anew = recordings.wanted and bool(live.ended) and recordings.current is None
            live.reset()
            return f", recording to {recordings.begin(beside=True)}" if record_anew else ""

        return f"back at the start state{live.call(reset)}"

    def _step(self) -> str:
        live, _ = self._running()
        live.call(live.single_step)
        return f"simulated {live.time:.9g} s"

    def _split(self) -> str:
        live, recordings = self._running()
        live.call(recordings.split)
        return "split"

    def _pause(self, paused: bool) -> str:
        live, _ = self._running()
        changed = live.call(lambda: live.pause(paused))
        return f"{'' if changed else 'already '}{'paused' if paused else 'running'} at {live.time:.9g} s"

    def _record(self, wanted: bool) -> str:
        live, recordings = self._running()
        if wanted:
            return f"recording to {live.call(lambda: recordings.begin(beside=True))}"
        recorder = live.call(recordings.end)
        if recorder is None:
            return "nothing was recorded"
        recorder.close()
        if recorder.error is not None:
            raise GearboxError(recorder.error)
        return f"recorded {recorder.path}"

    # Parameters

    def _ignore_sim_time(self) -> None:
        if self.get_parameter("use_sim_time").value:
            self._log.info("use_sim_time is ignored: the gearbox makes time and never follows /clock")
            off = Parameter("use_sim_time", Parameter.Type.BOOL, False)
            self.set_parameters([off])

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        ours = {parameter.name: parameter.value for parameter in parameters if parameter.name == FACTOR}
        try:
            Parameters.from_flat({**self.parameters.to_flat(), **ours})
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == FACTOR:
                self._factor = factor = float(parameter.value)
                if self._live is not None:
                    self._live.set_factor(factor)

    # Diagnostics

    def _tell_recorder_error(self, recorder: Recorder | None) -> None:
        error = None if recorder is None else recorder.error
        if error is not None and error != self._told_error:
            self._log.error(error)
        self._told_error = error

    def _report_advice(self) -> None:
        for line in (*advice(self.parameters), *step_check.warnings(self.parameters)):
            self._log.warning(line)

    def _report(self) -> None:
        live = self._live
        if live is None or self._recordings is None:
            return
        self._tell_recorder_error(self._recordings.current)
        time_ns = self._epoch_ns + round(live.time * 1e9)
        found = diagnostics.statuses(
            self.get_name(),
            self.get_fully_qualified_name(),
            diagnostics.health(live, self._recordings.current, self._viewer, self._factor),
            diagnostics.surface(self.parameters, live.run.engine.commands.speed),
            step_check.checks(self.parameters, live.run.engine.commands.speed),
        )
        record = Record("diagnostics", time_ns, bytes(serialize_message(diagnostics.array(found, time_ns))))
        if live.active:
            live.post([record])
        else:
            live.run.emit([record])
