"""A recording with all topics, and what stands in each of its files, for tests of programs that read it."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gear_dynamics_ros.channels import PACE
from gear_dynamics_ros.chunk import Chunk, Commands
from gear_dynamics_ros.events import PAUSE, RESUME
from gear_dynamics_ros.messages.cdr import message_class, serialize, stamp
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import CHUNK_TOPICS, TOPICS, full_topic_name

EPOCH_NS = 1_700_000_000_123_456_789
CHUNKS = 60


class Made(NamedTuple):
    """A finished recording and the messages in each of its files, in order."""

    path: Path
    parts: list[list[Record]]

    @property
    def files(self) -> list[Path]:
        return [self.path / f"{self.path.name}_{number}.mcap" for number in range(len(self.parts))]

    @property
    def records(self) -> list[Record]:
        return [record for part in self.parts for record in part]


class _Kept:
    """Keeps what the recorder beside it was given, and what it should repeat in each new file."""

    def __init__(self) -> None:
        self.parts: list[list[Record]] = [[]]

    def wanted(self) -> Collection[str]:
        return CHUNK_TOPICS

    def write(self, _: Chunk | None, records: Sequence[Record]) -> None:
        self.parts[-1].extend(records)

    def split(self, time_ns: int) -> None:
        latest = {
            record.topic: record._replace(time_ns=time_ns)
            for part in self.parts
            for record in part
            if TOPICS[record.topic].latched
        }
        self.parts.append(list(latest.values()))

    def close(self) -> None:
        """Nothing to finish."""


def extra_records(encoder: Encoder) -> list[Record]:
    """One message of each topic that no chunk, command or event makes."""
    header = message_class("std_msgs/msg/Header")(stamp=stamp(EPOCH_NS), frame_id="")
    key_value = message_class("diagnostic_msgs/msg/KeyValue")(key="overruns", value="0")
    status = message_class("diagnostic_msgs/msg/DiagnosticStatus")(
        level=2, name="gearbox: pacing", message="19 µs late", hardware_id="gearbox", values=[key_value]
    )
    contents = {
        "diagnostics": message_class("diagnostic_msgs/msg/DiagnosticArray")(header=header, status=[status]),
        "clock": message_class("rosgraph_msgs/msg/Clock")(clock=stamp(EPOCH_NS)),
        "drive_torque_command": message_class("std_msgs/msg/Float64")(data=31.5),
        "load_torque_command": message_class("std_msgs/msg/Float64")(data=20.0),
        "speed_command": message_class("std_msgs/msg/Float64")(data=1000.0),
    }
    records = [Record(key, EPOCH_NS, serialize(TOPICS[key].type, value)) for key, value in contents.items()]
    return [
        *records,
        encoder.applied(Commands(30.0, 20.0, 1000.0), 0)._replace(topic="joint_command"),
        encoder.pacing(EPOCH_NS, [0.0] * len(PACE)),
        encoder.model_info(EPOCH_NS, "{}"),
    ]


def record_everything(path: Path) -> Made:
    """0.12 s of a run with commands, changed parameters, a pause, a split, a reset and all topics."""
    parameters = Parameters.from_flat({"operation.control": "torque", "recording.checkpoint_interval": 0.025})
    engine = Engine(parameters)
    encoder = Encoder(parameters, EPOCH_NS)
    recorder, kept = Recorder(path, engine.checkpoint(), EPOCH_NS), _Kept()
    sink = RecorderSink(recorder, engine)
    run = Run(engine, encoder, [sink, kept])
    run.write_records(extra_records(encoder))
    for number in range(CHUNKS):
        if number == 10:
            run.step(Commands(30.0, 55.0, 1700.0))
            continue
        if number == 20:
            run.change(change_values(parameters, {"oil.viscosity": 0.0229}))
        elif number == 30:
            run.write_event(PAUSE)
            run.write_event(RESUME)
            kept.split(EPOCH_NS + engine.sample * parameters.solver.sample_interval_ns)
            sink.split()
        elif number == 40:
            run.reset("by hand")
        run.step()
    run.finish("as asked")
    run.close()
    assert recorder.error is None
    return Made(path, kept.parts)


def leaves(message: Any, path: str = "") -> Iterator[tuple[str, bytes]]:
    """Path and exact content of every value in a decoded message: numbers as doubles, text as UTF-8.

    The message may be of any decoder: a dataclass, or an object that names its fields in ``__slots__``.
    """
    if isinstance(message, str):
        yield path, message.encode()
    elif isinstance(message, int | float):
        yield path, struct.pack("<d", message)
    elif is_dataclass(message) and not isinstance(message, type):
        for field in fields(message):
            # rosbags keeps constants and the name of the type beside the values.
            if field.default is MISSING:
                yield from leaves(getattr(message, field.name), f"{path}.{field.name}")
    elif hasattr(message, "__slots__"):
        for name in message.__slots__:
            yield from leaves(getattr(message, name), f"{path}.{name}")
    elif len(message) and not isinstance(message[0], int | float):
        for index, item in enumerate(message):
            yield from leaves(item, f"{path}[{index}]")
    else:
        yield path, np.asarray(message, dtype="<f8").tobytes()


def sequences(records: Sequence[Record]) -> list[int]:
    """Sequence number of each message of a whole recording: how many came before on its topic."""
    counts: dict[str, int] = {}
    numbers = []
    for record in records:
        numbers.append(counts.get(record.topic, 0))
        counts[record.topic] = numbers[-1] + 1
    return numbers


def full_name(record: Record) -> str:
    """Name of the topic of a message under the default node."""
    return full_topic_name(TOPICS[record.topic])
