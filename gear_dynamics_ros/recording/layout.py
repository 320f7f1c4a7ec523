"""Names and texts of a recording: a rosbag2 folder (metadata version 9) of MCAP files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml
from mcap.records import Channel, Schema

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.messages.cdr import TYPESTORE
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.provenance import Provenance
from gear_dynamics_ros.topics import TOPICS, NodeNames, Topic

METADATA_FILE: Final = "metadata.yaml"
PARAMETERS_ATTACHMENT: Final = "parameters.yaml"
START_ATTACHMENT: Final = "start.json"
END_ATTACHMENT: Final = "end.json"
RUN_METADATA: Final = "gear_dynamics_ros"
ROSBAG2_METADATA: Final = "rosbag2"
ROSBAG2_KEY: Final = "serialized_metadata"
INFORMATION: Final = "rosbag2_bagfile_information"  # root of metadata.yaml
FILES: Final = "relative_file_paths"
ROS_DISTRO: Final = "jazzy"
# A re-simulation needs these.
ALWAYS_RECORDED: Final = ("applied_command", "event")

_CHECKPOINT = re.compile(r"checkpoint_(\d+)\.json")
# The C version needs a quarter of the time for the same text; the engine waits for it at every split.
_DUMPER = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper


class PartSummary(NamedTuple):
    """One MCAP file of a recording: its name, stamps and number of messages."""

    name: str
    start_ns: int  # stamp of the first message
    end_ns: int  # stamp of the last message
    counts: Mapping[str, int]  # messages by full name of the topic

    @property
    def messages(self) -> int:
        """Messages on all topics."""
        return sum(self.counts.values())


class RunMetadata(NamedTuple):
    """Content of the MCAP metadata record RUN_METADATA."""

    provenance: Provenance
    epoch_ns: int  # stamp of simulated time 0
    names: NodeNames
    sample_interval_ns: int
    origin: str = ""  # SHA-256 of the checkpoint at the start of the recording, hexadecimal

    def to_text(self) -> dict[str, str]:
        """All values as text, as MCAP stores them, those of the provenance first."""
        values = {
            **self.provenance._asdict(),
            "epoch_ns": self.epoch_ns,
            "node": self.names.node,
            "remapped": json.dumps(dict(self.names.remapped)),
            "sample_interval_ns": self.sample_interval_ns,
            "origin": self.origin,
        }
        return {name: str(value) for name, value in values.items()}

    def to_lines(self) -> bytes:
        """The same as lines ``name=value`` in the same order."""
        return "".join(f"{name}={value}\n" for name, value in self.to_text().items()).encode()

    @classmethod
    def from_text(cls, values: Mapping[str, str]) -> RunMetadata:
        """Inverse of ``to_text``. Raises KeyError on a missing entry, ValueError on an invalid one."""
        if int(values["sample_interval_ns"]) <= 0:
            raise ValueError("sample_interval_ns must be positive")
        return cls(
            provenance=Provenance(
                version=values["version"],
                kernel_hash=values["kernel_hash"],
                **{
                    name: values.get(name, "")
                    for name in ("model_hash", "processor", "compiler", "libraries")
                },
            ),
            epoch_ns=int(values["epoch_ns"]),
            names=NodeNames(values["node"], _remapped(values.get("remapped", "{}"))),
            sample_interval_ns=int(values["sample_interval_ns"]),
            origin=values.get("origin", ""),
        )


def _remapped(text: str) -> dict[str, str]:
    names = json.loads(text)
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise ValueError("remapped must be the full names of topics")
    return names


def recorded_topics(parameters: Parameters, names: NodeNames) -> dict[str, tuple[str, Topic]]:
    """The topics to record, with their full names, by key in TOPICS."""
    keys = {*parameters.recording.topics, *ALWAYS_RECORDED}
    return {key: (names.topic(key), topic) for key, topic in TOPICS.items() if key in keys}


def require_text(name: str) -> None:
    """Raise UsageError if the ``name`` of a recording is not UTF-8: metadata.yaml names its files."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise UsageError(
            f"the name {os.fsencode(name)!r} of the recording is not UTF-8 text, which metadata.yaml needs: "
            "choose another name"
        ) from None


def part_name(folder: Path, number: int) -> str:
    """File name of part ``number`` of the recording ``folder``."""
    return f"{folder.name}_{number}.mcap"


def part_number(path: Path) -> int:
    """Inverse of ``part_name``; -1 for a name without a number."""
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isdecimal() else -1


def checkpoint_name(sample: int) -> str:
    """Name of the attachment with the checkpoint before ``sample``."""
    return f"checkpoint_{sample}.json"


def checkpoint_sample(name: str) -> int | None:
    """Inverse of ``checkpoint_name``; None for another attachment."""
    match = _CHECKPOINT.fullmatch(name)
    return int(match[1]) if match else None


@cache
def schema(type_name: str) -> bytes:
    """ros2msg schema: the definition of the message, then that of each type it depends on."""
    return TYPESTORE.generate_msgdef(type_name, ros_version=2)[0].encode()


@cache
def type_hash(type_name: str) -> str:
    """RIHS01 hash of a message type."""
    return TYPESTORE.hash_rihs01(type_name)


def qos(topic: Topic) -> list[dict[str, Any]]:
    """Offered quality of service in the form of metadata version 9."""
    return [
        {
            "history": "keep_last",
            "depth": topic.depth,
            "reliability": "reliable" if topic.reliable else "best_effort",
            "durability": "transient_local" if topic.latched else "volatile",
            "deadline": _infinite(),
            "lifespan": _infinite(),
            "liveliness": "automatic",
            "liveliness_lease_duration": _infinite(),
            "avoid_ros_namespace_conventions": False,
        }
    ]


class Definitions(NamedTuple):
    """Schemas and channels of MCAP by their numbers."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]


def channel_definitions(topics: Iterable[tuple[str, Topic]]) -> Definitions:
    """Definitions for ``topics`` with their full names; channels are numbered from 1 in this order."""
    definitions = Definitions({}, {})
    schema_ids: dict[str, int] = {}  # by type
    for number, (name, topic) in enumerate(topics, start=1):
        schema_id = schema_ids.setdefault(topic.type, len(schema_ids) + 1)
        definitions.schemas[schema_id] = Schema(
            data=schema(topic.type), encoding="ros2msg", id=schema_id, name=topic.type
        )
        definitions.channels[number] = Channel(
            id=number,
            topic=name,
            message_encoding="cdr",
            metadata=channel_metadata(topic),
            schema_id=schema_id,
        )
    return definitions


def channel_metadata(topic: Topic) -> dict[str, str]:
    """Metadata of the MCAP channel of a topic."""
    return {"offered_qos_profiles": yaml_text(qos(topic)), "topic_type_hash": type_hash(topic.type)}


def bag_information(topics: Mapping[str, Topic], parts: Sequence[PartSummary]) -> dict[str, Any]:
    """Content of metadata.yaml for ``topics`` (by full name) and ``parts``."""
    filled = [part for part in parts if part.messages]
    start_ns = min((part.start_ns for part in filled), default=0)
    end_ns = max((part.end_ns for part in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **_times(start_ns, end_ns),
        "message_count": sum(part.messages for part in parts),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos(topic),
                    "type_description_hash": type_hash(topic.type),
                },
                "message_count": sum(part.counts.get(name, 0) for part in parts),
            }
            for name, topic in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        FILES: [part.name for part in parts],
        "files": [
            {
                "path": part.name,
                **_times(part.start_ns, part.end_ns),
                "message_count": part.messages,
            }
            for part in parts
        ],
        "custom_data": None,
        "ros_distro": ROS_DISTRO,
    }


def metadata_yaml(topics: Mapping[str, Topic], parts: Sequence[PartSummary]) -> str:
    """Text of metadata.yaml."""
    return yaml_text({INFORMATION: bag_information(topics, parts)})


def embedded_metadata(topics: Mapping[str, Topic], part: PartSummary) -> dict[str, str]:
    """Content of the MCAP metadata record ROSBAG2_METADATA: metadata.yaml of ``part`` alone."""
    return {ROSBAG2_KEY: yaml_text(bag_information(topics, [part]))}


def yaml_text(value: Any) -> str:
    """YAML in block style, in the order given."""
    return str(yaml.dump(value, Dumper=_DUMPER, sort_keys=False, default_flow_style=False))


def _infinite() -> dict[str, int]:
    # A new object each time: PyYAML writes an anchor if one object occurs twice.
    return dict(zip(("sec", "nsec"), divmod(2**63 - 1, 10**9), strict=True))


def _times(start_ns: int, end_ns: int) -> dict[str, dict[str, int]]:
    return {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": end_ns - start_ns},
    }
