"""``replay verify BAG``: prove that the model reproduces a recording bit for bit."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.faults import warn_of_faults
from gear_dynamics_ros.cli.progress import Progress, stderr_lines
from gear_dynamics_ros.system.command import FAILURE


def add_verify(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser(
        "verify",
        help="re-simulate a recording and compare every sample bit for bit",
        description="Run the model again from the recorded start, with the recorded commands and events, and "
        "compare every sample, every message of a chunk and every stored state bit for bit. Exit code 0: no "
        "difference; 1: something differs, or can't be read.",
    )
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    parser.add_argument(
        "--from",
        dest="start",
        type=float,
        metavar="S",
        help="start at the last state stored before this simulated time, s",
    )
    parser.set_defaults(command=_verify)


def _verify(arguments: argparse.Namespace) -> int:
    # Imported here: loading the kernel takes time, and the other verbs do not need it.
    from gear_dynamics_ros.replay.verify import verify_recording
    from gear_dynamics_ros.simulation.provenance import provenance_differences
    from gear_dynamics_ros.simulation.warm_up import warm_up

    bag = recording.open(arguments.bag)
    warm_up(*stderr_lines("replay"))
    with Progress("verified", bag.end_sample - bag.first_sample) as progress:
        result = verify_recording(bag, arguments.start, progress)
    warn_of_faults("replay", bag)
    if result.difference is not None:
        print(f"replay: error: {bag.path}: {result.difference}", file=sys.stderr)
        for line in provenance_differences(bag.run.provenance):
            print(f"replay: {line}", file=sys.stderr)
        return FAILURE
    print(
        f"{bag.path}: {result.samples} samples of {len(bag.channel_names)} channels are the same to the bit, "
        f"as are {result.messages} messages and {result.states} stored states; "
        f"{result.simulated:.6g} s in {result.elapsed:.2f} s, "
        f"{result.simulated / result.elapsed:.2f} times real time"
    )
    if not bag.concluded:
        print("the recording was not concluded: the run may have continued after its last sample")
    return 0
