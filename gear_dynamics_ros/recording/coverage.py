"""Which samples the parts of a recording hold together, and what is missing or does not belong there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from gear_dynamics_ros.errors import GearboxError, one_line
from gear_dynamics_ros.messages.decoder import row_count
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.layout import RunMetadata
from gear_dynamics_ros.recording.parts import PartFile


class SampleRange(NamedTuple):
    """The samples from ``first`` to before ``end``."""

    first: int
    end: int

    def __len__(self) -> int:
        return self.end - self.first

    def text(self, interval_ns: int) -> str:
        """Simulated times of the first and the last sample, for a sample interval in ns."""
        first, last = (sample * interval_ns / 1e9 for sample in (self.first, self.end - 1))
        return f"{self.first} to {self.end - 1} ({first:.6f} s to {last:.6f} s)"


@dataclass(frozen=True)
class Coverage:
    """What the parts of a recording hold."""

    held: tuple[SampleRange, ...]  # in order, without overlap
    gaps: tuple[SampleRange, ...]  # missing between those held
    lost_files: tuple[str, ...]  # a sentence each
    notes: tuple[str, ...]  # what else is not as the recorder left it, a sentence each

    @property
    def samples(self) -> int:
        """Number of samples held."""
        return sum(map(len, self.held))

    @property
    def whole(self) -> bool:
        """Whether all is there and as the recorder left it."""
        return not (self.gaps or self.lost_files or self.notes)


def ordered(parts: Sequence[PartFile]) -> tuple[PartFile, ...]:
    """The parts in the order of their samples. Raises GearboxError if they are not of one run."""
    for part in parts[1:]:
        require_same_run(part.path, part.run, parts[0].path, parts[0].run)
    return tuple(sorted(parts, key=lambda part: part.first_sample))


def require_same_run(path: Path, run: RunMetadata, first_path: Path, first_run: RunMetadata) -> None:
    """Raise GearboxError if the file ``path`` is of another run than ``first_path``."""
    if run != first_run:
        raise GearboxError(f"{path} is of another run than {first_path.name}: move it to a folder of its own")


def require_no_overlap(path: Path, samples: SampleRange, reached: int, interval_ns: int) -> None:
    """Raise GearboxError if ``samples`` of the file ``path`` begin before ``reached``, where others end."""
    if samples.first < reached:
        doubled = SampleRange(samples.first, min(samples.end, reached))
        raise GearboxError(
            f"{path} has the samples {doubled.text(interval_ns)}, which another file has too: "
            "move one of the two away"
        )


def cover(folder: Path, parts: Sequence[PartFile], waveform: str) -> Coverage:
    """Coverage of ``parts``, in order, of the recording ``folder`` or of a single file.

    ``waveform`` is the full name of its topic. Raises GearboxError if two parts have the same samples.
    """
    held: list[SampleRange] = []
    gaps: list[SampleRange] = []
    lost_files, notes = _listed_otherwise(folder, parts)
    reached = parts[0].first_sample
    interval_ns = parts[0].run.sample_interval_ns
    for part in parts:
        try:
            ranges = list(_held(part, waveform))
        except GearboxError as error:
            notes.append(one_line(error))
            ranges = []
        end = ranges[-1].end if ranges else part.first_sample
        require_no_overlap(part.path, SampleRange(part.first_sample, end), reached, interval_ns)
        for samples in ranges:
            if samples.first > reached:
                gaps.append(SampleRange(reached, samples.first))
            reached = samples.end
            held.append(samples)
        if part.index.behind:
            notes.append(f"{part.path.name} has {part.index.behind} bytes behind its end, which are not read")
        elif not part.complete:
            flushed = f"what was flushed is readable, up to {end * interval_ns / 1e9:.9g} s"
            notes.append(f"{part.path.name} is broken off: {flushed}")
    notes += _misnamed(parts)
    return Coverage(tuple(held), tuple(gaps), tuple(lost_files), tuple(notes))


class ListedFile(NamedTuple):
    """A file in metadata.yaml."""

    name: str
    stamps_ns: tuple[int, int] | None  # of its first and last message; None if metadata.yaml does not say

    def text(self, epoch_ns: int) -> str:
        """Name and, if known, simulated times."""
        if self.stamps_ns is None:
            return self.name
        start, end = ((time_ns - epoch_ns) / 1e9 for time_ns in self.stamps_ns)
        return f"{self.name} ({start:.6f} s to {end:.6f} s)"


def listed_files(folder: Path) -> tuple[ListedFile, ...] | None:
    """The files that metadata.yaml lists; None if ``folder`` has none, or is a single file.

    Raises GearboxError if metadata.yaml is damaged.
    """
    path = folder / layout.METADATA_FILE
    if not path.is_file():
        return None
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))[layout.INFORMATION]
        times = {str(file["path"]): file for file in information.get("files", [])}
        return tuple(_listed_file(str(name), times.get(str(name))) for name in information[layout.FILES])
    except (KeyError, OSError, TypeError, ValueError, RecursionError, yaml.YAMLError) as error:
        fault = f"{type(error).__name__}: {one_line(error):.200}"
        raise GearboxError(f"{layout.METADATA_FILE} is damaged: {fault}") from error


def _listed_file(name: str, entry: Any) -> ListedFile:
    if entry is None:
        return ListedFile(name, None)
    start_ns = int(entry["starting_time"]["nanoseconds_since_epoch"])
    return ListedFile(name, (start_ns, start_ns + int(entry["duration"]["nanoseconds"])))


def _listed_otherwise(folder: Path, parts: Sequence[PartFile]) -> tuple[list[str], list[str]]:
    """Sentences on the files lost, and on what else metadata.yaml says otherwise."""
    if folder.is_file():
        return [], []
    try:
        listed = listed_files(folder)
    except GearboxError as error:
        return [str(error)], []
    if listed is None:
        return [], [f"{layout.METADATA_FILE} is missing"]
    names = {part.path.name for part in parts}
    epoch_ns = parts[0].run.epoch_ns
    lost = [
        f"{layout.METADATA_FILE} lists {file.text(epoch_ns)}, which {_what_happened_to(folder / file.name)}"
        for file in listed
        if file.name not in names
    ]
    unlisted = sorted(names - {file.name for file in listed})
    return lost, [f"{layout.METADATA_FILE} does not list {name}" for name in unlisted]


def _what_happened_to(path: Path) -> str:
    if path.exists():
        return "has lost its start: replay recover keeps what is whole"
    return "is missing: put it back"


def _misnamed(parts: Sequence[PartFile]) -> Iterator[str]:
    for earlier, later in pairwise(parts):
        if layout.part_number(earlier.path) > layout.part_number(later.path):
            yield f"{earlier.path.name} and {later.path.name} have each other's place: read in order of time"


def _held(part: PartFile, waveform: str) -> Iterator[SampleRange]:
    """The samples that a part holds. Raises GearboxError if it is damaged."""
    end = _end_sample(part, waveform)
    if end == part.first_sample:
        return
    messages = part.index.topic_counts().get(waveform)
    # No message has more samples than a chunk: with too few messages, some samples are missing.
    most = part.start.checkpoint.parameters.solver.samples_per_chunk
    if messages is None or messages * most >= end - part.first_sample:
        yield SampleRange(part.first_sample, end)
    else:
        yield from _contiguous(part, waveform)


def _end_sample(part: PartFile, waveform: str) -> int:
    """The sample after the last one of the part."""
    if part.end:
        return part.stored(part.end).checkpoint.sample
    last = part.last_message(waveform)
    return part.first_sample if last is None else _sample(part, last.time_ns) + 1


def _contiguous(part: PartFile, waveform: str) -> Iterator[SampleRange]:
    """The samples of each message, joined where they follow each other."""
    joined: SampleRange | None = None
    for message in part.messages([waveform]):
        end = _sample(part, message.time_ns) + 1
        samples = SampleRange(end - row_count(message.data), end)
        if joined is not None and joined.end == samples.first:
            joined = SampleRange(joined.first, end)
            continue
        if joined is not None:
            yield joined
        joined = samples
    if joined is not None:
        yield joined


def _sample(part: PartFile, time_ns: int) -> int:
    return (time_ns - part.run.epoch_ns) // part.run.sample_interval_ns
