"""Programs of others read every message of a recording as it was written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
from ament_index_python import get_package_share_path
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.topics import TOPICS, full_topic_name
from support.every_topic import Made, full_name, leaves, record_everything, sequences
from support.rerun_files import Rerun


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    made = record_everything(tmp_path_factory.mktemp("clients") / "bag")
    assert {record.topic for record in made.records} == set(TOPICS)
    assert {file.name for file in made.files} == {file.name for file in made.path.glob("*.mcap")}
    return made


def exact(record: Record) -> list[tuple[str, bytes]]:
    return list(leaves(deserialize(TOPICS[record.topic].type, record.data)))


@pytest.mark.parametrize("where", ["folder", "first file", "second file"])
def test_rosbags_reads_every_message(made: Made, where: str) -> None:
    places = {"folder": made.path, "first file": made.files[0], "second file": made.files[1]}
    written = {"folder": made.records, "first file": made.parts[0], "second file": made.parts[1]}[where]
    expected: dict[str, list[Any]] = defaultdict(list)
    for record in written:
        expected[full_name(record)].append((record.time_ns, record.data, exact(record)))
    found: dict[str, list[Any]] = defaultdict(list)
    with AnyReader([places[where]]) as reader:
        assert reader.message_count == len(written)
        assert {connection.topic: connection.msgtype for connection in reader.connections} == {
            full_topic_name(topic): topic.type for topic in TOPICS.values()
        }
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found[connection.topic].append((time_ns, raw, list(leaves(message))))
    assert found == expected


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    with path.open("rb") as stream:
        yield stream


@contextmanager
def piped(path: Path) -> Iterator[IO[bytes]]:
    with subprocess.Popen(["cat", path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        yield process.stdout


@pytest.mark.parametrize(
    ("source", "kind"), [(opened, SeekingReader), (piped, NonSeekingReader)], ids=["file", "pipe"]
)
def test_mcap_decodes_every_message(made: Made, source: Any, kind: type) -> None:
    numbers = iter(sequences(made.records))
    for path, part in zip(made.files, made.parts, strict=True):
        expected = [
            (full_name(record), next(numbers), record.time_ns, record.time_ns, record.data, exact(record))
            for record in part
        ]
        with source(path) as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            assert isinstance(reader, kind)
            found = [
                (
                    channel.topic,
                    message.sequence,
                    message.log_time,
                    message.publish_time,
                    message.data,
                    list(leaves(content)),
                )
                for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False)
            ]
        assert found == expected


def test_type_hashes_are_those_of_ros(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    # The wheels of ROS install their files below the venv and don't say so.
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.environ.get("AMENT_PREFIX_PATH") or sys.prefix)
    with AnyReader([made.path]) as reader:
        found = {connection.msgtype: connection.digest for connection in reader.connections}
    for type_name, digest in found.items():
        package, _, name = type_name.split("/")
        shipped = json.loads((get_package_share_path(package) / "msg" / f"{name}.json").read_text())
        hashes = {entry["type_name"]: entry["hash_string"] for entry in shipped["type_hashes"]}
        assert digest == hashes[type_name]


def test_rerun_converts_every_file(made: Made, rerun_command: Rerun, tmp_path: Path) -> None:
    for path, part in zip(made.files, made.parts, strict=True):
        converted = tmp_path / f"{path.stem}.rrd"
        rerun_command("mcap", "convert", path, "--output", converted)
        rerun_command("rrd", "verify", converted)
        entities = rerun_command("rrd", "stats", converted)
        for record in part:
            assert f"\n{full_name(record)}: " in entities
