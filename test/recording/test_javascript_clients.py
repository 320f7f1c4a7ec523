"""The JavaScript readers of MCAP and ROS 2 messages, as in Foxglove, read what was written."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from gear_dynamics_ros import __version__
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.topics import TOPICS
from support.every_topic import EPOCH_NS, Made, full_name, leaves, record_everything, sequences
from support.paths import TESTS

READERS = TESTS / "node"
OLDEST_NODE = 18


@pytest.fixture(scope="module")
def node() -> str:
    """Command of a Node.js that can run the readers."""
    command = shutil.which("node")
    if command is None:
        pytest.skip("node is not installed")
    version = subprocess.run([command, "--version"], check=True, capture_output=True, text=True).stdout
    found = re.match(r"v(\d+)\.", version)
    if found is None or int(found[1]) < OLDEST_NODE:
        pytest.skip(f"node {version.strip()} is older than {OLDEST_NODE}")
    if not (READERS / "node_modules" / ".installed").exists():
        pytest.skip("the readers are not installed: run make test where npm reaches its registry")
    return command


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return record_everything(tmp_path_factory.mktemp("node_clients") / "bag")


def read(node: str, *paths: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [node, READERS / "read_recordings.mjs", *paths], capture_output=True, text=True, timeout=120
    )


@pytest.fixture(scope="module")
def reports(node: str, made: Made) -> list[dict[str, Any]]:
    """What the readers found in each file."""
    done = read(node, *made.files)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def expected_topics(part: list[Record], numbers: list[int]) -> dict[str, dict[str, Any]]:
    """Type, count and checksums of each topic, made as ``read_recordings.mjs`` makes them."""
    contents: dict[str, Any] = defaultdict(hashlib.sha256)
    stamps: dict[str, Any] = defaultdict(hashlib.sha256)
    topics: dict[str, dict[str, Any]] = {}
    for record, number in zip(part, numbers, strict=True):
        name, type_name = full_name(record), TOPICS[record.topic].type
        for path, content in leaves(deserialize(type_name, record.data)):
            contents[name].update(f"{path} {len(content)}\n".encode() + content)
        stamps[name].update(f"{number} {record.time_ns} {record.time_ns}\n".encode())
        topics[name] = {
            "type": type_name,
            "type_hash": layout.type_hash(type_name),
            "messages": topics.get(name, {"messages": 0})["messages"] + 1,
            "content": contents[name].hexdigest(),
            "stamps": stamps[name].hexdigest(),
        }
    return topics


def test_every_message_comes_out_as_it_was_written(made: Made, reports: list[dict[str, Any]]) -> None:
    numbers = sequences(made.records)
    assert [report["file"] for report in reports] == [path.name for path in made.files]
    for report, part in zip(reports, made.parts, strict=True):
        found = {name: {**topic, "last": None} for name, topic in report["topics"].items()}
        expected = expected_topics(part, numbers[: len(part)])
        assert found == {name: {**topic, "last": None} for name, topic in expected.items()}
        assert report["chunks"] > 1
        numbers = numbers[len(part) :]


def test_values_have_their_names(made: Made, reports: list[dict[str, Any]]) -> None:
    first, second = (report["topics"] for report in reports)
    (status,) = first["/diagnostics"]["last"]["status"]
    assert (status["level"], status["message"]) == (2, "19 µs late")
    assert first["/clock"]["last"] == {
        "clock": {"sec": EPOCH_NS // 1_000_000_000, "nsec": EPOCH_NS % 1_000_000_000}
    }
    command = first["/gearbox/command/applied"]["last"]
    assert command["name"] == ["driving", "driven"]
    assert (command["effort"], command["velocity"]) == ([30.0, 55.0], [1700.0, "NaN"])
    event = json.loads(second["/gearbox/event"]["last"]["data"])
    assert (event["event"], event["message"]) == ("end", "as asked")
    wave = second["/gearbox/waveform"]["last"]
    samples, channels = wave["layout"]["dim"]
    assert len(wave["data"]) == samples["size"] * channels["size"] == samples["stride"]
    assert len(channels["label"].split(",")) == channels["size"]


def test_attachments_and_metadata_are_there(made: Made, reports: list[dict[str, Any]]) -> None:
    for number, report in enumerate(reports):
        assert report["profile"] == "ros2"
        kinds = {name: entry["media_type"] for name, entry in report["attachments"].items()}
        checkpoints = (("checkpoint_2600", "checkpoint_5200"), ("checkpoint_8600", "checkpoint_11200"))
        assert kinds == {
            "parameters.yaml": "application/yaml",
            **{f"{name}.json": "application/json" for name in ("start", *checkpoints[number], "end")},
        }
        start = json.loads(report["attachments"]["start.json"]["text"])
        assert start["checkpoint"]["sample"] == number * 6000
        viscosity = ("viscosity: 0.0228", "viscosity: 0.0229")[number]
        assert viscosity in report["attachments"]["parameters.yaml"]["text"]
        assert report["metadata"]["gear_dynamics_ros"]["version"] == __version__
        assert report["metadata"]["gear_dynamics_ros"]["epoch_ns"] == str(EPOCH_NS)
        assert f"- {made.files[number].name}\n" in report["metadata"]["rosbag2"]["serialized_metadata"]


def test_a_damaged_file_is_refused(node: str, made: Made, tmp_path: Path) -> None:
    content = bytearray(made.files[0].read_bytes())
    content[len(content) // 3] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(content)
    done = read(node, tmp_path / "damaged.mcap")
    assert done.returncode != 0
    assert done.stdout == ""
    assert "CRC" in done.stderr or "zstd" in done.stderr.lower(), done.stderr
