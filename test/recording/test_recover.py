"""Recovery: recordings cut, killed, damaged and made up; what was whole is kept to the bit, nothing else."""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Commands, Status
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.cdr import deserialize, serialize
from gear_dynamics_ros.messages.decoder import waveform_samples
from gear_dynamics_ros.messages.encoder import Encoder, waveform_message
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.layout import RunMetadata
from gear_dynamics_ros.recording.mcap import writer
from gear_dynamics_ros.recording.mcap.index import ending, read_index, read_metadata
from gear_dynamics_ros.recording.mcap.records import encode, read_attachment, read_chunk
from gear_dynamics_ros.recording.recover import Recovery, SampleRange, default_target, recover
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.checkpoint import Checkpoint, StoredCheckpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import Provenance
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import TOPICS, NodeNames, full_topic_name
from support.processes import run_python
from support.recordings import Recorded
from support.sinks import Keeper
from support.terminal import error_line

EPOCH_NS = 1_700_000_000_123_450_000
INTERVAL_NS = 10_000
CHANNELS = ("time", "dte", "mesh_force", "driving_x", "driving_speed")
PARAMETERS = Parameters.from_flat({"waveform_channels": CHANNELS})
ROWS = PARAMETERS.solver.samples_per_chunk
CHUNKS = 500  # one simulated second
SPLITS = (150, 300)
WAVEFORM = full_topic_name(TOPICS["waveform"])


def record(path: Path, chunks: int, splits: Sequence[int] = ()) -> Path:
    made = Recorded(path, PARAMETERS, EPOCH_NS)
    for number in range(chunks):
        if number in splits:
            made.sink.split()
        made.run.step(Commands(30.0, 25.0, 1600.0) if number == 1 else None)
    made.close()
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated second of the engine in three parts of many small chunks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_BYTES", 1 << 17)
        return record(tmp_path_factory.mktemp("recover") / "bag", CHUNKS, SPLITS)


@pytest.fixture(scope="module")
def samples(bag: Path) -> np.ndarray[Any, Any]:
    return recording.open(bag).waveform()


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """One file with a single chunk of a few messages."""
    return (record(tmp_path_factory.mktemp("small") / "bag", 2) / "bag_0.mcap").read_bytes()


class Filled(NamedTuple):
    """A chunk of an MCAP file as the mcap package sees it."""

    start: int  # byte
    end: int  # byte behind it
    first: int  # sample before it
    last: int  # sample behind it


def filled_chunks(path: Path) -> list[Filled]:
    found = []
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        waveform = next(number for number, each in summary.channels.items() if each.topic == WAVEFORM)
        (start,) = [each for each in make_reader(stream).iter_attachments() if each.name == "start.json"]
        reached = int(json.loads(start.data)["checkpoint"]["sample"])
        for index in summary.chunk_indexes:
            stream.seek(index.chunk_start_offset)
            chunk = next(iter(StreamReader(stream, skip_magic=True, emit_chunks=True).records))
            assert isinstance(chunk, Chunk)
            rows = sum(
                len(waveform_samples(deserialize(TOPICS["waveform"].type, message.data))[1])
                for message in breakup_chunk(chunk, validate_crc=True)
                if isinstance(message, Message) and message.channel_id == waveform
            )
            begin = index.chunk_start_offset
            found.append(Filled(begin, begin + index.chunk_length, reached, reached + rows))
            reached += rows
    return found


def state_of(path: Path) -> dict[str, tuple[str, int]]:
    """Content and time of change of every file."""
    files = [path] if path.is_file() else sorted(path.iterdir())
    return {
        file.name: (hashlib.sha256(file.read_bytes()).hexdigest(), file.stat().st_mtime_ns) for file in files
    }


def recovered(source: Path, target: Path) -> Recovery:
    """Recover, and see that the original stays as it was and nothing but the target appears."""
    before, beside = state_of(source), set(target.parent.iterdir())
    report = recover(source, target)
    assert state_of(source) == before
    assert set(target.parent.iterdir()) == beside | {target}
    return report


def rows_in(path: Path) -> list[tuple[int, np.ndarray[Any, Any]]]:
    """First sample and rows of each message of the waveform, read by the mcap package with all checksums."""
    found = []
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, _, message in make_reader(stream, validate_crcs=True).iter_messages(topics=[WAVEFORM]):
                rows = waveform_samples(deserialize(TOPICS["waveform"].type, message.data))[1]
                found.append(((message.log_time - EPOCH_NS) // INTERVAL_NS - len(rows) + 1, rows))
    return found


def check_files(path: Path) -> int:
    """Messages; in each file as many as metadata.yaml, its own metadata and its statistics tell."""
    information = told_by(path)
    assert information["relative_file_paths"] == sorted(file.name for file in path.glob("*.mcap"))
    for entry in information["files"]:
        with (path / entry["path"]).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            read = sum(1 for _ in reader.iter_messages())
            embedded = {each.name: each.metadata for each in reader.iter_metadata()}["rosbag2"]
        assert summary is not None and summary.statistics is not None
        assert read == entry["message_count"] == summary.statistics.message_count
        own = yaml.safe_load(embedded["serialized_metadata"])
        assert (own["relative_file_paths"], own["message_count"]) == ([entry["path"]], read)
    return int(information["message_count"])


def told_by(path: Path) -> dict[str, Any]:
    """Body of metadata.yaml."""
    return dict(yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"])


def check_topics(path: Path) -> int:
    """Messages; on each topic as many as metadata.yaml tells, as rosbags reads them."""
    information = told_by(path)
    told = {
        entry["topic_metadata"]["name"]: entry["message_count"]
        for entry in information["topics_with_message_count"]
    }
    with AnyReader([path]) as reader:
        heard = Counter(connection.topic for connection, _, _ in reader.messages())
        assert reader.message_count == information["message_count"]
    assert heard == Counter(told)
    return heard.total()


def cut(bag: Path, folder: Path, at: int) -> Path:
    """The recording as it is after a crash when ``at`` bytes had been written: no later part, no metadata."""
    folder.mkdir()
    for number in range(3):
        content = (bag / f"bag_{number}.mcap").read_bytes()
        (folder / f"bag_{number}.mcap").write_bytes(content[:at])
        if at <= len(content):
            return folder
        at -= len(content)
    raise AssertionError(f"{at} bytes behind the end")


def changed(bag: Path, folder: Path, number: int, content: bytes) -> Path:
    """The recording with another content of a part."""
    shutil.copytree(bag, folder)
    (folder / f"bag_{number}.mcap").write_bytes(content)
    return folder


def test_a_recording_cut_anywhere_recovers(bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path) -> None:
    sizes = [(bag / f"bag_{number}.mcap").stat().st_size for number in range(3)]
    chunks = [filled_chunks(bag / f"bag_{number}.mcap") for number in range(3)]
    assert min(map(len, chunks)) > 5
    generator = random.Random(11)
    for trial in range(200):
        at = generator.randrange(sum(sizes))
        source = cut(bag, tmp_path / "bag", at)
        number = len(list(source.iterdir())) - 1
        place = at - sum(sizes[:number])
        # to save time, mostly the part alone that was cut
        alone = trial % 10 > 0
        report = recovered(source / f"bag_{number}.mcap" if alone else source, tmp_path / "whole")
        first = chunks[number][0].first
        kept = max((each.last for each in chunks[number] if each.end <= place), default=first)
        begin = first if alone else 0
        assert (report.samples, report.gaps, report.size) == (kept - begin, (), place if alone else at)
        assert report.parts[-1].break_at <= place and report.metadata_whole == alone
        if kept > begin:
            opened = recording.open(tmp_path / "whole")
            assert opened.complete and opened.first_sample == begin
            assert opened.waveform().tobytes() == samples[begin:kept].tobytes()
        if trial % 10 == 0:
            assert check_files(tmp_path / "whole") == report.messages
        if trial % 20 == 0:
            assert check_topics(tmp_path / "whole") == report.messages
        shutil.rmtree(source)
        shutil.rmtree(tmp_path / "whole")


def test_what_is_whole_is_copied_and_nothing_is_lost(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = recovered(bag, tmp_path / "copy")
    assert report.whole and report.metadata_whole and all(part.finished for part in report.parts)
    assert report.messages == check_topics(bag) == check_files(tmp_path / "copy")
    assert report.span == (0, CHUNKS * ROWS)
    with Reader(tmp_path / "copy") as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == report.messages
    assert recording.open(tmp_path / "copy").waveform().tobytes() == samples.tobytes()
    assert recording.open(tmp_path / "copy").commands == recording.open(bag).commands
    assert replay_main(["verify", str(tmp_path / "copy")]) == 0
    assert replay_main(["recover", str(tmp_path / "copy"), "--output", str(tmp_path / "again")]) == 0
    assert "nothing was lost" in capsys.readouterr().out
    for first in (tmp_path / "copy").glob("*.mcap"):
        assert (tmp_path / "again" / first.name.replace("copy", "again")).stat().st_size == pytest.approx(
            first.stat().st_size, abs=64
        )


def test_parts_keep_their_numbers(bag: Path, tmp_path: Path) -> None:
    assert default_target(bag / "bag_1.mcap") == bag / "bag_1_recovered"
    recovered(bag / "bag_1.mcap", tmp_path / "second")
    assert [file.name for file in sorted((tmp_path / "second").iterdir())] == [
        "metadata.yaml",
        "second_1.mcap",
    ]
    opened = recording.open(tmp_path / "second")
    assert (opened.first_sample, opened.end_sample) == (SPLITS[0] * ROWS, SPLITS[1] * ROWS)
    (tmp_path / "unnumbered.mcap").write_bytes((bag / "bag_1.mcap").read_bytes())
    recovered(tmp_path / "unnumbered.mcap", tmp_path / "x")
    assert (tmp_path / "x" / "x_0.mcap").is_file()


@pytest.mark.parametrize("where", ["content", "first", "last", "length"])
def test_a_damaged_chunk_is_left_out_and_the_gap_is_told(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path, where: str
) -> None:
    chunks = filled_chunks(bag / "bag_1.mcap")
    damaged = {"first": chunks[0], "last": chunks[-1]}.get(where, chunks[4])
    content = bytearray((bag / "bag_1.mcap").read_bytes())
    content[damaged.start + 4 if where == "length" else (damaged.start + damaged.end) // 2] ^= 0x20
    report = recovered(changed(bag, tmp_path / "damaged", 1, content), tmp_path / "out")
    # where the length is wrong, nobody knows where the next record begins
    end = chunks[-1].last if where == "length" else damaged.last
    # the first may hold nothing but the channels
    assert report.gaps == ((SampleRange(damaged.first, end),) if end > damaged.first else ())
    part = report.parts[1]
    if where == "length":
        assert (part.break_at, part.damaged_chunks) == (damaged.start, 0)
    else:
        assert (part.ended, part.damaged_chunks, part.finished) == (True, 1, True)
    assert check_files(tmp_path / "out") == report.messages
    rows = np.concatenate([rows for _, rows in rows_in(tmp_path / "out")])
    assert rows.tobytes() == np.delete(samples, slice(damaged.first, end), axis=0).tobytes()
    opened = recording.open(tmp_path / "out")
    assert opened.waveform(end).tobytes() == samples[end:].tobytes()
    assert opened.waveform(0, damaged.first).tobytes() == samples[: damaged.first].tobytes()


def test_channels_lost_with_the_first_chunk_come_from_another_part(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path
) -> None:
    chunks = filled_chunks(bag / "bag_2.mcap")
    content = bytearray((bag / "bag_2.mcap").read_bytes()[: chunks[-1].end])
    content[chunks[0].end - 9] ^= 1
    report = recovered(changed(bag, tmp_path / "damaged", 2, content), tmp_path / "out")
    assert report.parts[2].damaged_chunks == 1
    assert report.samples == len(samples) - (chunks[0].last - chunks[0].first)
    assert check_files(tmp_path / "out") == report.messages


def test_times_in_the_head_of_a_chunk_are_set_right(bag: Path, tmp_path: Path) -> None:
    chunk = filled_chunks(bag / "bag_0.mcap")[3]
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[chunk.start + 9 : chunk.start + 25] = struct.pack("<QQ", 2**63, 5)
    (tmp_path / "times.mcap").write_bytes(content)
    report = recovered(tmp_path / "times.mcap", tmp_path / "out")
    assert report.whole
    found = recording.open(tmp_path / "out").parts[0].index
    times = [(index.message_start_time, index.message_end_time) for index in found.chunks]
    assert times == sorted(times) and times[-1][1] - EPOCH_NS <= SPLITS[0] * ROWS * INTERVAL_NS


TAILS = {
    "zeros": lambda size: bytes(size),
    "garbage": lambda size: random.Random(3).randbytes(size),
    "private records": lambda size: b"\x80" * size,
    "text": lambda size: (b"no recording " * size)[:size],
}


@pytest.mark.parametrize("size", [1, 9, 3_000_000])
@pytest.mark.parametrize("tail", TAILS)
def test_a_tail_that_is_no_record_is_counted(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path, tail: str, size: int
) -> None:
    chunk = filled_chunks(bag / "bag_0.mcap")[5]
    content = (bag / "bag_0.mcap").read_bytes()[: chunk.end] + TAILS[tail](size)
    (tmp_path / "tail.mcap").write_bytes(content)
    report = recovered(tmp_path / "tail.mcap", tmp_path / "out")
    (part,) = report.parts
    assert (part.size - part.break_at, part.break_at, part.ended) == (size, chunk.end, False)
    assert recording.open(tmp_path / "out").waveform().tobytes() == samples[: chunk.last].tobytes()
    # what reads the broken file itself sees the same
    assert recording.open(tmp_path / "tail.mcap").waveform().tobytes() == samples[: chunk.last].tobytes()


@pytest.mark.parametrize("opcode", [0x00, 0x06, 0x09, 0x0C, 0x80])
def test_what_a_length_claims_is_not_held_in_memory(bag: Path, tmp_path: Path, opcode: int) -> None:
    chunk = filled_chunks(bag / "bag_0.mcap")[5]
    path, size = tmp_path / "huge.mcap", 200 << 30
    head = struct.pack("<BQ", opcode, size - chunk.end - 9)
    path.write_bytes((bag / "bag_0.mcap").read_bytes()[: chunk.end] + head)
    os.truncate(path, size)  # the rest takes no room on the disk
    report = recover(path, tmp_path / "out")
    assert (report.size, report.span, report.parts[0].ended) == (size, (0, chunk.last), False)
    # a private record may be of any length
    assert report.parts[0].break_at == (size if opcode == 0x80 else chunk.end)
    assert recording.open(path).end_sample == chunk.last


def test_a_chunk_half_of_zeros_belongs_to_the_tail(bag: Path, tmp_path: Path) -> None:
    chunk = filled_chunks(bag / "bag_0.mcap")[5]
    content = (bag / "bag_0.mcap").read_bytes()[: (chunk.start + chunk.end) // 2]
    (tmp_path / "zeros.mcap").write_bytes(content + bytes(1_000_000))
    report = recovered(tmp_path / "zeros.mcap", tmp_path / "out")
    assert report.parts[0].break_at == chunk.start
    assert report.span == (0, chunk.first)


def test_only_the_index_at_the_end_is_damaged(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path
) -> None:
    whole = (bag / "bag_2.mcap").read_bytes()
    summary_at = int.from_bytes(whole[-28:-20], "little")
    for place, content in {
        "cut": whole[: summary_at + 100],
        "flipped": whole[:-200] + bytes([whole[-200] ^ 1]) + whole[-199:],
        "footer": whole[:-20] + bytes(20),
    }.items():
        source = changed(bag, tmp_path / place, 2, content)
        report = recovered(source, tmp_path / f"{place}_out")
        assert report.whole and (report.parts[2].ended, report.parts[2].finished) == (True, False)
        assert not recording.open(source).complete
        assert recording.open(source).waveform().tobytes() == samples.tobytes()
        assert recording.open(tmp_path / f"{place}_out").waveform().tobytes() == samples.tobytes()


def test_a_summary_that_lies_is_noticed(bag: Path, tmp_path: Path) -> None:
    with (bag / "bag_0.mcap").open("rb") as stream:
        found = read_index(stream)
    data = (bag / "bag_0.mcap").read_bytes()
    found.end = int.from_bytes(data[-28:-20], "little") - 13
    assert data[: found.end] + ending(found) == data
    path = tmp_path / "lies.mcap"
    for offset, complete in ((2**63, False), (len(data), False), (0, False), (found.end - 5000, True)):
        index = found.chunks[2]
        chunks = [
            replace(each, chunk_start_offset=offset) if each is index else each for each in found.chunks
        ]
        lying = replace(found, chunks=[replace(each, chunk_length=100) for each in chunks])
        path.write_bytes(data[: found.end] + ending(lying))
        with path.open("rb") as stream:
            seen = read_index(stream)
            assert seen.complete == complete
            if complete:
                with pytest.raises(GearboxError, match="damaged"):
                    [read_chunk(stream, each) for each in seen.chunks]
        report = recovered(path, tmp_path / "out")
        assert report.whole and report.span == (0, SPLITS[0] * ROWS)
        shutil.rmtree(tmp_path / "out")


def test_an_attachment_is_read_by_itself_and_checked(bag: Path, tmp_path: Path) -> None:
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[content.index(b"backlash")] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    with path.open("rb") as stream:
        parameters, start, *_ = read_index(stream).attachments
        assert json.loads(read_attachment(stream, start))["checkpoint"]["sample"] == 0
        with pytest.raises(GearboxError, match="checksum"):
            read_attachment(stream, parameters)
    report = recovered(path, tmp_path / "out")
    assert (report.parts[0].damaged_attachments, report.whole) == (1, False)
    with (tmp_path / "out" / "out_0.mcap").open("rb") as stream:
        assert [entry.name for entry in read_index(stream).attachments] == ["start.json", "end.json"]
    with pytest.raises(GearboxError, match=r"parameters\.yaml"):
        recording.open(tmp_path / "out")


def test_the_report_tells_what_was_kept_and_lost(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged, broken = filled_chunks(bag / "bag_1.mcap")[4], filled_chunks(bag / "bag_2.mcap")[5]
    content = bytearray((bag / "bag_1.mcap").read_bytes())
    content[damaged.end - 9] ^= 1
    source = changed(bag, tmp_path / "source", 1, content)
    (source / "bag_2.mcap").write_bytes((bag / "bag_2.mcap").read_bytes()[: broken.end - 1])
    (source / "metadata.yaml").unlink()
    assert replay_main(["recover", str(source)]) == 0
    told = capsys.readouterr().out.splitlines()
    target = tmp_path / "source_recovered"
    missing, tail = damaged.last - damaged.first, broken.end - broken.start - 1
    size = sum(file.stat().st_size for file in source.iterdir())
    counts = [part.index.counts for part in recording.open(target).parts]
    kept = f"{broken.first - missing} samples, 0 to {broken.first - 1} (0.000000 s to "
    assert told[0] == f"{source}: recovered to {target}"
    assert told[1].endswith("bytes  whole")
    assert told[3].endswith("complete; left out as damaged: 1 chunk")
    assert told[5].endswith(
        f"breaks off at byte {broken.start}: the {tail} bytes behind it hold no whole record"
    )
    assert told[6].startswith(f"    kept {sum(counts[2].values())} messages, ")
    assert told[7].startswith(
        f"missing in between: {missing} samples, {damaged.first} to {damaged.last - 1} "
    )
    assert told[8] == "metadata.yaml was missing or damaged: written again"
    assert told[9].startswith(
        f"read {size} bytes, kept {sum(sum(each.values()) for each in counts)} messages, {kept}"
    )
    assert told[10] == f"lost: {tail} bytes without a whole record, 1 chunk, {missing} samples in between"


@pytest.mark.parametrize("size", [0, 5, 200])
def test_a_last_part_without_its_start_is_left_out(
    bag: Path, samples: np.ndarray[Any, Any], tmp_path: Path, size: int
) -> None:
    source = changed(bag, tmp_path / "source", 2, (bag / "bag_2.mcap").read_bytes()[:size])
    with pytest.raises(
        GearboxError, match=r"lists bag_2\.mcap \(0\.600000 s to 0\.999990 s\), which has lost its start"
    ):
        verify_recording(recording.open(source))
    report = recovered(source, tmp_path / "out")
    assert dict(report.left_out) == {"bag_2.mcap": "broke off before its start"}
    assert len(report.parts) == 2 and not report.whole
    assert check_files(tmp_path / "out") == check_topics(tmp_path / "out") == report.messages
    opened = recording.open(tmp_path / "out").waveform()
    assert opened.tobytes() == samples[: SPLITS[1] * ROWS].tobytes()


@pytest.mark.parametrize("size", [0, 3000, 12_000])
def test_a_file_cut_before_its_first_message(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], size: int
) -> None:
    (tmp_path / "bag_0.mcap").write_bytes((bag / "bag_0.mcap").read_bytes()[:size])
    assert replay_main(["recover", str(tmp_path / "bag_0.mcap")]) == 0
    assert "nothing had been flushed yet" in capsys.readouterr().out
    assert check_files(tmp_path / "bag_0_recovered") == check_topics(tmp_path / "bag_0_recovered") == 0
    if size > 10_000:
        assert recording.open(tmp_path / "bag_0_recovered").parameters == PARAMETERS


def test_a_recording_of_another_program_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="another program")
        writer.finish()
    assert replay_main(["recover", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "was not recorded by this package: 'another program' wrote it" in line
    assert [each.name for each in tmp_path.iterdir()] == ["other.mcap"]


def test_a_file_that_is_no_mcap_is_left_out_or_refused(bag: Path, tmp_path: Path) -> None:
    source = changed(bag, tmp_path / "source", 2, bytes(5_000_000))
    report = recovered(source, tmp_path / "out")
    assert (dict(report.left_out), len(report.parts), report.whole) == (
        {"bag_2.mcap": "not an MCAP file"},
        2,
        False,
    )
    with pytest.raises(GearboxError, match=r"bag_2\.mcap' is not an MCAP file"):
        recover(source / "bag_2.mcap", tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_a_recording_of_others_is_refused(tmp_path: Path) -> None:
    schema = Schema(data=b"int8 x", encoding="ros2msg", id=1, name="other_msgs/msg/X")
    channel = Channel(id=1, topic="/x", message_encoding="cdr", metadata={}, schema_id=1)
    message = Message(channel_id=1, log_time=1, data=b"1234", publish_time=1, sequence=0)
    path = tmp_path / "other.mcap"
    path.write_bytes(MCAP0_MAGIC + encode((Header("ros2", ""), chunk_of(encode((schema, channel, message))))))
    with pytest.raises(GearboxError, match="was not recorded by this package"):
        recover(path, tmp_path / "out")


def test_places_that_cannot_be_meant(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(bag)
    (tmp_path / "empty").mkdir()
    for source, target, told in (
        (bag, tmp_path / "there", "exists already"),
        (bag, bag / "inside", "inside the recording"),
        (bag, tmp_path / "link" / "inside", "inside the recording"),
        (tmp_path / "link", bag / "inside", "inside the recording"),
        (bag, tmp_path / "missing" / "out", "does not exist"),
        (tmp_path / "empty", tmp_path / "out", r"holds no .mcap file"),
        (tmp_path / "nowhere", tmp_path / "out", "no recording at"),
    ):
        before = state_of(bag)
        assert replay_main(["recover", str(source), "--output", str(target)]) == 2
        assert told in error_line(capsys)
        assert state_of(bag) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "link", "there"]


def test_a_recording_that_may_only_be_read(bag: Path, tmp_path: Path) -> None:
    source = tmp_path / "locked" / "bag"
    shutil.copytree(bag, source)
    for path in (*source.iterdir(), source):
        path.chmod(0o444 if path.is_file() else 0o555)
    try:
        assert recovered(source, tmp_path / "out").whole
    finally:
        source.chmod(0o755)


def limited(*words: str, size: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gear_dynamics_ros.cli.replay", *words],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_full_disk_leaves_nothing_behind(bag: Path, tmp_path: Path) -> None:
    done = limited("recover", str(bag), "--output", str(tmp_path / "out"), size=1_000_000)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "File too large: free space" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_recovery_leaves_nothing_that_passes_for_complete(bag: Path, tmp_path: Path) -> None:
    def interrupt(share: float) -> None:
        if share > 0.9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recover(bag, tmp_path / "out", interrupt)
    assert list(tmp_path.iterdir()) == []
    code = (
        "import os, signal, sys; from pathlib import Path;"
        "from gear_dynamics_ros.recording.recover import recover;"
        "kill = lambda share: share > 0.9 and os.kill(os.getpid(), signal.SIGKILL);"
        "recover(Path(sys.argv[1]), Path(sys.argv[2]), kill)"
    )
    done = subprocess.run([sys.executable, "-c", code, bag, tmp_path / "out"], timeout=120)
    assert done.returncode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == ["out.part"]
    assert not (tmp_path / "out.part" / "metadata.yaml").exists()
    with pytest.raises(UsageError, match=r"out\.part' exists already: .* left it when it was killed"):
        recover(bag, tmp_path / "out")


FORK_AND_KILL = """
# Let 20 processes record and kill each at a random moment; print what each had on the disk.
import json, os, random, signal, struct, sys, time
from pathlib import Path
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from support.recordings import Recorded
epoch_ns, channels = int(sys.argv[2]), sys.argv[3].split(",")
parameters = Parameters.from_flat({"waveform_channels": channels})
Engine(parameters).advance(200)  # compiles; no thread may run when processes are forked
generator = random.Random(5)

def record_until_killed(path, pipe):
    made = Recorded(path, parameters, epoch_ns)
    os.write(pipe, struct.pack("<q", 0))
    for _ in range(1000):
        made.steps(1)
        os.write(pipe, struct.pack("<q", made.recorder.stats.flushed))
        time.sleep(0.002)

for number in range(20):
    path = Path(sys.argv[1]) / f"bag{number}"
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        record_until_killed(path, writing)
        os._exit(1)
    os.read(reading, 8)  # the recording has begun
    time.sleep(generator.uniform(0.0, 1.3))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    os.close(writing)
    with open(reading, "rb") as stream:
        told = stream.read()
    counts = struct.unpack(f"<{len(told) // 8}q", told)
    print(json.dumps([str(path), os.waitstatus_to_exitcode(status), max(counts, default=0)]), flush=True)
"""


def test_killed_at_random_moments_nothing_that_was_on_the_disk_is_missing(tmp_path: Path) -> None:
    done = run_python(FORK_AND_KILL, tmp_path, EPOCH_NS, ",".join(CHANNELS), timeout=300.0)
    assert done.returncode == 0, done.stderr
    collector = Keeper()
    run = Run(Engine(PARAMETERS), Encoder(PARAMETERS, EPOCH_NS), [collector])
    for _ in range(1000):
        run.step()
    expected = [(full_topic_name(TOPICS[each.topic]), each.time_ns, each.data) for each in collector.records]
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(told) == 20 and sum(count > 0 for _, _, count in told) > 5
    for name, code, count in told:
        assert code == -signal.SIGKILL
        report = recovered(Path(name), tmp_path / "out")
        with (tmp_path / "out" / "out_0.mcap").open("rb") as stream:
            messages = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(
                    log_time_order=False
                )
            ]
        assert len(messages) == report.messages >= count
        assert messages == expected[: len(messages)]
        shutil.rmtree(tmp_path / "out")


def chunk_of(data: bytes, checksum: int | None = None) -> Chunk:
    return Chunk(
        compression="",
        data=data,
        message_end_time=0,
        message_start_time=0,
        uncompressed_crc=zlib.crc32(data) if checksum is None else checksum,
        uncompressed_size=len(data),
    )


def read_all(path: Path) -> None:
    """Everything that a survey leads to."""
    with path.open("rb") as stream:
        found = read_index(stream)
        with suppress(GearboxError):
            read_metadata(stream, found)
        for attachment in found.attachments:
            with suppress(GearboxError):
                read_attachment(stream, attachment)
        for index in found.chunks:
            try:
                assert len(read_chunk(stream, index).data) == index.uncompressed_size
            except GearboxError:
                continue


def recovers_or_refuses(content: bytes) -> None:
    """Reading and recovery raise nothing but GearboxError, and what is recovered is valid."""
    with tempfile.TemporaryDirectory() as folder:
        path, target = Path(folder) / "any_0.mcap", Path(folder) / "out"
        path.write_bytes(content)
        with suppress(GearboxError):
            read_all(path)
        try:
            report = recover(path, target)
        except GearboxError:
            assert os.listdir(folder) == ["any_0.mcap"]
            return
        with (target / "out_0.mcap").open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert sum(1 for _ in reader.iter_messages()) == report.messages


CHANGES = st.lists(
    st.tuples(
        st.floats(0.0, 1.0),
        st.sampled_from(["set", "cut out", "put in", "swap", "end"]),
        st.one_of(st.binary(min_size=1, max_size=12), st.sampled_from([b"\0" * 40, b"\xff" * 8])),
    ),
    min_size=1,
    max_size=4,
)


@given(changes=CHANGES)
@settings(max_examples=80)
def test_any_change_of_a_file_recovers_or_is_refused(small: bytes, changes: list[Any]) -> None:
    content = small
    for share, change, data in changes:
        at = int(share * len(content))
        if change == "set":
            content = content[:at] + data + content[at + len(data) :]
        elif change == "cut out":
            content = content[:at] + content[at + 50 * len(data) :]
        elif change == "put in":
            content = content[:at] + data + content[at:]
        elif change == "swap":
            content = content[:8] + content[at:] + content[8:at]
        else:
            content = content[:at]
    recovers_or_refuses(content)


TEXT = st.text(max_size=8)
NUMBER = st.sampled_from([1, 1, 1, 1, 0, 2, 2**16 - 1])
TIME = st.one_of(st.just(EPOCH_NS + 50_000), st.integers(0, 2**64 - 1))
ROW = serialize(TOPICS["waveform"].type, waveform_message(CHANNELS, np.ones((2, len(CHANNELS)))))
ORIGIN = Provenance(*"000000")
THIRD = Checkpoint(3, Status.RUNNING, Commands(30.0, 30.0, 1600.0), {"u": 0.0}, PARAMETERS)
STATE = StoredCheckpoint(THIRD, ORIGIN).to_text().encode()
START = Attachment(create_time=0, log_time=0, name="start.json", media_type="", data=STATE)
RUN = Metadata(
    name="gear_dynamics_ros", metadata=RunMetadata(ORIGIN, EPOCH_NS, NodeNames(), INTERVAL_NS).to_text()
)
SCHEMA = Schema(data=b"", encoding="ros2msg", id=1, name=TOPICS["waveform"].type)
CHANNEL = Channel(id=1, topic=WAVEFORM, message_encoding="cdr", metadata={}, schema_id=1)
MESSAGE = Message(channel_id=1, log_time=EPOCH_NS + 50_000, data=ROW, publish_time=0, sequence=0)
SOUND = encode((RUN, START, chunk_of(encode((SCHEMA, CHANNEL, MESSAGE, MESSAGE)))))
RECORDS = st.one_of(
    st.sampled_from([SCHEMA, CHANNEL, START, RUN, DataEnd(0)]),
    st.builds(
        Schema,
        id=NUMBER,
        data=st.just(b""),
        encoding=TEXT,
        name=st.one_of(st.just("std_msgs/msg/Float64"), TEXT),
    ),
    st.builds(
        Channel,
        id=NUMBER,
        topic=st.one_of(st.just(WAVEFORM), TEXT),
        message_encoding=st.sampled_from(["cdr", "json"]),
        metadata=st.dictionaries(TEXT, TEXT, max_size=1),
        schema_id=NUMBER,
    ),
    st.builds(
        Attachment,
        create_time=TIME,
        log_time=TIME,
        name=st.one_of(st.sampled_from(["start.json", "parameters.yaml"]), TEXT),
        media_type=TEXT,
        data=st.sampled_from(
            [
                *(STATE.replace(b'"sample": 3', b'"sample": ' + value) for value in (b"1e999", b'"5"')),
                *(b"[" * 5000, b'{"sample": 3}', b"[]", b"\xff", b""),
            ]
        ),
    ),
    st.builds(
        Metadata,
        name=st.sampled_from(["gear_dynamics_ros", "rosbag2", "x"]),
        metadata=st.fixed_dictionaries(
            dict.fromkeys(("version", "kernel_hash", "node"), TEXT)
            | dict.fromkeys(("epoch_ns", "sample_interval_ns"), st.sampled_from(["0", "-3", "10000", "x"]))
        ),
    ),
)
MESSAGES = st.builds(
    Message,
    channel_id=NUMBER,
    log_time=TIME,
    data=st.one_of(st.just(ROW), st.integers(0, len(ROW)).map(lambda end: ROW[:end]), st.binary(max_size=30)),
    publish_time=TIME,
    sequence=NUMBER,
)
PIECES = st.one_of(
    RECORDS.map(lambda each: encode((each,))),
    st.tuples(RECORDS, st.integers(9, 60), st.integers(1, 255)).map(lambda each: flipped(*each)),
    st.builds(
        lambda opcode, length, body: struct.pack("<BQ", opcode, length or len(body)) + body,
        st.one_of(st.sampled_from(Opcode), st.integers(0, 255)),
        st.sampled_from([0, 0, 5, 2**40, 2**64 - 1]),
        st.binary(max_size=30),
    ),
    st.binary(max_size=20),
)
CHUNKS_OF_ANYTHING = st.builds(
    lambda head, records, more, checksum: encode((chunk_of(head + encode(records) + more, checksum),)),
    st.sampled_from([encode((SCHEMA, CHANNEL)), b""]),
    st.lists(st.one_of(MESSAGES, MESSAGES, RECORDS), max_size=5),
    st.one_of(st.just(b""), st.just(b""), PIECES),
    st.sampled_from([None, None, 0, 1]),
)


def flipped(record: Any, at: int, mask: int) -> bytes:
    content = bytearray(encode((record,)))
    content[min(at, len(content) - 1)] ^= mask
    return bytes(content)


BOMB = chunk_of(b"(\xb5/\xfd\xa4" + b"\xff" * 8 + b"0" * 20)
BOMB = replace(BOMB, compression="zstd", uncompressed_size=2**62)


@given(pieces=st.lists(st.one_of(st.just(SOUND), PIECES, CHUNKS_OF_ANYTHING), max_size=8))
@example([encode((BOMB,))])
@example([encode((replace(BOMB, compression="brotli"),))])
@settings(max_examples=80)
def test_any_file_recovers_or_is_refused(pieces: list[bytes]) -> None:
    recovers_or_refuses(MCAP0_MAGIC + b"".join(pieces))
