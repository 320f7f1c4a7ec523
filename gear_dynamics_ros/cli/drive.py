"""`drive`: play a command profile to a running gearbox and check what it does."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gear_dynamics_ros.cli.common import FAILURE, SIGNALLED, guarded
from gear_dynamics_ros.cli.ros import add_gearbox, full_name, needing_ros
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness import junit
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import load_profile
from gear_dynamics_ros.harness.results import Result, format_results, unreached

REDRAW = 0.2  # s of wall time


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0 if the profile was played and every expectation held, 1 if not, 2 on bad usage.

    128 and the signal's number (130 for Ctrl-C) if a signal broke the run off.
    """
    own, ros = _split(sys.argv[1:] if argv is None else argv)
    return guarded(partial(_drive, ros_arguments=ros), _parser(), own)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drive",
        description="Plays a command profile to a running gearbox over topics, following its simulated time, "
        "and checks expectations on its waveform. Commands and parameters stay as they are afterwards.",
        epilog="--ros-args and what follows it go to ROS. Exit code: 0 if every expectation held, 1 if not, "
        "2 on bad usage, 130 on Ctrl-C.",
    )
    parser.add_argument("profile", type=Path, metavar="PROFILE", help="YAML file, see config/profiles")
    add_gearbox(parser)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the results there as JUnit XML")
    return parser


def _drive(arguments: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    profile = load_profile(arguments.profile)
    with needing_ros():
        from gear_dynamics_ros.ros.profile_client import play_profile
    node = full_name(arguments.node)
    report = _Report(arguments.junit, arguments.profile)
    report.begin(unreached(profile.expectations))
    print(f"playing {arguments.profile} to {node}: {profile.duration:g} s of simulated time", flush=True)
    display = _Display()
    try:
        outcome = play_profile(
            profile, node, arguments.wait, arguments.timeout, display.update, ros_arguments
        )
    finally:
        display.close()
    try:
        report.write(outcome.results, outcome.failure)
    finally:
        print(f"{outcome.published} commands published")
        if outcome.results:
            print(format_results(outcome.results), flush=True)
    if outcome.signal:
        print(f"drive: {outcome.failure}", file=sys.stderr)
        return SIGNALLED + outcome.signal
    if outcome.failure:
        raise GearboxError(outcome.failure)
    return _verdict(outcome.results)


def _verdict(results: Sequence[Result]) -> int:
    failed = [result for result in results if not result.passed]
    for result in failed:
        print(f"drive: failed: {result.reason()}", file=sys.stderr)
    print(f"{len(results) - len(failed)} of {len(results)} expectations passed")
    return FAILURE if failed else 0


class _Report:
    """The JUnit file, if one is wanted."""

    def __init__(self, path: Path | None, profile: Path) -> None:
        self._path = path
        self._profile = profile.stem

    def begin(self, results: Sequence[Result]) -> None:
        """Write a report of a run that did not end: it stays if drive is killed, in place of an older one.

        Raises UsageError where none can be written, before anything is played.
        """
        try:
            self.write(results, "drive did not end by itself")
        except OSError as error:
            raise UsageError(
                f"--junit {self._path}: {error.strerror}; name a file in a folder that can be written to"
            ) from error

    def write(self, results: Sequence[Result], failure: str) -> None:
        """Write the report."""
        if self._path is not None:
            junit.write_report(self._path, self._profile, results, failure)


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


def _split(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Own arguments and those from --ros-args on."""
    position = words.index("--ros-args") if "--ros-args" in words else len(words)
    return list(words[:position]), list(words[position:])


if __name__ == "__main__":
    sys.exit(main())
