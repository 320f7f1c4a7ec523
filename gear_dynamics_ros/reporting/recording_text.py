"""Content of a recording as text."""

from __future__ import annotations

from collections.abc import Iterator

from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.recording.parts import PartFile


def recording_lines(bag: Recording) -> Iterator[str]:
    """Version, samples, parts, topics, commands and events of ``bag``, as lines of text.

    Raises GearboxError at a damaged message.
    """
    yield f"{bag.path}: {'complete' if bag.complete else 'not complete; replay recover keeps what is whole'}"
    yield from fault_lines(bag)
    yield f"version {bag.version}, kernel {bag.kernel_hash[:12]}, model {bag.parameters.model}"
    yield f"made on {bag.run.provenance.processor or 'an unknown processor'}"
    yield (
        f"{bag.samples} samples of {len(bag.channel_names)} channels every "
        f"{bag.sample_interval_ns} ns: {bag.samples * bag.sample_interval_ns / 1e9:.6g} s from "
        f"{_seconds(bag, bag.first_sample):.6g} s on; {bag.size / 1e6:.1f} MB"
    )
    for part in bag.parts:
        yield f"  {part.path.name}  {_part_text(bag, part)}"
    for topic in bag.topics:
        yield f"  {topic.messages:>8}  {topic.name}  {topic.type}"
    for sample, commands in bag.commands:
        yield f"  command at {_seconds(bag, sample):.6f} s (sample {sample}): {commands}"
    for event in bag.events:
        yield f"  {event.kind} at {event.time:.6f} s (sample {event.sample}) {_event_text(event)}".rstrip()


def fault_lines(bag: Recording) -> tuple[str, ...]:
    """What is missing in ``bag`` or not as the recorder left it, a line each."""
    gaps = (
        f"{len(gap)} samples are missing: {gap.text(bag.sample_interval_ns)}" for gap in bag.coverage.gaps
    )
    return (*bag.coverage.lost_files, *gaps, *bag.coverage.notes)


def _seconds(bag: Recording, sample: int) -> float:
    return sample * bag.sample_interval_ns / 1e9


def _part_text(bag: Recording, part: PartFile) -> str:
    states = len(part.checkpoints)
    return (
        f"{part.size / 1e6:.1f} MB from {_seconds(bag, part.first_sample):.6g} s on, "
        f"{states} checkpoint{'' if states == 1 else 's'}{'' if part.end else ', broken off'}"
    )


def _event_text(event: OperatorEvent) -> str:
    return event.message or ", ".join(f"{name} = {value}" for name, value in event.parameters.items())
