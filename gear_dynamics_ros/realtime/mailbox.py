"""Mailbox for commands: checks and counts them, and keeps them until the next chunk edge."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.parameters import Parameters, command_bounds
from gear_dynamics_ros.parameters.decimals import exact_text

# Messages recorded between two chunk edges. Of more, the oldest are not recorded; they had no effect.
MOST_RECEIVED = 1000


class Delivery(NamedTuple):
    """Commands received since the last chunk edge."""

    changes: dict[str, float]  # values by field of Commands; empty if none was received
    received: list[tuple[str, bytes]]  # key in TOPICS and CDR of each message
    age_ns: int  # wall time since the last accepted command, or since ``restart``


class CommandCounts(NamedTuple):
    """Numbers of messages since the start."""

    accepted: int
    refused: int
    unrecorded: int  # accepted, but more than MOST_RECEIVED between two chunk edges
    last_refusal: str
    ages: Mapping[str, float]  # wall time since the last command in s, by field of Commands; NaN if none


class Mailbox:
    """Passes commands from one thread to another. Times are ns of one monotonic clock."""

    def __init__(self, parameters: Parameters, now_ns: int) -> None:
        self._lock = threading.Lock()
        self._changes: dict[str, float] = {}
        self._received: deque[tuple[str, bytes]] = deque(maxlen=MOST_RECEIVED)
        self._last_ns = now_ns
        self._commanded_ns: dict[str, int] = {}
        self._accepted = 0
        self._refused = 0
        self._unrecorded = 0
        self._last_refusal = ""
        self.limit(parameters)

    def limit(self, parameters: Parameters) -> None:
        """From now on accept only values within the bounds of ``parameters``."""
        bounds = command_bounds(parameters.operation.speed_limit)
        with self._lock:
            self._bounds = bounds

    def offer(self, topic: str, changes: Mapping[str, float], data: bytes, now_ns: int) -> str:
        """Accept the message ``data`` (CDR) on ``topic`` that requests ``changes``, or refuse it.

        Returns the reason of a refusal, else an empty text. A message is accepted as a whole or not at all;
        the last value of each command counts.
        """
        with self._lock:
            refusal = next(filter(None, (self._refusal(name, value) for name, value in changes.items())), "")
            if refusal:
                self._refused += 1
                self._last_refusal = refusal
            elif changes:
                self._accepted += 1
                self._last_ns = now_ns
                self._commanded_ns.update(dict.fromkeys(changes, now_ns))
                self._changes.update(changes)
                self._unrecorded += len(self._received) == MOST_RECEIVED
                self._received.append((topic, data))
        return refusal

    def refuse(self, reason: str) -> None:
        """Count a message that can't be decoded."""
        with self._lock:
            self._refused += 1
            self._last_refusal = reason

    def take(self, now_ns: int) -> Delivery:
        """Take out everything since the last call."""
        with self._lock:
            delivery = Delivery(self._changes, list(self._received), now_ns - self._last_ns)
            self._changes = {}
            self._received.clear()
            return delivery

    def restart(self, now_ns: int) -> None:
        """Count the age of commands from now on."""
        with self._lock:
            self._last_ns = now_ns

    def forget(self) -> None:
        """Drop everything that has not been taken."""
        with self._lock:
            self._changes = {}
            self._received.clear()

    def counts(self, now_ns: int) -> CommandCounts:
        """Present counts and ages."""
        with self._lock:
            last_ns = self._commanded_ns
            ages = {
                name: (now_ns - last_ns[name]) * 1e-9 if name in last_ns else math.nan
                for name in Commands._fields
            }
            return CommandCounts(self._accepted, self._refused, self._unrecorded, self._last_refusal, ages)

    def _refusal(self, name: str, value: float) -> str:
        lowest, highest = self._bounds[name]
        if lowest <= value <= highest:  # false for NaN
            return ""
        return (
            f"{name} {exact_text(value)} refused: not within {exact_text(lowest)} to {exact_text(highest)}; "
            "the last good one stays"
        )
