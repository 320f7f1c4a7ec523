"""``drive``: play a command profile to a running gearbox and check what it does."""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from gear_dynamics_ros import __version__
from gear_dynamics_ros.cli.progress import ProgressLine
from gear_dynamics_ros.cli.ros import add_gearbox, add_lockstep, full_name, needing_ros, split_ros_arguments
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness.junit import JunitReport
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile, load_profile
from gear_dynamics_ros.harness.results import format_results
from gear_dynamics_ros.system.command import FAILURE, SIGNALLED, run_command

if TYPE_CHECKING:
    from gear_dynamics_ros.harness.outcome import ProfileOutcome
    from gear_dynamics_ros.reporting.drive_report import DriveReport

# What decides how drive and gearbox find and understand each other.
ROS_VARIABLES: Final = (
    "ROS_DISTRO",
    "RMW_IMPLEMENTATION",
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_SECURITY_ENABLE",
)


def drive_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``drive``; returns the exit code.

    0 if the profile was played and every expectation held, 1 if not, 2 on bad usage, 128 + n if signal n
    interrupted it.
    """
    own, ros = split_ros_arguments(sys.argv[1:] if argv is None else argv)
    return run_command(partial(_drive, ros_arguments=ros), _parser(), own)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drive",
        description="Plays a command profile to a running gearbox over topics, following its simulated time, "
        "and checks expectations on its waveform. Afterwards the gearbox keeps the last commands and "
        "parameters.",
        epilog="--ros-args and what follows it go to ROS. Exit code: 0 if every expectation held, 1 if not, "
        "2 on bad usage, 130 on Ctrl-C.",
    )
    parser.add_argument("profile", type=Path, metavar="PROFILE", help="YAML file, see config/profiles")
    add_gearbox(parser)
    add_lockstep(
        parser,
        _play_at_own_pace,
        _play_in_lockstep,
        "exact to the sample, the same bits on every machine: pause the gearbox, step it from command "
        "to command, and let it run on at the end if it ran before",
    )
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the results to FILE as JUnit XML")
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE",
        help="write a report to FILE: an HTML page with results, a plot of each window, and the environment",
    )
    return parser


def _drive(arguments: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    profile = load_profile(arguments.profile)
    node = full_name(arguments.node)
    junit = None if arguments.junit is None else JunitReport(arguments.junit, arguments.profile.stem)
    report = None if arguments.report is None else _report(arguments, profile, node)
    if junit is not None:
        junit.write_unfinished(profile.expectations)
    if report is not None:
        report.write_unfinished()
    print(f"playing {arguments.profile} to {node}: {profile.duration:g} s of simulated time", flush=True)
    with ProgressLine() as line:
        watch = _Watch(line)
        outcome: ProfileOutcome = arguments.play(
            profile, node, arguments.wait, arguments.timeout, watch, ros_arguments
        )
    with ExitStack() as writing:
        writing.callback(_print_outcome, outcome, node)
        if report is not None:
            writing.callback(report.write, outcome)
        if junit is not None:
            junit.write(outcome.results, outcome.failure)
    if outcome.signal:
        print(f"drive: {outcome.failure}", file=sys.stderr)
        return SIGNALLED + outcome.signal
    if outcome.failure:
        raise GearboxError(outcome.failure)
    return _exit_code(outcome)


def _print_outcome(outcome: ProfileOutcome, node: str) -> None:
    print(f"{outcome.published} commands published{_lateness(outcome.lateness)}")
    if outcome.state:
        print(f"{node} {outcome.state}, as before")
    if outcome.results:
        print(format_results(outcome.results), flush=True)


def _report(arguments: argparse.Namespace, profile: Profile, node: str) -> DriveReport:
    # Imported here, so that a run without a report needs no templates.
    from gear_dynamics_ros.reporting.drive_report import DriveReport
    from gear_dynamics_ros.simulation.provenance import processor_name

    lockstep = arguments.play is _play_in_lockstep
    pace = (
        "in lockstep: the gearbox was stepped, and each command acted at exactly its sample"
        if lockstep
        else "at the pace of the gearbox"
    )
    environment = {
        "drive": f"gear_dynamics_ros {__version__}",
        "Python": platform.python_version(),
        "system": platform.platform(),
        "processor": processor_name(),
        **{name: os.environ[name] for name in ROS_VARIABLES if name in os.environ},
    }
    return DriveReport(arguments.report, profile, arguments.profile, node, pace, environment)


def _play_at_own_pace(*arguments: Any) -> ProfileOutcome:
    with needing_ros():
        from gear_dynamics_ros.ros.profile_client import play_profile
    return play_profile(*arguments)


def _play_in_lockstep(*arguments: Any) -> ProfileOutcome:
    with needing_ros():
        from gear_dynamics_ros.ros.lockstep_profile_client import play_profile_in_lockstep
    return play_profile_in_lockstep(*arguments)


def _exit_code(outcome: ProfileOutcome) -> int:
    """Say which expectations did not pass, and why; FAILURE if there are any."""
    results = outcome.results
    for result in results:
        if not result.passed:
            print(f"drive: {'failed: ' if result.failed else ''}{result.reason()}", file=sys.stderr)
    if any(result.unjudged for result in results):
        print(f"drive: error: {_slowness(outcome)}", file=sys.stderr)
    passed = sum(result.passed for result in results)
    print(f"{passed} of {len(results)} expectations passed")
    return 0 if passed == len(results) else FAILURE


def _lateness(lateness: Sequence[float]) -> str:
    if not lateness:
        return ""
    return (
        f"; they acted {statistics.median(lateness) * 1e3:.3g} ms late (median), "
        f"{max(lateness) * 1e3:.3g} ms at most, in simulated time"
    )


def _slowness(outcome: ProfileOutcome) -> str:
    return (
        f"the machine was too slow: simulated time ran at {outcome.real_time_factor:.2g} of real time, "
        f"commands acted up to {max(outcome.lateness, default=0.0):.2g} s late; use --lockstep"
    )


class _Watch:
    """Says once that the player has joined the gearbox, then shows how far it is."""

    def __init__(self, line: ProgressLine) -> None:
        self._line = line
        self._joined = False

    def __call__(self, player: Player) -> None:
        if not self._joined:
            self._joined = True
            print(f"joined at simulated time {player.started_at:.6g} s", flush=True)
        self._line.show(lambda: _progress(player))


def _progress(player: Player) -> str:
    results = player.results()
    over = [result for result in results if result.complete]
    failed = sum(not result.passed for result in over)
    commands = "  ".join(f"{name} {value:.5g}" for name, value in player.commands().items())
    return (
        f"{player.time:6.2f} of {player.profile.duration:g} s  {commands}  expectations: "
        f"{len(over) - failed} passed, {failed} failed, {len(results) - len(over)} to come"
    )


if __name__ == "__main__":
    sys.exit(drive_main())
