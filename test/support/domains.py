"""ROS domains and ports that no other test on this machine uses."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

# On Linux, domains above 101 share their UDP ports with the ephemeral range.
DOMAINS = range(1, 102)


@contextmanager
def domain() -> Iterator[int]:
    """Reserve a domain against every other test on this machine, for this process and its children."""
    with ExitStack() as held:
        lock = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        environment = held.enter_context(pytest.MonkeyPatch.context())
        for number in random.Random().sample(DOMAINS, len(DOMAINS)):
            try:
                lock.bind(f"\0gear_dynamics_ros.test.domain.{number}")
            except OSError:
                continue
            environment.setenv("ROS_DOMAIN_ID", str(number))
            environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            yield number
            return
        pytest.fail(f"all {len(DOMAINS)} ROS domains are taken by other tests")


def free_port() -> int:
    """Port of the loopback interface that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
