"""What the commands for a running gearbox share; their --help works without rclpy."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from gear_dynamics_ros.errors import GearboxError

PACKAGES = ("rclpy", "rcl_interfaces", "sensor_msgs", "std_msgs", "std_srvs")


def add_gearbox(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the gearbox and limit the waiting for it."""
    parser.add_argument("--node", default="/gearbox", help="full name of the gearbox (default: %(default)s)")
    parser.add_argument(
        "--wait",
        type=_seconds,
        default=20.0,
        metavar="S",
        help="wall seconds to wait for the gearbox, its start not counted (default: %(default)g)",
    )
    parser.add_argument(
        "--timeout",
        type=_seconds,
        default=10.0,
        metavar="S",
        help="wall seconds without a waveform or an answer after which to give up (default: %(default)g)",
    )


def add_lockstep(
    parser: argparse.ArgumentParser,
    at_own_pace: Callable[..., Any],
    in_lockstep: Callable[..., Any],
    help_text: str,
) -> None:
    """Add the option --lockstep; ``play`` of the arguments is then one of the two functions."""
    parser.add_argument(
        "--lockstep",
        dest="play",
        action="store_const",
        const=in_lockstep,
        default=at_own_pace,
        help=help_text,
    )


def full_name(node: str) -> str:
    """``node`` with a slash in front, which the user may leave out."""
    return node if node.startswith("/") else f"/{node}"


def split_ros_arguments(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The command's own arguments, and those for ROS: from each --ros-args to the next -- or the end."""
    own: list[str] = []
    ros: list[str] = []
    for word in words:
        if word == "--ros-args" or ros[-1:] not in ([], ["--"]):
            ros.append(word)
        else:
            own.append(word)
    return own, ros


@contextmanager
def needing_ros() -> Iterator[None]:
    """Around imports that need rclpy. Raises GearboxError with the remedy if ROS is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in PACKAGES:
            raise
        remedy = "source your ROS 2 installation, or pip install 'gear_dynamics_ros[ros]'"
        raise GearboxError(f"{error.name}: not found; {remedy}") from error


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"is {text}, must be > 0 s and finite")
    return value
