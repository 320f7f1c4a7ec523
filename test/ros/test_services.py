"""Services of the real node: every call is answered, however many come at once and whatever goes wrong."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service import Service
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.ros.deferred_answers import (
    SPACING,
    AnswerSender,
    Spacing,
    is_sent,
    require_send_response,
)
from gear_dynamics_ros.ros.gearbox_client import require_take_message
from support.gearbox import PATIENCE, start_gearbox
from support.processes import Process, StartProcess, until


class Caller:
    """Clients that call many at once."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("caller", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def client(self, kind: Any, name: str, depth: int = 10) -> Any:
        client = self._node.create_client(kind, f"/gearbox/{name}", qos_profile=QoSProfile(depth=depth))
        assert client.wait_for_service(PATIENCE)
        return client

    def answers(self, futures: list[Any], patience: float = 60.0) -> list[Any]:
        deadline = time.monotonic() + patience
        while not all(future.done() for future in futures) and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)
        done = [future.result() for future in futures if future.done()]
        assert len(done) == len(futures), f"{len(done)} of {len(futures)} calls were answered"
        return done

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        client = self.client(kind, name)
        (answer,) = self.answers([client.call_async(request or kind.Request())])
        self._node.destroy_client(client)
        return answer

    @contextmanager
    def messages(self, kind: Any, name: str) -> Iterator[list[Any]]:
        """The messages that come on a topic of the gearbox from now on."""
        received: list[Any] = []
        subscription = self._node.create_subscription(kind, f"/gearbox/{name}", received.append, 100)
        yield received
        self._node.destroy_subscription(subscription)

    def spin(self, duration: float) -> None:
        """Receive for ``duration`` wall seconds."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def caller(ros_domain: int) -> Iterator[Caller]:
    caller = Caller()
    yield caller
    caller.close()


@pytest.fixture
def gearbox(ros_domain: int, process: StartProcess, tmp_path: Path) -> Process:
    return start_gearbox(
        process, "pacing.real_time_factor:=0.1", f"checkpoint.path:={tmp_path / 'state.json'}"
    )


def pause(paused: bool) -> Any:
    return SetBool.Request(data=paused)


def test_a_hundred_calls_at_once_get_a_hundred_answers(gearbox: Process, caller: Caller) -> None:
    client = caller.client(SetBool, "pause", depth=100)
    answers = caller.answers([client.call_async(pause(number % 2 == 0)) for number in range(100)])
    words = [answer.message.split(" at ")[0] for answer in answers]
    assert all(answer.success for answer in answers) and words == ["paused", "running"] * 50
    steps = caller.client(Trigger, "step", depth=100)
    refusals = caller.answers([steps.call_async(Trigger.Request()) for _ in range(100)])
    assert all("not paused" in answer.message and not answer.success for answer in refusals)


def test_sixteen_clients_at_once_are_all_answered(gearbox: Process, caller: Caller) -> None:
    clients = [caller.client(SetBool, "pause") for _ in range(16)]
    for paused in (True, False):
        answers = caller.answers([client.call_async(pause(paused)) for client in clients])
        assert all(answer.success for answer in answers)
        assert sum("already" in answer.message for answer in answers) == 15


def test_a_call_that_takes_long_holds_up_no_other(gearbox: Process, caller: Caller) -> None:
    # Discovery of the clients must not use up the time that the steps may take.
    others = {name: caller.client(Trigger, name) for name in ("save_checkpoint", "snapshot", "reset")}
    setter = caller.client(SetParametersAtomically, "set_parameters_atomically")
    steps = caller.client(Trigger, "step")
    assert caller.call(SetBool, "pause", pause(True)).success
    chunks = [Parameter("stepping.chunks", value=1_000_000).to_parameter_msg()]
    assert caller.call(SetParameters, "set_parameters", SetParameters.Request(parameters=chunks))

    def answer(client: Any, request: Any) -> Any:
        return caller.answers([client.call_async(request)])[0]

    stepping = steps.call_async(Trigger.Request())
    assert answer(others["save_checkpoint"], Trigger.Request()).success
    assert "no ring" in answer(others["snapshot"], Trigger.Request()).message
    viscosity = [Parameter("oil.viscosity", value=0.05).to_parameter_msg()]
    assert answer(setter, SetParametersAtomically.Request(parameters=viscosity)).result.successful
    assert not stepping.done()
    assert answer(others["reset"], Trigger.Request()).success
    (stepped,) = caller.answers([stepping])
    assert not stepped.success and "aborted: the run was reset" in stepped.message


def test_changes_and_restores_at_once_leave_node_and_run_with_the_same_parameters(
    gearbox: Process, caller: Caller
) -> None:
    assert caller.call(Trigger, "save_checkpoint").success
    restore = caller.client(Trigger, "restore_checkpoint", depth=100)
    change = caller.client(SetParametersAtomically, "set_parameters_atomically", depth=100)
    futures = []
    for number in range(30):
        values = [Parameter("oil.viscosity", value=0.03 + number * 1e-3).to_parameter_msg()]
        futures.append(change.call_async(SetParametersAtomically.Request(parameters=values)))
        futures.append(restore.call_async(Trigger.Request()))
    for answer in caller.answers(futures):
        if isinstance(answer, Trigger.Response):
            assert answer.success, answer.message
        else:
            assert answer.result.successful or "being restored" in answer.result.reason
    assert caller.call(Trigger, "restore_checkpoint").success
    found = caller.call(GetParameters, "get_parameters", GetParameters.Request(names=["oil.viscosity"]))
    assert found.values[0].double_value == 0.0228
    # A change validated against other parameters than those in force would be refused.
    values = [Parameter("oil.viscosity", value=0.07).to_parameter_msg()]
    request = SetParametersAtomically.Request(parameters=values)
    assert caller.call(SetParametersAtomically, "set_parameters_atomically", request).result.successful


def test_what_rclpy_cannot_set_is_answered_and_the_node_goes_on(gearbox: Process, caller: Caller) -> None:
    broken = ParameterMessage(name="oil.viscosity")
    broken.value.type = 99
    answer = caller.call(SetParameters, "set_parameters", SetParameters.Request(parameters=[broken]))
    words = "oil.viscosity: value.type = 99 is no type of a parameter: it must be 0 to 9"
    assert not answer.results[0].successful and answer.results[0].reason.startswith(words)
    request = SetParametersAtomically.Request(parameters=[broken])
    answer = caller.call(SetParametersAtomically, "set_parameters_atomically", request)
    assert not answer.result.successful and answer.result.reason.startswith(words)
    assert "Traceback" not in gearbox.output
    assert caller.call(SetBool, "pause", pause(True)).success


@pytest.mark.parametrize("transition", [0, 1, 2, 3, 5, 6, 99, 255])
def test_a_transition_that_is_not_possible_is_refused_and_the_run_goes_on(
    gearbox: Process, caller: Caller, transition: int
) -> None:
    request = ChangeState.Request(transition=Transition(id=transition))
    assert not caller.call(ChangeState, "change_state", request).success
    gearbox.wait_for("change_state: refused: ")
    assert caller.call(GetState, "get_state").current_state.label == "active"
    assert caller.call(SetBool, "pause", pause(True)).message.startswith("paused")


def test_a_burst_of_questions_about_parameters_is_answered(gearbox: Process, caller: Caller) -> None:
    ask = {
        "get_parameters": (GetParameters, GetParameters.Request(names=["oil.viscosity"])),
        "list_parameters": (ListParameters, ListParameters.Request()),
        "describe_parameters": (DescribeParameters, DescribeParameters.Request(names=["oil.viscosity"])),
    }
    for name, (kind, request) in ask.items():
        client = caller.client(kind, name, depth=100)
        caller.answers([client.call_async(request) for _ in range(60)])


def test_a_burst_of_calls_to_the_life_cycle_is_answered(gearbox: Process, caller: Caller) -> None:
    for name, kind in {
        "change_state": ChangeState,
        "get_state": GetState,
        "get_available_states": GetAvailableStates,
        "get_available_transitions": GetAvailableTransitions,
        "get_transition_graph": GetAvailableTransitions,
    }.items():
        client = caller.client(kind, name, depth=100)
        caller.answers([client.call_async(kind.Request()) for _ in range(60)])


def test_sixteen_clients_that_ask_while_the_node_configures_are_all_answered(
    ros_domain: int, process: StartProcess, caller: Caller
) -> None:
    start_gearbox(process, "autostart:=false")
    clients = [caller.client(GetState, "get_state") for _ in range(16)]
    change = caller.client(ChangeState, "change_state")
    configure = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    changed = change.call_async(configure)
    states = [client.call_async(GetState.Request()) for client in clients]
    assert caller.answers([changed])[0].success
    assert {answer.current_state.label for answer in caller.answers(states)} <= {"unconfigured", "inactive"}


def test_the_life_cycle_tells_its_transitions(gearbox: Process, caller: Caller) -> None:
    by_label = ChangeState.Request(transition=Transition(label="deactivate"))
    by_id = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
    with caller.messages(TransitionEvent, "transition_event") as events:

        def told() -> bool:  # the gearbox discovers the subscription at a time that nobody tells
            events.clear()
            assert caller.call(ChangeState, "change_state", by_label).success
            assert caller.call(ChangeState, "change_state", by_id).success
            caller.spin(0.2)
            return len(events) == 4

        until(told, "all events of two transitions")
    assert [(event.start_state.label, event.goal_state.label) for event in events] == [
        ("active", "deactivating"),
        ("deactivating", "inactive"),
        ("inactive", "activating"),
        ("activating", "active"),
    ]
    offered = caller.call(GetAvailableTransitions, "get_available_transitions").available_transitions
    assert {(item.transition.id, item.transition.label) for item in offered} == {
        (Transition.TRANSITION_DEACTIVATE, "deactivate"),
        (Transition.TRANSITION_ACTIVE_SHUTDOWN, "shutdown"),
    }
    unknown = ChangeState.Request(transition=Transition(label="accelerate"))
    assert not caller.call(ChangeState, "change_state", unknown).success
    gearbox.wait_for(
        "transition 'accelerate' is not possible in the state active; possible: 4 (deactivate), 7"
    )


def test_an_answer_that_fails_holds_up_no_other() -> None:
    errors: list[str] = []
    log = SimpleNamespace(error=errors.append)
    sender, sent = AnswerSender(log), threading.Event()
    sender.put(time.monotonic(), lambda: [][0])
    until(lambda: errors, "the error in the log")
    assert "IndexError" in errors[0]

    def sending(event: threading.Event) -> Callable[[], bool]:
        return lambda: is_sent(event.set)

    sender.put(time.monotonic() + 3600.0, sending(sent))
    first = threading.Event()
    sender.put(time.monotonic(), sending(first))
    assert first.wait(60.0) and not sent.is_set()
    sender.close()
    assert sent.is_set(), "what waits when the sender is closed is sent"


def test_an_answer_is_offered_again_until_the_middleware_knows_its_client() -> None:
    unknown_client = "failed to send response (timeout): client will not receive response"
    attempts: list[float] = []
    known = threading.Event()

    def send() -> None:  # as rclpy does
        attempts.append(time.monotonic())
        if len(attempts) < 3:
            warnings.warn(unknown_client, RuntimeWarning, stacklevel=1)
        else:
            known.set()

    sender = AnswerSender(SimpleNamespace())
    sender.put(time.monotonic(), lambda: is_sent(send))
    assert known.wait(60.0)
    sender.close()
    assert len(attempts) == 3


def test_only_answers_of_one_service_to_simultaneous_calls_are_spaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = SimpleNamespace(monotonic=100.0, system=1_000.0)
    monkeypatch.setattr(time, "monotonic", lambda: now.monotonic)
    monkeypatch.setattr(time, "time_ns", lambda: round(now.system * 1e9))
    pause, step = Spacing(), Spacing()
    received = round(now.system * 1e9)
    assert [pause.due(received, 7) for _ in range(3)] == pytest.approx(
        [100.0, 100.0 + SPACING, 100.0 + 2.0 * SPACING]
    )
    assert step.due(received, 7) == 100.0
    now.monotonic, now.system = 200.0, 1_100.0
    assert pause.due(round(now.system * 1e9), 7) == 200.0
    now.monotonic, now.system = 200.001, 1_100.001
    received = round(now.system * 1e9)
    assert pause.due(received, 8) == 200.001, "the client that was answered calls again"
    now.monotonic, now.system = 200.002, 1_100.002
    received = round(now.system * 1e9)
    assert pause.due(received, 8) == 200.001 + SPACING, "another client calls"
    now.monotonic, now.system = 300.0, 50.0  # the system's clock was set back
    assert pause.due(round(1_200.0 * 1e9), 7) == 300.0


def test_a_checkpoint_file_that_is_none_is_answered(gearbox: Process, caller: Caller, tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("[]")
    answer = caller.call(Trigger, "restore_checkpoint")
    assert not answer.success and "is not a checkpoint" in answer.message
    (tmp_path / "state.json").unlink()
    (tmp_path / "state.json").mkdir()
    answer = caller.call(Trigger, "restore_checkpoint")
    assert not answer.success and answer.message
    assert caller.call(Trigger, "reset").success


def test_another_rclpy_is_refused_with_words(monkeypatch: pytest.MonkeyPatch) -> None:
    require_send_response()
    monkeypatch.setattr(Service, "send_response", lambda self, response: None)
    with pytest.raises(GearboxError, match=r"Service\.send_response has the parameters .* ROS 2 Jazzy"):
        require_send_response()
    monkeypatch.delattr(Service, "send_response")
    with pytest.raises(GearboxError, match="parameters None"):
        require_send_response()


def test_a_subscription_that_cannot_be_drained_is_refused_with_words(ros_domain: int) -> None:
    context = Context()
    rclpy.init(context=context)
    node = Node("listener", context=context)
    try:
        subscription = node.create_subscription(String, "words", print, 10)
        require_take_message(subscription)
        with pytest.raises(GearboxError, match=r"no handle\.take_message.* ROS 2 Jazzy"):
            require_take_message(node.create_publisher(String, "words", 10))
    finally:
        node.destroy_node()
        context.try_shutdown()
