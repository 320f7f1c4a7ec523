"""`replay publish`: play a recording's commands to a running gearbox."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.common import SIGNALLED, Progress
from gear_dynamics_ros.cli.ros import add_gearbox, full_name, needing_ros
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.harness import recorded
from gear_dynamics_ros.harness.player import Player

DESCRIPTION = """\
Plays the commands of a recording to a running gearbox, as a what-if: the same commands against other
parameters. The gearbox is first put back to its start state, and the recording's first sample is time 0.
Without --lockstep the gearbox runs at its own pace and commands come a chunk or two late; with --lockstep it
is paused and stepped, and every command acts at exactly its recorded sample."""
EPILOG = """\
Exit code: 0 if the recording was played to its end, 1 if not, 2 on bad usage, 130 on Ctrl-C."""


def add_publish(verbs: Any) -> None:
    """Add the verb to those of ``replay``."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "publish",
        help="play a recording's commands to a running gearbox",
        description=DESCRIPTION,
        epilog=EPILOG,
    )
    parser.set_defaults(command=publish_bag)
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    add_gearbox(parser)
    parser.add_argument(
        "--lockstep",
        dest="play",
        action="store_const",
        const=_step,
        default=_follow,
        help="to the sample: pause the gearbox, step it from command to command, play recorded resets and "
        "parameter changes too, and let it go on in the end if it ran before",
    )
    parser.add_argument(
        "--no-reset",
        dest="reset",
        action="store_false",
        help="go on from the state in which the gearbox is, not from its start state",
    )
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="...",
        help="this and all that follows goes to ROS",
    )


def publish_bag(arguments: argparse.Namespace) -> int:
    """Play the recording; returns the exit code."""
    bag = recording.open(arguments.bag)
    if arguments.reset and not recorded.starts_from_start_state(bag):
        print(
            f"replay: {bag.path} begins in the midst of a run, the gearbox at its start state: expect their "
            "waveforms to differ",
            file=sys.stderr,
        )
    return int(arguments.play(bag, arguments))


def _follow(bag: recording.Recording, arguments: argparse.Namespace) -> int:
    with needing_ros():
        from gear_dynamics_ros.ros.profile_client import play_profile
    node = full_name(arguments.node)
    profile = replace(recorded.profile(bag), reset=arguments.reset)
    _tell_left_out(recorded.left_out_of_profile(bag), "; with --lockstep resets and changes are")
    print(f"playing {bag.path} to {node}: {profile.duration:g} s of simulated time", flush=True)
    reached = 0.0
    with Progress("published", bag.duration_ns) as progress:

        def watch(player: Player) -> None:
            nonlocal reached
            if reached == 0.0 and player.started_at:
                print(f"time 0 of the recording is at {player.started_at:.9g} s", flush=True)
            reached = player.time
            progress(player.time_ns)

        outcome = play_profile(profile, node, arguments.wait, arguments.timeout, watch, _ros(arguments))
    print(
        f"{outcome.published} commands published over {reached:.9g} s of simulated time, values that stay "
        "ten times a second; each acts at the chunk edge after it came, a chunk or two late",
        flush=True,
    )
    return _verdict(outcome.failure, outcome.signal)


def _step(bag: recording.Recording, arguments: argparse.Namespace) -> int:
    with needing_ros():
        from gear_dynamics_ros.ros.lockstep_client import play_script
    node = full_name(arguments.node)
    script = recorded.script(bag)
    if arguments.reset:
        script = recorded.from_start_state(script)
    _tell_left_out(recorded.left_out_of_script(bag), "")
    print(f"playing {bag.path} to {node} in lockstep: {script.duration_ns / 1e9:g} s", flush=True)
    with Progress("published", script.duration_ns) as progress:
        outcome = play_script(script, node, arguments.wait, arguments.timeout, progress, _ros(arguments))
    if outcome.origin >= 0:
        print(
            f"{outcome.published} commands published, {outcome.time_ns / 1e9:.9g} s simulated; time 0 of the "
            f"recording is sample {outcome.origin} of the gearbox"
        )
        print(f"{node} {'goes on running' if outcome.left_running else 'stays paused'}, as it was found")
    return _verdict(outcome.failure, outcome.signal)


def _verdict(failure: str, signal: int) -> int:
    if signal:
        print(f"replay: {failure}", file=sys.stderr)
        return SIGNALLED + signal
    if failure:
        raise GearboxError(failure)
    return 0


def _tell_left_out(kinds: Counter[str], remedy: str) -> None:
    told = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
    if told:
        print(f"replay: not played: {told}{remedy}", file=sys.stderr)


def _ros(arguments: argparse.Namespace) -> list[str]:
    return ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
