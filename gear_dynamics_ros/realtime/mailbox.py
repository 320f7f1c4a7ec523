"""Commands on their way from whoever sends them to the next chunk edge: checked, counted, handed over."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.parameters import Parameters, specifications

# Of a burst between two chunk edges as many are recorded; those before them had no effect.
MOST_RECEIVED = 1000


class Delivery(NamedTuple):
    """What came in since the last chunk edge."""

    changes: dict[str, float]  # field of Commands: value; empty if nothing came
    received: list[tuple[str, bytes]]  # topic key and CDR of each message behind them
    age_ns: int  # wall time since the last good command, or since ``restart``


class CommandCounts(NamedTuple):
    """Commands counted since the start."""

    accepted: int
    refused: int
    unrecorded: int  # of a burst, overtaken before the chunk edge and not recorded
    last_refusal: str
    ages: Mapping[str, float]  # field of Commands: wall time in s since it was commanded; NaN: never


class Mailbox:
    """Takes commands from one thread and hands them to another; times are ns of one monotonic clock."""

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
        """Take from now on what lies within the bounds of ``parameters``."""
        rows = specifications()
        speed_limit = parameters.operation.speed_limit
        torques = {name: rows[f"operation.{name}"] for name in ("drive_torque", "load_torque")}
        bounds = {
            name: (
                -math.inf if row.minimum is None else row.minimum,
                math.inf if row.maximum is None else row.maximum,
            )
            for name, row in torques.items()
        } | {"speed": (-speed_limit, speed_limit)}
        with self._lock:
            self._bounds = bounds

    def offer(self, topic: str, changes: Mapping[str, float], data: bytes, now_ns: int) -> str:
        """Take the command message ``data`` that means ``changes``; returns why it was refused, or nothing.

        A message is taken as a whole or not at all; of several for one command the last counts.
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
        """Count a message that can't be read."""
        with self._lock:
            self._refused += 1
            self._last_refusal = reason

    def take(self, now_ns: int) -> Delivery:
        """Everything since the last call."""
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
        """Drop what has not been taken yet."""
        with self._lock:
            self._changes = {}
            self._received.clear()

    def counts(self, now_ns: int) -> CommandCounts:
        """Counts of this moment."""
        with self._lock:
            at = self._commanded_ns
            ages = {name: (now_ns - at[name]) * 1e-9 if name in at else math.nan for name in Commands._fields}
            return CommandCounts(self._accepted, self._refused, self._unrecorded, self._last_refusal, ages)

    def _refusal(self, name: str, value: float) -> str:
        lowest, highest = self._bounds[name]
        if lowest <= value <= highest:  # false for NaN
            return ""
        return f"{name} {value:g} refused: not within {lowest:g} to {highest:g}; the last good one stays"
