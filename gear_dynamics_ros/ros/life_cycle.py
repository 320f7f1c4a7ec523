"""Services of the life cycle, with queues that hold every request.

Those that rclpy creates queue ten requests, and lose the others of a burst: their clients wait for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from lifecycle_msgs.msg import State, Transition, TransitionDescription
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.ros.deferred_answers import SERVICE_QUALITY


def create_life_cycle_services(node: LifecycleNode) -> None:
    """Create the services of the life cycle of ``node``, which has none.

    ``node`` was made with ``enable_communication_interface=False``, which leaves the services out, and not
    the events. A service that can't do what it is asked raises GearboxError.
    """
    machine = node._state_machine

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
