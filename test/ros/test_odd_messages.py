"""Whatever messages and requests contain: the node lives and answers, and its recordings verify."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from gear_dynamics_ros import recording
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.topics import COMMAND_TOPICS
from support.gearbox import Client, start_gearbox
from support.odd_messages import interface, odd_message
from support.processes import StartProcess

DURATION = 60.0  # s of wall time
FEWEST_CALLS = 100  # on a machine however busy
PENDING = 20  # calls without an answer at which the client waits
DEPTH = 1000  # so that the client loses no answer
NAMES = [*specifications(), "driving", "driven", "mesh"]


class Fuzzer:
    """Sends odd commands, and odd requests to every service of the gearbox."""

    def __init__(self, client: Client, rng: random.Random) -> None:
        self._client, self._rng = client, rng
        node, profile = client.node, QoSProfile(depth=DEPTH)
        self._services = [
            node.create_client(interface(kind), name, qos_profile=profile)
            for name, (kind,) in sorted(node.get_service_names_and_types_by_node("gearbox", "/"))
        ]
        self.calls: list[tuple[Any, Any]] = []  # requests and the futures of their answers

    def call(self) -> None:
        service = self._rng.choice(self._services)
        request = odd_message(service.srv_type.Request, self._rng, NAMES)
        if not _ends_the_node(request):
            self.calls.append((request, service.call_async(request)))

    def command(self) -> None:
        """Send a command, sometimes cut short: not all peers make valid CDR."""
        publisher = self._client.publishers[self._rng.choice(COMMAND_TOPICS)]
        data = serialize_message(odd_message(publisher.msg_type, self._rng, NAMES))
        end = self._rng.randint(4, len(data)) if self._rng.random() < 0.2 else len(data)
        publisher.publish(data[:end])

    def answered(self) -> bool:
        return all(answer.done() for _, answer in self.calls)

    def pending(self) -> int:
        return sum(not answer.done() for _, answer in self.calls[-DEPTH:])


def _ends_the_node(request: Any) -> bool:
    """Whether the request asks for a shutdown, which the node must carry out."""
    transition = getattr(request, "transition", None)
    return transition is not None and 5 <= transition.id <= 7


def test_no_message_ends_the_node_or_spoils_its_recording(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        f"checkpoint.path:={tmp_path / 'state.json'}",
        "recording.checkpoint_interval:=0.1",
        "pacing.real_time_factor:=0.2",
    )
    with Client(hears=["event", "applied_command"]) as client:
        client.in_force()
        fuzzer = Fuzzer(client, random.Random(20))
        end = time.monotonic() + DURATION
        while time.monotonic() < end or len(fuzzer.calls) < FEWEST_CALLS:
            fuzzer.call()
            fuzzer.command()
            client.executor.spin_once(timeout_sec=0.0)
            if fuzzer.pending() > PENDING:
                client.until(fuzzer.answered)
        client.until(fuzzer.answered)
        assert client.call(GetState, "get_state").current_state.label in ("active", "inactive")
        node.signal(signal.SIGINT)
        assert node.wait() == 0, node.output
    assert "Traceback" not in node.output and "internal error" not in node.output
    changed = [request for request, answer in fuzzer.calls if _transition_made(request, answer.result())]
    assert {request.transition.id for request in changed} <= {3, 4}
    bags = [recording.open(path) for path in tmp_path.glob("bag*")]
    assert len(bags) > 1, "~/record begins further recordings"
    for bag in bags:
        assert bag.complete and verify_recording(bag).difference is None


def _transition_made(request: Any, answer: Any) -> bool:
    return isinstance(request, ChangeState.Request) and bool(answer.success)
