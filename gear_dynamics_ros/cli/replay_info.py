"""``replay info BAG``: what a recording holds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.recording import Event, Recording
from gear_dynamics_ros.recording.parts import PartFile


def add_info(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser("info", help="what a recording holds")
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    parser.set_defaults(command=show_info)


def show_info(arguments: argparse.Namespace) -> int:
    """Print what the recording holds."""
    for line in description(recording.open(arguments.bag)):
        print(line)
    return 0


def description(bag: Recording) -> Iterator[str]:
    """The lines."""
    state = (
        "complete"
        if bag.complete
        else "broken off: what was flushed is readable; replay recover completes it"
    )
    yield f"{bag.path}: {state}"
    yield f"version {bag.version}, kernel {bag.kernel_hash[:12]}, model {bag.parameters.model}"
    yield f"made on {bag.run.provenance.processor or 'a processor that it does not tell'}"
    yield (
        f"{bag.end_sample - bag.first_sample} samples of {len(bag.channel_names)} channels every "
        f"{bag.sample_interval_ns} ns: {bag.duration_ns / 1e9:.6g} s from "
        f"{_seconds(bag, bag.first_sample):.6g} s on; {bag.size / 1e6:.1f} MB"
    )
    for part in bag.parts:
        yield f"  {part.path.name}  {_part(bag, part)}"
    for topic in bag.topics:
        yield f"  {topic.messages:>8}  {topic.name}  {topic.type}"
    for sample, commands in bag.commands:
        yield (
            f"  command at {_seconds(bag, sample):.6f} s (sample {sample}): "
            f"drive {commands.drive_torque:g} N m, load {commands.load_torque:g} N m, "
            f"speed {commands.speed:g} rad/s"
        )
    for event in bag.events:
        yield f"  {event.kind} at {event.time:.6f} s (sample {event.sample}) {_what(event)}".rstrip()


def _seconds(bag: Recording, sample: int) -> float:
    return sample * bag.sample_interval_ns / 1e9


def _part(bag: Recording, part: PartFile) -> str:
    states = len(part.checkpoints)
    return (
        f"{part.size / 1e6:.1f} MB from {_seconds(bag, part.first_sample):.6g} s on, "
        f"{states} checkpoint{'' if states == 1 else 's'}{'' if part.complete else ', broken off'}"
    )


def _what(event: Event) -> str:
    return event.message or ", ".join(f"{name} = {value}" for name, value in event.parameters.items())
