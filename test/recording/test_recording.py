"""Recordings: read back by readers of others, after a split, a crash, a full disk."""

from __future__ import annotations

import json
import os
import random
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from gear_dynamics_ros import __version__, recording
from gear_dynamics_ros.channels import CHANNEL_NAMES, IMPACTS
from gear_dynamics_ros.chunk import (
    Chunk,
    Commands,
    Status,
)
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording import recorder as recorder_module
from gear_dynamics_ros.recording.mcap import writer
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.provenance import current_provenance
from gear_dynamics_ros.topics import TOPICS, NodeNames, full_topic_name
from support.chunks import COMMANDS, NO_COUNTERS, chunk_of, noise
from support.every_topic import EPOCH_NS, extra_records
from support.processes import python_command, python_path

ROWS = 200
SECOND = Commands(31.5, 20.0, 1000.0)
WAVEFORM = "/gearbox/waveform"
MESSAGES = 10  # that a chunk makes


def make_chunk(number: int) -> Chunk:
    """Chunk of incompressible samples that depend on its number alone."""
    return chunk_of(number * ROWS, noise(number, ROWS), impacts=np.zeros((1, len(IMPACTS))))


def samples_of(numbers: range) -> np.ndarray[Any, Any]:
    return np.concatenate([make_chunk(number).samples for number in numbers])


def start_at(sample: int, parameters: Parameters | None = None) -> Checkpoint:
    state = {"numbers": [0.1, -1e-300, 3.0000000000000004]}
    return Checkpoint(sample, Status.RUNNING, COMMANDS, state, parameters or Parameters())


def equal(left: np.ndarray[Any, Any], right: np.ndarray[Any, Any]) -> bool:
    return left.shape == right.shape and left.tobytes() == right.tobytes()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of 60 chunks in two parts, split after 40, with a command, events and all topics."""
    path = tmp_path_factory.mktemp("recording") / "bag"
    parameters = Parameters()
    encoder = Encoder(parameters, EPOCH_NS)
    recorder = Recorder(path, start_at(0, parameters), EPOCH_NS)
    recorder.write([encoder.applied(COMMANDS, 0), *extra_records(encoder)])
    for number in range(60):
        if number == 20:
            halted = [encoder.event(kind, 20 * ROWS, "", NO_COUNTERS) for kind in ("pause", "resume")]
            recorder.write(halted)
            recorder.write([encoder.applied(SECOND, 20 * ROWS)])
        if number == 40:
            recorder.split(start_at(40 * ROWS, parameters))
        recorder.write(encoder.chunk(make_chunk(number)))
    recorder.write([encoder.event("end", 60 * ROWS, "as asked", NO_COUNTERS)])
    recorder.close()
    assert recorder.error is None
    assert recorder.stats.bytes == sum(part.stat().st_size for part in path.glob("*.mcap"))
    return path


def test_reads_back_bit_for_bit(bag: Path) -> None:
    read = recording.open(bag)
    assert read.complete
    assert (read.first_sample, read.end_sample) == (0, 60 * ROWS)
    assert read.duration_ns == 60 * ROWS * 10_000
    assert equal(read.waveform(), samples_of(range(60)))
    assert read.channel_names == CHANNEL_NAMES


def test_keeps_what_is_needed_to_run_it_again(bag: Path) -> None:
    read = recording.open(bag)
    assert read.parameters == Parameters()
    assert read.start == start_at(0)
    assert read.version == __version__
    assert read.run.provenance == current_provenance()
    assert read.kernel_hash == current_provenance().kernel_hash
    assert (read.epoch_ns, read.sample_interval_ns, read.node) == (EPOCH_NS, 10_000, "/gearbox")


def test_commands_and_events_come_once_though_each_part_repeats_them(bag: Path) -> None:
    read = recording.open(bag)
    assert read.commands == [(0, COMMANDS), (20 * ROWS, SECOND)]
    assert [(event.sample, event.kind) for event in read.events] == [
        (20 * ROWS, "pause"),
        (20 * ROWS, "resume"),
        (60 * ROWS, "end"),
    ]
    assert read.events[-1].message == "as asked"
    assert read.events[-1].time == 0.12


@pytest.mark.parametrize(
    ("first", "last"), [(0, 1), (199, 201), (7_950, 8_050), (11_999, 12_000), (500, 500)]
)
def test_window_of_samples(bag: Path, first: int, last: int) -> None:
    assert equal(recording.open(bag).waveform(first, last), samples_of(range(60))[first:last])


def test_chunks_come_in_order_and_one_at_a_time(bag: Path) -> None:
    chunks = list(recording.open(bag).chunks())
    assert [first for first, _ in chunks] == [number * ROWS for number in range(60)]
    assert all(equal(samples, make_chunk(number).samples) for number, (_, samples) in enumerate(chunks))


def test_parts_are_complete_in_themselves(bag: Path) -> None:
    second = recording.open(bag / "bag_1.mcap")
    assert second.complete
    assert second.start == start_at(40 * ROWS)
    assert second.parameters == Parameters()
    assert second.commands == [(20 * ROWS, SECOND)]
    assert [event.kind for event in second.events] == ["resume", "end"]
    assert equal(second.waveform(), samples_of(range(40, 60)))
    with (bag / "bag_1.mcap").open("rb") as stream:
        order = [channel.topic for _, channel, _ in make_reader(stream).iter_messages(log_time_order=False)]
    assert order[:3] == ["/gearbox/command/applied", "/gearbox/model_info", "/gearbox/event"]


def test_rosbags_reads_the_same(bag: Path) -> None:
    rows = []
    counts: dict[str, int] = defaultdict(int)
    with AnyReader([bag]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == WAVEFORM:
                rows.append(message.data.reshape(-1, message.layout.dim[1].size))
                assert time_ns == EPOCH_NS + (len(rows) * ROWS - 1) * 10_000
                assert message.layout.dim[0].label == "sample"
                assert message.layout.dim[1].label == ",".join(CHANNEL_NAMES)
    assert equal(np.concatenate(rows), samples_of(range(60)))
    assert counts == {topic.name: topic.messages for topic in recording.open(bag).topics}
    assert all(counts.values())


def test_mcap_reader_decodes_each_message_by_the_schema_in_the_file(bag: Path) -> None:
    rows = []
    sequences: dict[str, list[int]] = defaultdict(list)
    for part in ("bag_0.mcap", "bag_1.mcap"):
        with (bag / part).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            assert reader.get_header().profile == "ros2"
            states = {"start.json", "end.json"} if part == "bag_0.mcap" else {"start.json"}
            assert {record.name for record in reader.iter_attachments()} == {"parameters.yaml", *states}
            for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
                sequences[channel.topic].append(message.sequence)
                if channel.topic == WAVEFORM:
                    rows.append(np.array(content.data).reshape(-1, content.layout.dim[1].size))
    assert equal(np.concatenate(rows), samples_of(range(60)))
    assert set(sequences) == {full_topic_name(topic) for topic in TOPICS.values()}
    assert all(numbers == list(range(len(numbers))) for numbers in sequences.values())


def test_metadata_is_version_9_with_qos_and_hashes(bag: Path) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap"]
    assert information["message_count"] == sum(entry["message_count"] for entry in information["files"])
    assert "&" not in (bag / "metadata.yaml").read_text()
    with Reader(bag) as reader:
        assert reader.message_count == information["message_count"]
        assert reader.duration == 60 * ROWS * 10_000 + 1
        topics = {connection.topic: connection for connection in reader.connections}
    (waveform,) = topics[WAVEFORM].ext.offered_qos_profiles
    assert (waveform.reliability, waveform.durability) == (QosReliability.RELIABLE, QosDurability.VOLATILE)
    (applied,) = topics["/gearbox/command/applied"].ext.offered_qos_profiles
    assert applied.durability == QosDurability.TRANSIENT_LOCAL
    assert all(connection.digest.startswith("RIHS01_") for connection in topics.values())


def test_each_file_holds_a_copy_of_its_metadata(bag: Path) -> None:
    for name in ("bag_0.mcap", "bag_1.mcap"):
        with (bag / name).open("rb") as stream:
            reader = make_reader(stream)
            records = {record.name: record.metadata for record in reader.iter_metadata()}
            summary = reader.get_summary()
        embedded = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
        assert embedded["relative_file_paths"] == [name]
        assert summary is not None and summary.statistics is not None
        assert embedded["message_count"] == summary.statistics.message_count


def test_records_a_choice_of_channels(tmp_path: Path) -> None:
    parameters = Parameters.from_flat({"waveform_channels": ("time", "dte")})
    recorder = Recorder(tmp_path / "few", start_at(0, parameters), EPOCH_NS, names=NodeNames("/cell/box"))
    recorder.write(Encoder(parameters, EPOCH_NS).chunk(make_chunk(0)))
    recorder.close()
    read = recording.open(tmp_path / "few")
    assert read.channel_names == ("time", "dte")
    assert equal(read.waveform(), np.ascontiguousarray(make_chunk(0).samples[:, :2]))
    assert "/cell/joint_states" in {topic.name for topic in read.topics}


def test_an_empty_recording_is_complete(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "none", start_at(5), EPOCH_NS)
    recorder.close()
    recorder.close()
    read = recording.open(tmp_path / "none")
    assert read.complete
    assert (read.first_sample, read.end_sample) == (5, 5)
    assert read.waveform().shape == (0, len(CHANNEL_NAMES))
    with Reader(tmp_path / "none") as reader:
        assert reader.message_count == 0


@pytest.mark.parametrize("kind", ["folder", "file", "broken link"])
def test_never_overwrites(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "there"
    if kind == "folder":
        path.mkdir()
    elif kind == "file":
        path.write_text("mine")
    else:
        path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="exists already"):
        Recorder(path, start_at(0), EPOCH_NS)
    assert os.path.lexists(path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist: make it"):
        Recorder(tmp_path / "missing" / "bag", start_at(0), EPOCH_NS)
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="Not a directory"):
        Recorder(tmp_path / "file" / "bag", start_at(0), EPOCH_NS)


@pytest.mark.parametrize("content", [None, b"", b"not a recording at all"])
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(GearboxError, match=r"x\.mcap"):
        recording.open(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match=r"no \.mcap file"):
        recording.open(tmp_path / "empty")


def test_queue_is_bounded_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "QUEUE_BYTES", 100_000)
    encoder = Encoder(Parameters(), EPOCH_NS)
    recorder = Recorder(tmp_path / "bag", start_at(0), EPOCH_NS)
    for number in range(100):
        records = encoder.chunk(make_chunk(number))
        recorder.write(records)
        assert recorder.stats.queued_bytes < 100_000 + sum(len(record.data) for record in records)
    recorder.close()
    assert recorder.stats.lost == recorder.stats.queued == 0
    assert recorder.stats.messages == 100 * MESSAGES
    assert recorder.stats.bytes == (tmp_path / "bag" / "bag_0.mcap").stat().st_size
    assert equal(recording.open(tmp_path / "bag").waveform(), samples_of(range(100)))


def test_messages_after_the_end_are_counted_as_lost(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "bag", start_at(0), EPOCH_NS)
    recorder.close()
    before = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    recorder.write(Encoder(Parameters(), EPOCH_NS).chunk(make_chunk(0)))
    assert recorder.stats.lost == MESSAGES
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == before


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((0, 1, 3), r"the samples 400 to 599 \(0.004000 s to 0.005990 s\) are missing"),
        ((0, 1, 1), "sample 400 should follow, but sample 200 does"),
    ],
)
def test_a_gap_or_a_doubled_chunk_is_noticed(tmp_path: Path, numbers: tuple[int, ...], told: str) -> None:
    recorder = Recorder(tmp_path / "bag", start_at(0), EPOCH_NS)
    for number in numbers:
        recorder.write(Encoder(Parameters(), EPOCH_NS).chunk(make_chunk(number)))
    recorder.close()
    with pytest.raises(GearboxError, match=told):
        recording.open(tmp_path / "bag").waveform()


def test_a_file_cut_anywhere_reads_up_to_the_cut(bag: Path, tmp_path: Path) -> None:
    whole = (bag / "bag_0.mcap").read_bytes()
    expected = samples_of(range(40))
    kept = []
    generator = random.Random(7)
    for length in sorted(generator.sample(range(8_000, len(whole)), 25)):
        path = tmp_path / f"{length}.mcap"
        path.write_bytes(whole[:length])
        read = recording.open(path)
        rows = read.waveform()
        assert not read.complete
        assert equal(rows, expected[: len(rows)])
        # no more than the chunk that was cut is gone
        kept.append(len(rows))
        assert len(rows) * 8 * len(CHANNEL_NAMES) > length - 2 * writer.CHUNK_BYTES
        path.unlink()
    assert kept == sorted(kept) and kept[-1] > 0


RUN = """
import json, resource, sys, time
from pathlib import Path
import numpy as np
from gear_dynamics_ros.channels import IMPACTS
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.engine import Engine
from support.chunks import chunk_of, noise
def make_chunk(number):
    return chunk_of(number * 200, noise(number, 200), impacts=np.zeros((1, len(IMPACTS))))
encoder = Encoder(Parameters(), 0)
recorder = Recorder(Path(sys.argv[1]), Engine(Parameters()).checkpoint(), 0)
"""

UNTIL_KILLED = (
    RUN
    + """
# Too few messages to fill a chunk of the file, and then none for ever.
for number in range(5):
    recorder.write(encoder.chunk(make_chunk(number)))
while recorder.stats.flushed < recorder.stats.messages or recorder.stats.queued:
    time.sleep(0.01)
print("flushed", flush=True)
for number in range(5, 10):
    recorder.write(encoder.chunk(make_chunk(number)))
time.sleep(600.0)
"""
)

UNTIL_FULL = (
    RUN
    + """
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
for number in range(10_000):
    recorder.write(encoder.chunk(make_chunk(number)))
    if recorder.error:
        break
recorder.write(encoder.chunk(make_chunk(number + 1)))
recorder.close()
print(json.dumps([number, recorder.error, recorder.stats.lost]))
"""
)


def child(code: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        python_command(code, *arguments),
        env=os.environ | {"PYTHONPATH": python_path()},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_kill_9_loses_nothing_that_was_flushed_and_flushes_come_by_themselves(tmp_path: Path) -> None:
    assert recorder_module.FLUSH_SECONDS <= 1.0  # the promise: at most the last second is lost
    with child(UNTIL_KILLED, tmp_path / "bag") as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "flushed\n"
        finally:
            process.kill()
    read = recording.open(tmp_path / "bag")
    rows = read.waveform()
    assert not read.complete
    assert len(rows) >= 5 * ROWS
    assert equal(rows, samples_of(range(len(rows) // ROWS)))
    assert sum(topic.messages for topic in read.topics) == MESSAGES * len(rows) // ROWS


def test_full_disk_stops_the_recorder_and_keeps_what_was_written(tmp_path: Path) -> None:
    limit = 3_500_000
    process = child(UNTIL_FULL, str(tmp_path / "bag"), str(limit))
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    handed, error, lost = json.loads(output)
    assert "File too large" in error and str(tmp_path / "bag") in error
    assert lost >= MESSAGES
    read = recording.open(tmp_path / "bag")
    rows = read.waveform()
    assert rows.nbytes > 2_000_000
    assert len(rows) <= (handed + 1) * ROWS
    assert equal(rows, samples_of(range(len(rows) // ROWS)))
    assert read.complete
    with Reader(tmp_path / "bag") as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == MESSAGES * len(rows) // ROWS


def test_a_crash_right_after_a_split_keeps_the_parts_before(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap").write_bytes((bag / "bag_0.mcap").read_bytes())
    (tmp_path / "bag_1.mcap").write_bytes((bag / "bag_1.mcap").read_bytes()[:50])
    read = recording.open(tmp_path)
    assert not read.complete
    assert equal(read.waveform(), samples_of(range(40)))


def test_a_damaged_chunk_is_noticed(bag: Path, tmp_path: Path) -> None:
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[len(content) // 3] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(content)
    with pytest.raises(GearboxError, match="damaged"):
        recording.open(tmp_path / "damaged.mcap").waveform()
