"""Values of messages: rows of numbers, events, requested commands and commands in force.

No content of a message is trusted: bytes, lengths and values may be anything.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import ENERGIES, IMPACTS, PACE
from gear_dynamics_ros.chunk import Commands, Counters
from gear_dynamics_ros.errors import GearboxError, one_line
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.messages.cdr import deserialize, stamp_ns
from gear_dynamics_ros.topics import ARRAY, FLOAT_COMMANDS, JOINT_COMMAND, JOINT_STATE, STRING, TOPICS

# Columns of the topics with rows, except the waveform: a parameter selects its channels.
ROW_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "energy": tuple(entry.name for entry in ENERGIES),
    "impacts": tuple(entry.name for entry in IMPACTS),
    "pacing": tuple(entry.name for entry in PACE),
}
T = TypeVar("T")


class AppliedCommands(NamedTuple):
    """Commands in force from the sample with the stamp ``time_ns`` on."""

    time_ns: int
    commands: Commands


class MessageDecoder:
    """Decodes the messages of one node. All tools decode recordings with it.

    Every method takes the CDR of a message and its stamp in ns. If the message does not fit its topic, the
    method raises GearboxError with source, topic, stamp and fault.
    """

    def __init__(self, channels: Sequence[str], joint_prefix: str, source: str) -> None:
        """``channels`` are those of the waveform; errors name ``source`` as the recording."""
        self._prefix = joint_prefix
        self._source = source
        names = {**ROW_NAMES, "waveform": tuple(channels)}
        self._rows = {topic: RowReader(columns) for topic, columns in names.items()}

    def message(self, topic: str, time_ns: int, data: bytes | memoryview) -> Any:
        """Message on ``topic`` (key in TOPICS), fields as in ROS."""
        with self._errors_located(topic, time_ns):
            return deserialize(TOPICS[topic].type, data)

    def rows(self, topic: str, time_ns: int, data: bytes | memoryview) -> NDArray[np.float64]:
        """Rows (n, columns) of a message with the layout of the waveform; may be a view of ``data``."""
        with self._errors_located(topic, time_ns):
            return self._rows[topic].read(data)

    def applied(self, time_ns: int, data: bytes | memoryview) -> AppliedCommands:
        """Commands in force of a message on ``~/command/applied``."""
        with self._errors_located("applied_command", time_ns):
            message = deserialize(JOINT_STATE, data)
            return AppliedCommands(stamp_ns(message.header.stamp), applied_commands(message))

    def event(self, time_ns: int, data: bytes | memoryview) -> OperatorEvent:
        """Event of a message on ``~/event``."""
        with self._errors_located("event", time_ns):
            return _event(deserialize(STRING, data).data)

    def changes(self, topic: str, time_ns: int, data: bytes | memoryview) -> dict[str, float]:
        """Requested values of a message on a command topic, by field of Commands."""
        with self._errors_located(topic, time_ns):
            return requested_changes(topic, deserialize(TOPICS[topic].type, data), self._prefix)[0]

    @contextmanager
    def _errors_located(self, topic: str, time_ns: int) -> Iterator[None]:
        """Add source, topic and stamp of the message to errors."""
        try:
            yield
        except GearboxError as error:
            where = f"{self._source}: the message on {TOPICS[topic].name} at {time_ns} ns"
            raise GearboxError(f"{where} is damaged: {one_line(error)}") from error


class RowReader:
    """Reads CDR with the layout of the waveform and the columns ``names``.

    Most messages of a recording differ in their numbers only: the bytes before them are decoded once.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._prefix = b""
        self._size = -1  # bytes of the messages that begin with it

    def read(self, data: bytes | memoryview) -> NDArray[np.float64]:
        """Rows (n, columns), a view of ``data``. Raises GearboxError if ``data`` has another layout."""
        if len(data) != self._size or data[: len(self._prefix)] != self._prefix:
            self._decode_prefix(data)
        rows = np.frombuffer(data, dtype="<f8", offset=len(self._prefix))
        return rows.reshape(-1, len(self._names))

    def _decode_prefix(self, data: bytes | memoryview) -> None:
        names, rows = waveform_samples(deserialize(ARRAY, data))
        if not len(rows):
            raise GearboxError("it holds no rows")
        if names != self._names:
            raise GearboxError(f"its columns are {', '.join(names):.200}, not {', '.join(self._names):.200}")
        prefix = bytes(data[: len(data) - rows.nbytes])
        if data[len(prefix) :] != rows.astype("<f8").tobytes():
            raise GearboxError("its numbers are not the last of its bytes, or not little endian")
        self._size, self._prefix = len(data), prefix


def row_count(data: bytes | memoryview) -> int:
    """Number of rows of CDR with the layout of the waveform and any columns.

    Raises GearboxError if ``data`` has another layout.
    """
    return len(waveform_samples(deserialize(ARRAY, data))[1])


def waveform_samples(message: Any) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Names of the columns, and rows (n, columns), of a message with the layout of the waveform.

    Raises GearboxError if it has another layout, or its numbers do not fill the rows.
    """
    dimensions = message.layout.dim
    if len(dimensions) != 2:
        raise GearboxError(f"its layout has {len(dimensions)} dimensions, rows of numbers have 2")
    names = tuple(dimensions[1].label.split(","))
    numbers = np.asarray(message.data, dtype=np.float64)
    if len(numbers) != dimensions[0].size * len(names):
        raise GearboxError(
            f"it holds {len(numbers)} numbers, its layout {dimensions[0].size} rows of {len(names)} columns"
        )
    return names, numbers.reshape(-1, len(names))


def applied_commands(message: Any) -> Commands:
    """Commands in force of an ``applied_command`` message.

    Raises GearboxError if one of them is missing or not finite.
    """
    if len(message.effort) != 2 or len(message.velocity) != 2:
        raise GearboxError(
            f"it has {len(message.effort)} efforts and {len(message.velocity)} velocities, "
            "commands in force have 2 of each"
        )
    commands = Commands(
        drive_torque=float(message.effort[0]),
        load_torque=float(message.effort[1]),
        speed=float(message.velocity[0]),
    )
    if not all(map(math.isfinite, commands)):
        raise GearboxError(f"its commands are not finite: {commands}")
    return commands


def requested_changes(key: str, message: Any, prefix: str) -> tuple[dict[str, float], list[str]]:
    """Changes that a message on the command topic ``key`` requests, and names of joints without commands.

    The changes are values by field of Commands; ``prefix`` is joint_prefix.
    """
    if key == JOINT_COMMAND:
        return joint_changes(prefix, message.name, message.velocity, message.effort)
    return {FLOAT_COMMANDS[key]: float(message.data)}, []


def joint_changes(
    prefix: str, names: Sequence[str], velocity: Sequence[float], effort: Sequence[float]
) -> tuple[dict[str, float], list[str]]:
    """Changes that a JointState requests, by field of Commands, and its names of joints without commands.

    An empty array, or a missing or NaN entry, leaves that command unchanged.
    """
    changes: dict[str, float] = {}
    unknown: list[str] = []
    for index, name in enumerate(names):
        if name == f"{prefix}driving":
            _put(changes, "speed", velocity, index)
            _put(changes, "drive_torque", effort, index)
        elif name == f"{prefix}driven":
            _put(changes, "load_torque", effort, index)
        elif name != f"{prefix}mesh":  # ros2_control sends all joints, with or without commands
            unknown.append(name)
    return changes, unknown


def _put(changes: dict[str, float], name: str, values: Sequence[float], index: int) -> None:
    if index < len(values) and not math.isnan(values[index]):
        changes[name] = float(values[index])


def _event(text: str) -> OperatorEvent:
    try:
        entries = _mapping(json.loads(text))
        return OperatorEvent(
            sample=_integer(entries["sample"]),
            time=_finite(entries["time"]),
            kind=_text(entries["event"]),
            message=_text(entries["message"]),
            counters=_counters(_mapping(entries["counters"])),
            parameters=_printable(_mapping(entries.get("parameters", {}))),
            checkpoint=_mapping(entries.get("checkpoint", {})),
            commands={name: _finite(value) for name, value in _mapping(entries.get("commands", {})).items()},
        )
    except KeyError as error:
        raise GearboxError(f"the event has no entry {error}") from error
    except (RecursionError, TypeError, ValueError) as error:
        raise GearboxError(f"not an event in JSON: {error}") from error


def _counters(entries: Mapping[str, Any]) -> Counters:
    return Counters(*(_integer(entries[name]) for name in Counters._fields))


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError(f"{value!r:.40} is not an object")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is not a text")
    return _printable(value)


def _printable(value: T) -> T:
    """Return ``value``. Raises ValueError if a text in it has half a surrogate pair, which JSON allows."""
    json.dumps(value, ensure_ascii=False).encode()
    return value


def _integer(value: Any) -> int:
    # Such as an index of a sample: the time in ns must fit into 64 bits.
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 1 << 62:
        raise TypeError(f"{value!r:.40} is not a count")
    return value


def _finite(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= 1e300:
        raise TypeError(f"{value!r:.40} is not a finite number")
    return float(value)
