"""`drive`: play a command profile to a running gearbox and check what it does."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gear_dynamics_ros.cli.common import FAILURE, guarded
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness import Player, Result, format_results, load_profile

ROS_PACKAGES = ("rclpy", "std_msgs")
REDRAW = 0.2  # s of wall time


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0 if the profile was played and every expectation held, 1 if not, 2 on bad usage."""
    own, ros = _split(sys.argv[1:] if argv is None else argv)
    return guarded(partial(_drive, ros_arguments=ros), _parser(), own)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drive",
        description="Plays a command profile to a running gearbox over topics, following its simulated time, "
        "and checks expectations on its waveform. Commands stay at their last value afterwards.",
        epilog="--ros-args and what follows it go to ROS.",
    )
    parser.add_argument("profile", type=Path, metavar="PROFILE", help="YAML file, see config/profiles")
    parser.add_argument("--node", default="/gearbox", help="full name of the gearbox (default: %(default)s)")
    parser.add_argument(
        "--wait",
        type=_seconds,
        default=20.0,
        help="wall seconds to wait for the gearbox (default: %(default)g)",
    )
    parser.add_argument(
        "--timeout",
        type=_seconds,
        default=10.0,
        help="wall seconds without a waveform after which to give up (default: %(default)g)",
    )
    return parser


def _drive(arguments: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    profile = load_profile(arguments.profile)
    node = arguments.node if arguments.node.startswith("/") else f"/{arguments.node}"
    try:
        from gear_dynamics_ros.harness_client import play
    except ModuleNotFoundError as error:
        if error.name not in ROS_PACKAGES:
            raise
        remedy = "source your ROS 2 installation, or pip install 'gear_dynamics_ros[ros]'"
        raise GearboxError(f"{error.name}: not found; {remedy}") from error
    print(f"playing {arguments.profile} to {node}: {profile.duration:g} s of simulated time", flush=True)
    display = _Display()
    try:
        outcome = play(profile, node, arguments.wait, arguments.timeout, display.update, ros_arguments)
    finally:
        display.close()
    print(f"{outcome.published} commands published")
    if outcome.results:
        print(format_results(outcome.results), flush=True)
    if outcome.failure:
        raise GearboxError(outcome.failure)
    return _verdict(outcome.results)


def _verdict(results: Sequence[Result]) -> int:
    failed = [result for result in results if not result.passed]
    for result in failed:
        print(f"drive: failed: {result.reason()}", file=sys.stderr)
    print(f"{len(results) - len(failed)} of {len(results)} expectations passed")
    return FAILURE if failed else 0


class _Display:
    """Says when the harness has joined; after that, a line of progress where a terminal watches."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._joined = False
        self._due = 0.0

    def update(self, player: Player) -> None:
        """Tell how far ``player`` is."""
        if not self._joined:
            self._joined = True
            print(f"joined at simulated time {player.started_at:.6g} s", flush=True)
        now = time.monotonic()
        if self._terminal and (now >= self._due or player.finished):
            self._due = now + REDRAW
            print(f"\r{_progress(player)}\x1b[K", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Leave the line of progress."""
        if self._terminal and self._joined:
            print(file=sys.stderr)


def _progress(player: Player) -> str:
    results = player.results()
    over = [result for result in results if result.complete]
    failed = sum(not result.passed for result in over)
    commands = "  ".join(f"{name} {value:.5g}" for name, value in player.commands().items())
    return (
        f"{player.time:6.2f} of {player.profile.duration:g} s  {commands}  expectations: "
        f"{len(over) - failed} passed, {failed} failed, {len(results) - len(over)} to come"
    )


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"is {text}, must be > 0 s and finite")
    return value


def _split(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Own arguments and those from --ros-args on."""
    position = words.index("--ros-args") if "--ros-args" in words else len(words)
    return list(words[:position]), list(words[position:])


if __name__ == "__main__":
    sys.exit(main())
