"""ROS 2 messages and CDR, without ROS."""

from __future__ import annotations

from typing import Any, Final

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from gear_dynamics_ros.errors import GearboxError

TYPESTORE: Final = get_typestore(Stores.ROS2_JAZZY)


def serialize(type_name: str, message: Any) -> bytes:
    """CDR (little endian, with its header) of a rosbags message."""
    return bytes(TYPESTORE.serialize_cdr(message, type_name))


def deserialize(type_name: str, data: bytes | memoryview) -> Any:
    """Message of the type ``type_name`` from CDR. Raises GearboxError if ``data`` is not one."""
    try:
        return TYPESTORE.deserialize_cdr(data, type_name)
    except SerdeError as error:
        raise GearboxError(f"not valid CDR of {type_name}: {error}") from error


def message_class(type_name: str) -> Any:
    """Class of the messages that ``serialize`` takes; fields as in ROS, arrays as NumPy arrays."""
    return TYPESTORE.types[type_name]


def require_stampable(time_ns: int) -> None:
    """Raise GearboxError if no stamp of ROS can hold ``time_ns``: its seconds have 32 bits."""
    if not -(2**31) <= time_ns // 1_000_000_000 < 2**31:
        raise GearboxError(
            f"the time {time_ns / 1e9:.0f} s since 1970 does not fit into the stamps of ROS, which end at "
            "2147483647 s (in January 2038): set the clock of this machine"
        )


def stamp(time_ns: int) -> Any:
    """builtin_interfaces/Time from an integer number of nanoseconds. Raises as ``require_stampable``."""
    require_stampable(time_ns)
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return message_class("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)


def stamp_ns(time: Any) -> int:
    """Integer number of nanoseconds of a builtin_interfaces/Time."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)
