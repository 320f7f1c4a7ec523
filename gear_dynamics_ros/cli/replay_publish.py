"""``replay publish BAG``: play the commands of a recording to a running gearbox."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.cli.ros import add_gearbox, add_lockstep, full_name, needing_ros
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import step_profile
from gear_dynamics_ros.replay import publish
from gear_dynamics_ros.system.command import SIGNALLED

DESCRIPTION = """\
Plays the commands of a recording to a running gearbox, for example to one with other parameters. The gearbox
is first reset to its start state, and the recording's first sample is time 0. Without --lockstep the gearbox
runs at its own pace, and commands act a chunk or two late; with --lockstep it is paused and stepped, and
every command acts at exactly its recorded sample."""
EPILOG = """\
Exit code: 0 if the recording was played to its end, 1 if not, 2 on bad usage, 130 on Ctrl-C."""


def add_publish(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "publish",
        help="play a recording's commands to a running gearbox",
        description=DESCRIPTION,
        epilog=EPILOG,
    )
    parser.set_defaults(command=_publish)
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    add_gearbox(parser)
    add_lockstep(
        parser,
        _play_at_own_pace,
        _play_in_lockstep,
        "exact to the sample: pause the gearbox, step it from command to command, play recorded resets "
        "and parameter changes too, and let it run on at the end if it ran before",
    )
    parser.add_argument(
        "--no-reset",
        dest="reset",
        action="store_false",
        help="start from the present state of the gearbox, not from its start state",
    )
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="...",
        help="this and all that follows goes to ROS",
    )


def _publish(arguments: argparse.Namespace) -> int:
    bag = _opened(arguments.bag)
    if arguments.reset and not publish.starts_at_start_state(bag):
        print(
            f"replay: {bag.path} begins in the middle of a run, the gearbox at its start state: their "
            "waveforms will differ",
            file=sys.stderr,
        )
    return int(arguments.play(bag, arguments))


def _opened(path: str) -> recording.Recording:
    """The recording ``path``. Raises UsageError if it is none: nothing was asked of a gearbox yet."""
    try:
        return recording.open(path)
    except GearboxError as error:
        raise UsageError(str(error)) from error


def _play_at_own_pace(bag: recording.Recording, arguments: argparse.Namespace) -> int:
    with needing_ros():
        from gear_dynamics_ros.ros.profile_client import play_profile
    node = full_name(arguments.node)
    script = publish.command_script(bag)
    commands = [(step.time_ns / 1e9, step.commands) for step in script.steps]
    profile = step_profile(f"commands of {bag.path}", script.duration_ns / 1e9, commands)
    profile = replace(profile, reset=arguments.reset)
    _print_skipped(publish.skipped_by_commands(bag), "; with --lockstep resets and changes are")
    print(f"playing {bag.path} to {node}: {profile.duration:g} s of simulated time", flush=True)
    reached = 0.0
    with Progress("published", bag.duration_ns) as progress:

        def watch(player: Player) -> None:
            nonlocal reached
            if reached == 0.0 and player.started_at:
                print(f"time 0 of the recording is at {player.started_at:.9g} s", flush=True)
            reached = player.time
            progress(player.time_ns)

        outcome = play_profile(
            profile, node, arguments.wait, arguments.timeout, watch, _ros_arguments(arguments)
        )
    print(
        f"{outcome.published} commands published over {reached:.9g} s of simulated time, unchanged "
        "values ten times a second; each acts at the next chunk edge, a chunk or two late",
        flush=True,
    )
    return _exit_code(outcome.failure, outcome.signal)


def _play_in_lockstep(bag: recording.Recording, arguments: argparse.Namespace) -> int:
    with needing_ros():
        from gear_dynamics_ros.ros.lockstep_client import play_script
    node = full_name(arguments.node)
    script = publish.full_script(bag)
    if arguments.reset:
        script = publish.with_initial_reset(script)
    _print_skipped(publish.skipped_by_script(bag), "")
    print(f"playing {bag.path} to {node} in lockstep: {script.duration_ns / 1e9:g} s", flush=True)
    with Progress("published", script.duration_ns) as progress:
        outcome = play_script(
            script, node, arguments.wait, arguments.timeout, progress, _ros_arguments(arguments)
        )
    if outcome.origin >= 0:
        print(
            f"{outcome.published} commands published, {outcome.time_ns / 1e9:.9g} s simulated; time 0 of the "
            f"recording is sample {outcome.origin} of the gearbox"
        )
    if outcome.state:
        print(f"{node} {outcome.state}, as before")
    return _exit_code(outcome.failure, outcome.signal)


def _exit_code(failure: str, signal: int) -> int:
    if signal:
        print(f"replay: {failure}", file=sys.stderr)
        return SIGNALLED + signal
    if failure:
        raise GearboxError(failure)
    return 0


def _print_skipped(kinds: Counter[str], remedy: str) -> None:
    skipped = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
    if skipped:
        print(f"replay: not played: {skipped}{remedy}", file=sys.stderr)


def _ros_arguments(arguments: argparse.Namespace) -> list[str]:
    return ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
