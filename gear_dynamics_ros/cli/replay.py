"""replay: look into a recording, or prove that the model gives it again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from gear_dynamics_ros import recording, replay
from gear_dynamics_ros.cli.common import FAILURE, Progress, guarded
from gear_dynamics_ros.cli.replay_recover import add_recover


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="replay", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    info = verbs.add_parser("info", help="what a recording holds")
    info.set_defaults(command=show_info)
    verify = verbs.add_parser("verify", help="re-simulate a recording and compare every sample bit for bit")
    verify.set_defaults(command=verify_bag)
    for verb in (info, verify):
        verb.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    add_recover(verbs)
    return guarded(lambda arguments: int(arguments.command(arguments)), parser, argv)


def show_info(arguments: argparse.Namespace) -> int:
    """Print what the recording holds."""
    bag = recording.open(arguments.bag)
    print(f"{bag.path}: {'complete' if bag.complete else 'broken off: what was flushed is readable'}")
    print(f"version {bag.version}, kernel {bag.kernel_hash[:12]}, model {bag.parameters.model}")
    print(
        f"{bag.end_sample - bag.first_sample} samples of {len(bag.channel_names)} channels every "
        f"{bag.sample_interval_ns} ns: {bag.duration_ns / 1e9:.6g} s from "
        f"{bag.first_sample * bag.sample_interval_ns / 1e9:.6g} s on; {bag.size / 1e6:.1f} MB"
    )
    for part in bag.parts:
        print(f"  {part.path.name}  {part.size / 1e6:.1f} MB{'' if part.complete else '  broken off'}")
    for topic in bag.topics:
        print(f"  {topic.messages:>8}  {topic.name}  {topic.type}")
    for sample, commands in bag.commands:
        seconds = sample * bag.sample_interval_ns / 1e9
        print(
            f"  command at {seconds:.6f} s (sample {sample}): drive {commands.drive_torque:g} N m, "
            f"load {commands.load_torque:g} N m, speed {commands.speed:g} rad/s"
        )
    for event in bag.events:
        changed = ", ".join(f"{name} = {value}" for name, value in event.parameters.items())
        what = event.message or changed
        print(f"  {event.kind} at {event.time:.6f} s (sample {event.sample}) {what}".rstrip())
    return 0


def verify_bag(arguments: argparse.Namespace) -> int:
    """Verify the recording; exit code 1 on a difference."""
    bag = recording.open(arguments.bag)
    with Progress("verified", bag.end_sample - bag.first_sample) as progress:
        result = replay.verify(bag, progress)
    if result.difference is None:
        print(
            f"{bag.path}: {result.samples} samples of {len(bag.channel_names)} channels came out the same "
            f"to the bit; {result.simulated:.6g} s in {result.elapsed:.2f} s"
        )
        return 0
    sample, channel, recorded, simulated = result.difference
    came = "the run had ended" if simulated is None else f"now {simulated!r}"
    print(
        f"replay: error: {bag.path}: sample {sample}, {channel}: recorded {recorded!r}, {came}",
        file=sys.stderr,
    )
    for line in replay.origins(bag):
        print(f"replay: {line}", file=sys.stderr)
    return FAILURE


if __name__ == "__main__":
    sys.exit(main())
