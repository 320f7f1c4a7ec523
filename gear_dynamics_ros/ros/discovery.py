"""Keeps the communication of ROS 2 on this machine, unless the environment says otherwise."""

from __future__ import annotations

import os

from gear_dynamics_ros.errors import one_line
from gear_dynamics_ros.system.share import share_file

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCAL = "LOCALHOST"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
# Each of these variables sets by itself which machines ROS 2 reaches, and how.
DECIDING = (
    "FASTDDS_DEFAULT_PROFILES_FILE",
    PROFILES,
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
)


# What to do where the message of rclpy has these words.
REMEDIES = {
    "log directory": "set ROS_LOG_DIR to a folder that can be written to",
    "security libraries": "use a ROS installation whose Fast DDS has security, or unset ROS_SECURITY_ENABLE",
}


def start_failure(error: Exception) -> str:
    """Why rclpy did not start or made no node, in a line, and what to do about it where that is known."""
    if isinstance(error, UnicodeEncodeError):
        return f"{error.object!r} is not UTF-8 text, which ROS needs: choose another name or path"
    known = [remedy for words, remedy in REMEDIES.items() if words in str(error)]
    return ": ".join([one_line(error), *known])


def stay_local() -> None:
    """Keep ROS 2 communication of this process on this machine. Call it before rclpy starts.

    Does nothing if the environment sets another discovery range or one of DECIDING. Raises GearboxError if
    the Fast DDS profile of the package is missing.
    """
    if any(os.environ.get(name) for name in DECIDING) or (os.environ.get(RANGE) or LOCAL) != LOCAL:
        return
    os.environ[RANGE] = LOCAL
    # The range limits discovery only: Fast DDS would still receive on all interfaces.
    os.environ[PROFILES] = str(share_file("config/fastdds_local.xml"))
