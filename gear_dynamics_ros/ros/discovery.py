"""Whom ROS 2 listens to: this machine alone, unless the environment asks for more."""

from __future__ import annotations

import os

from gear_dynamics_ros.system.share import share_file

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCAL = "LOCALHOST"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
# Each of these decides by itself whom ROS 2 reaches, and how.
DECIDING = (
    "FASTDDS_DEFAULT_PROFILES_FILE",
    PROFILES,
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
)


def stay_local() -> None:
    """Keep the ROS 2 of this process on this machine; to be called before rclpy starts.

    Does nothing where the environment names another discovery range or one of DECIDING. Raises GearboxError
    if the package's Fast DDS profile is missing.
    """
    if any(os.environ.get(name) for name in DECIDING) or (os.environ.get(RANGE) or LOCAL) != LOCAL:
        return
    os.environ[RANGE] = LOCAL
    # The range alone confines discovery, but Fast DDS would still receive on every interface.
    os.environ[PROFILES] = str(share_file("config/fastdds_local.xml"))
