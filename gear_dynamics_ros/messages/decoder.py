"""What messages mean: rows of numbers, commands asked for and commands in force."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.topics import ARRAY, FLOAT_COMMANDS, JOINT_COMMAND


def waveform_samples(message: Any) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Names of the columns and rows (n, columns) of a message laid out like the waveform."""
    names = tuple(message.layout.dim[1].label.split(","))
    return names, np.asarray(message.data, dtype=np.float64).reshape(-1, len(names))


class RowReader:
    """Reads CDR laid out like the waveform.

    The messages of a recording differ in their numbers, and seldom in what precedes them, understood once.
    """

    def __init__(self) -> None:
        self._prefix = b""
        self._size = -1  # bytes of the message that had it
        self._names: tuple[str, ...] = ()

    def read(self, data: bytes | memoryview) -> tuple[tuple[str, ...], NDArray[np.float64]]:
        """Names of the columns and rows (n, columns), which may lie in ``data``.

        Raises GearboxError if it is no such message.
        """
        if len(data) != self._size or data[: len(self._prefix)] != self._prefix:
            self._understand(data)
        rows = np.frombuffer(data, dtype="<f8", offset=len(self._prefix))
        return self._names, rows.reshape(-1, len(self._names))

    def _understand(self, data: bytes | memoryview) -> None:
        try:
            self._names, rows = waveform_samples(deserialize(ARRAY, data))
        except Exception as error:  # rosbags has no common class for what it finds wrong with bytes
            raise GearboxError(f"what should hold rows of numbers does not: {error}") from error
        self._size = len(data)
        self._prefix = bytes(data[: len(data) - rows.nbytes])


def applied_commands(message: Any) -> Commands:
    """Commands in force that an ``applied_command`` message tells."""
    return Commands(
        drive_torque=float(message.effort[0]),
        load_torque=float(message.effort[1]),
        speed=float(message.velocity[0]),
    )


def changes_meant(key: str, message: Any, prefix: str) -> tuple[dict[str, float], list[str]]:
    """Changes that a message on the command topic ``key`` means, and names of joints that take no commands.

    ``prefix`` is joint_prefix.
    """
    if key == JOINT_COMMAND:
        return joint_changes(prefix, message.name, message.velocity, message.effort)
    return {FLOAT_COMMANDS[key]: float(message.data)}, []


def joint_changes(
    prefix: str, names: Sequence[str], velocity: Sequence[float], effort: Sequence[float]
) -> tuple[dict[str, float], list[str]]:
    """Changes that a JointState means, and the names in it of joints that take no commands.

    An empty array, a missing or a NaN entry leaves that command as it is.
    """
    wanted: dict[str, float] = {}
    unknown: list[str] = []
    for index, name in enumerate(names):
        if name == f"{prefix}driving":
            _put(wanted, "speed", velocity, index)
            _put(wanted, "drive_torque", effort, index)
        elif name == f"{prefix}driven":
            _put(wanted, "load_torque", effort, index)
        elif name != f"{prefix}mesh":  # ros2_control names every joint it has, commanded or not
            unknown.append(name)
    return wanted, unknown


def _put(wanted: dict[str, float], name: str, values: Sequence[float], index: int) -> None:
    if index < len(values) and not math.isnan(values[index]):
        wanted[name] = float(values[index])
