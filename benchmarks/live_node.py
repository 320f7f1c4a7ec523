"""The real node in a process of its own, and a client beside it that misses nothing."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from speed import SOURCE

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import serialize
from gear_dynamics_ros.messages.encoder import waveform_message
from gear_dynamics_ros.ros.node_topics import message_type, quality
from gear_dynamics_ros.topics import ARRAY, TOPICS, full_topic_name

PARAMETERS = SOURCE / "config" / "gearbox.yaml"
# On Linux, domains above 101 share their UDP ports with the ephemeral range.
DOMAINS = range(1, 102)
START_SECONDS = 120.0  # a first start compiles the kernel
STOP_SECONDS = 60.0
_TICKS = os.sysconf("SC_CLK_TCK")


@contextmanager
def running(parameters: Mapping[str, object], source: Path = SOURCE) -> Iterator[NodeProcess]:
    """The node of ``source`` with its config/gearbox.yaml but for ``parameters``; it is ended with SIGINT.

    Its output goes to stderr, its traffic nowhere else: this process gets the same ROS domain, and no other
    that asks for one in this way, as the tests do. Raises GearboxError if all domains are taken.
    """
    with ExitStack() as held:
        lock = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        os.environ |= {"ROS_DOMAIN_ID": str(_own_domain(lock)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        command = [sys.executable, "-m", "gear_dynamics_ros.cli.gearbox", "--ros-args"]
        command += ["--log-level", "warn", "--params-file", str(source / "config" / "gearbox.yaml")]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={value}"]
        # Python looks for the package in the present folder before the installed ones.
        child = subprocess.Popen(command, stdout=sys.stderr, cwd=source, start_new_session=True)
        held.callback(_end, child)
        yield NodeProcess(child)


def _own_domain(lock: socket.socket) -> int:
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        try:
            lock.bind(f"\0gear_dynamics_ros.test.domain.{domain}")
        except OSError:
            continue
        return domain
    raise GearboxError(f"all {len(DOMAINS)} ROS domains are taken: wait until other runs have ended")


def _end(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        child.send_signal(signal.SIGINT)
    try:
        child.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        print(f"the node did not end within {STOP_SECONDS:g} s of SIGINT: killed", file=sys.stderr)
    finally:  # also when a second Ctrl-C cuts the wait short
        child.kill()
        child.wait()


def free_port() -> int:
    """Port that nobody on this machine listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class NodeProcess:
    """What the system tells of the node's process."""

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        self._child = child
        self._tasks = Path(f"/proc/{child.pid}/task")

    def check(self) -> None:
        """Raise GearboxError if it has ended."""
        if self._child.poll() is not None:
            raise GearboxError(f"the node ended with exit code {self._child.returncode}: see its output")

    def resident(self) -> int:
        """Memory in use, bytes."""
        pages = Path(f"/proc/{self._child.pid}/statm").read_text(encoding="utf-8").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def thread_seconds(self) -> dict[tuple[int, str], float]:
        """Processor time of each living thread, s, by its id and name; the first is called main."""
        seconds = {}
        for task in self._tasks.iterdir():
            # The name stands in parentheses and may hold anything.
            head, _, tail = (task / "stat").read_text(encoding="utf-8").rpartition(")")
            fields = tail.split()
            number = int(task.name)
            name = "main" if number == self._child.pid else head.partition("(")[2]
            seconds[number, name] = (int(fields[11]) + int(fields[12])) / _TICKS
        return seconds


class Arrival(NamedTuple):
    """One message: its CDR, and when this process had it, ns of the monotonic clock."""

    data: bytes
    time_ns: int


class Client:
    """Hears and commands the node from this thread; to be used in a with statement."""

    def __init__(self, node: NodeProcess) -> None:
        self._process = node
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.ros = Node("client", context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.ros)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.ros.destroy_node()
        self._context.try_shutdown()

    def hear(self, key: str, take: Callable[[Arrival], object]) -> None:
        """Let ``take`` have every message of a topic (key in TOPICS), as bytes."""

        def receive(data: object) -> None:
            take(Arrival(cast(bytes, data), time.monotonic_ns()))

        topic = TOPICS[key]
        self.ros.create_subscription(
            message_type(topic.type), full_topic_name(topic), cast(Any, receive), quality(topic), raw=True
        )

    def publisher(self, key: str) -> Publisher:
        """Publisher of a command, once the node listens."""
        topic = TOPICS[key]
        publisher = self.ros.create_publisher(
            message_type(topic.type), full_topic_name(topic), quality(topic)
        )
        self.until(lambda: publisher.get_subscription_count() > 0, START_SECONDS)
        return publisher

    def until(self, condition: Callable[[], object], timeout: float) -> None:
        """Take what comes until ``condition`` holds; GearboxError after ``timeout`` s or if the node ends."""
        deadline = time.monotonic() + timeout
        while not condition():
            self._process.check()
            if time.monotonic() > deadline:
                raise GearboxError(f"the node did not answer within {timeout:g} s: see its output")
            self._executor.spin_once(timeout_sec=0.1)

    def listen(self, seconds: float) -> None:
        """Take what comes for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._process.check()
            self._executor.spin_once(timeout_sec=min(0.1, left))


class Samples:
    """Follows the waveform with all channels: counts its samples and those that are lost or doubled."""

    def __init__(self, interval_ns: int) -> None:
        self._interval = interval_ns * 1e-9
        self._next: int | None = None
        self.heard = 0
        self.lost = 0
        self.doubled = 0

    def take(self, arrival: Arrival) -> None:
        """The next message."""
        rows = rows_of(arrival.data)
        numbers = np.rint(rows[:, 0] / self._interval).astype(np.int64)
        expected = numbers[0] if self._next is None else self._next
        steps = np.diff(numbers, prepend=expected - 1)
        self.heard += len(numbers)
        self.lost += int((steps[steps > 1] - 1).sum())
        self.doubled += int((steps < 1).sum())
        self._next = int(numbers[-1]) + 1


def rows_of(data: bytes) -> NDArray[np.float64]:
    """Samples (n, 28) in the CDR of a waveform with all channels, without copying them."""
    count = (len(data) - _HEADING) // 8
    return np.frombuffer(data, "<f8", count, _HEADING).reshape(-1, len(CHANNEL_NAMES))


_HEADING = len(serialize(ARRAY, waveform_message(CHANNEL_NAMES, np.empty((0, len(CHANNEL_NAMES))))))
