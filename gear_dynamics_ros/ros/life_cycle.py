"""Services and events of the life cycle, with queues that hold every request.

Those that rclpy creates queue ten requests, and lose the others of a burst: their clients wait for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from lifecycle_msgs.msg import State, Transition, TransitionDescription, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.publisher import Publisher

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.ros.deferred_answers import SERVICE_QUALITY

EVENT_DEPTH = 10  # as in the life cycle of rclpy and rclcpp


class _ToldStateMachine:
    """The state machine of a node, which publishes each transition after it was made."""

    def __init__(self, machine: Any, events: Publisher, clock: Clock) -> None:
        """``machine`` is the state machine of rclpy."""
        self._machine, self._events, self._clock = machine, events, clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._machine, name)

    def trigger_transition_by_id(self, identifier: int, publish: bool) -> None:
        self._tell(lambda: self._machine.trigger_transition_by_id(identifier, False))

    def trigger_transition_by_label(self, label: str, publish: bool) -> None:
        self._tell(lambda: self._machine.trigger_transition_by_label(label, False))

    def _tell(self, trigger: Callable[[], None]) -> None:
        possible, start = self._machine.available_transitions, self._machine.current_state
        trigger()
        goal = self._machine.current_state
        event = TransitionEvent(
            timestamp=self._clock.now().nanoseconds, start_state=_state(*start), goal_state=_state(*goal)
        )
        for identifier, label, _, _, goal_identifier, _ in possible:
            if goal_identifier == goal[0]:
                event.transition = Transition(id=identifier, label=label)
        self._events.publish(event)


def create_life_cycle_services(node: LifecycleNode) -> None:
    """Create the services and the events of the life cycle of ``node``, which has no others.

    ``node`` was made with ``enable_communication_interface=False``. A service that can't do what it is asked
    raises GearboxError.
    """
    events = node.create_publisher(TransitionEvent, "~/transition_event", EVENT_DEPTH)
    machine = _ToldStateMachine(node._state_machine, events, node.get_clock())
    node._state_machine = machine

    def change_state(request: Any, response: Any) -> Any:
        transition = _possible_transition(machine, request.transition)
        response.success = _trigger(node, transition) == TransitionCallbackReturn.SUCCESS
        return response

    def get_state(request: Any, response: Any) -> Any:
        response.current_state = _state(*machine.current_state)
        return response

    def get_available_states(request: Any, response: Any) -> Any:
        response.available_states = [_state(*state) for state in machine.available_states]
        return response

    def get_available_transitions(request: Any, response: Any) -> Any:
        response.available_transitions = _descriptions(machine.available_transitions)
        return response

    def get_transition_graph(request: Any, response: Any) -> Any:
        response.available_transitions = _descriptions(machine.transition_graph)
        return response

    services: tuple[tuple[Any, Callable[[Any, Any], Any]], ...] = (
        (ChangeState, change_state),
        (GetState, get_state),
        (GetAvailableStates, get_available_states),
        (GetAvailableTransitions, get_available_transitions),
        (GetAvailableTransitions, get_transition_graph),
    )
    for kind, answer in services:
        node.create_service(kind, f"~/{answer.__name__}", answer, qos_profile=SERVICE_QUALITY)


def _possible_transition(machine: Any, asked: Transition) -> int:
    """Number of the transition with the label that was asked for, or else with the number."""
    possible: dict[int, str] = {identifier: label for identifier, label, *_ in machine.available_transitions}
    for identifier, label in possible.items():
        if asked.label == label or (not asked.label and asked.id == identifier):
            return identifier
    name = repr(asked.label) if asked.label else asked.id
    choice = ", ".join(f"{identifier} ({label})" for identifier, label in possible.items()) or "none"
    raise GearboxError(
        f"transition {name} is not possible in the state {machine.current_state[1]}; possible: {choice}"
    )


def _trigger(node: LifecycleNode, transition: int) -> TransitionCallbackReturn:
    triggers: dict[int, Callable[[], TransitionCallbackReturn]] = {
        Transition.TRANSITION_CONFIGURE: node.trigger_configure,
        Transition.TRANSITION_CLEANUP: node.trigger_cleanup,
        Transition.TRANSITION_ACTIVATE: node.trigger_activate,
        Transition.TRANSITION_DEACTIVATE: node.trigger_deactivate,
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: node.trigger_shutdown,
        Transition.TRANSITION_INACTIVE_SHUTDOWN: node.trigger_shutdown,
        Transition.TRANSITION_ACTIVE_SHUTDOWN: node.trigger_shutdown,
    }
    return triggers[transition]()


def _state(identifier: int, label: str) -> State:
    return State(id=identifier, label=label)


def _descriptions(transitions: Iterable[tuple[int, str, int, str, int, str]]) -> list[TransitionDescription]:
    return [
        TransitionDescription(
            transition=Transition(id=identifier, label=label),
            start_state=_state(start, start_label),
            goal_state=_state(goal, goal_label),
        )
        for identifier, label, start, start_label, goal, goal_label in transitions
    ]
