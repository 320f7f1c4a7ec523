"""Messages: CDR equal to what an independent serialiser makes of the same values, and what they say."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from gear_dynamics_ros.channels import (
    CHANNEL_NAMES,
    COLUMN,
    ENERGIES,
    IMPACTS,
)
from gear_dynamics_ros.chunk import (
    Chunk,
    Commands,
    Counters,
)
from gear_dynamics_ros.messages.cdr import (
    deserialize,
    message_class,
    serialize,
    stamp,
    stamp_ns,
)
from gear_dynamics_ros.messages.decoder import applied_commands, waveform_samples
from gear_dynamics_ros.messages.encoder import Encoder, joint_state, waveform_message
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.topics import TOPICS, full_topic_name
from support.chunks import chunk_of

EPOCH_NS = 1_700_000_000_123_456_789
COMMANDS = Commands(drive_torque=30.0, load_torque=-4.5, speed=1000.0)


def synthetic_chunk(rows: int = 7, first: int = 400, columns: int = len(CHANNEL_NAMES)) -> Chunk:
    generator = np.random.default_rng(rows)
    samples = generator.standard_normal((rows, columns))
    samples[:, CHANNEL_NAMES.index("meshing_state")] = -1.0
    angles = generator.standard_normal((rows, 2)) * 1e4
    energies = generator.standard_normal(len(ENERGIES))
    impacts = generator.standard_normal((rows // 3, len(IMPACTS)))
    return chunk_of(first, samples, angles=angles, energies=energies, impacts=impacts, commands=COMMANDS)


def decoded(chunk: Chunk, parameters: Parameters | None = None) -> dict[str, object]:
    records = Encoder(parameters or Parameters(), EPOCH_NS).chunk(chunk)
    return {record.topic: deserialize(TOPICS[record.topic].type, record.data) for record in records}


@pytest.mark.parametrize(
    ("node", "key", "name"),
    [
        ("/gearbox", "dte", "/gearbox/dte"),
        ("/cell/gearbox", "speed_command", "/cell/gearbox/command/speed"),
        ("/gearbox", "joint_states", "/joint_states"),
        ("/cell/gearbox", "joint_states", "/cell/joint_states"),
        ("/cell/gearbox", "diagnostics", "/diagnostics"),
    ],
)
def test_names_resolve_as_ros_does(node: str, key: str, name: str) -> None:
    assert full_topic_name(TOPICS[key], node) == name


def test_all_records_of_a_chunk_carry_the_time_of_its_last_sample() -> None:
    chunk = synthetic_chunk()
    records = Encoder(Parameters(), EPOCH_NS).chunk(chunk)
    assert {record.time_ns for record in records} == {EPOCH_NS + 406 * 10_000}
    messages = decoded(chunk)
    for key in ("joint_states", "driving_bearing_force", "driven_bearing_force"):
        assert stamp_ns(messages[key].header.stamp) == EPOCH_NS + chunk.last_ns


@pytest.mark.parametrize("rows", [1, 7, 200])
@pytest.mark.parametrize(
    "channels",
    [CHANNEL_NAMES, tuple(COLUMN), ("time", "mesh_phase", "dte"), ("time", "kinetic_energy", "dte")],
)
def test_waveform_equals_the_serialisers_own_bytes(rows: int, channels: tuple[str, ...]) -> None:
    chunk = synthetic_chunk(rows, columns=len(COLUMN) if "kinetic_energy" in channels else len(CHANNEL_NAMES))
    parameters = Parameters.from_flat({"waveform_channels": channels})
    encoder = Encoder(parameters, EPOCH_NS)
    picked = np.column_stack([chunk[name] for name in channels])
    expected = serialize(TOPICS["waveform"].type, waveform_message(channels, picked))
    for _ in range(2):
        record = next(record for record in encoder.chunk(chunk) if record.topic == "waveform")
        assert record.data == expected
    names, samples = waveform_samples(deserialize(TOPICS["waveform"].type, record.data))
    assert names == channels
    assert samples.tobytes() == picked.tobytes()


@pytest.mark.parametrize(
    ("key", "channel"),
    [
        ("dte", "dte"),
        ("mesh_force", "mesh_force"),
        ("pressure_angle", "pressure_angle"),
        ("meshing_state", "meshing_state"),
    ],
)
def test_packed_scalars_equal_the_serialisers_own_bytes(key: str, channel: str) -> None:
    chunk = synthetic_chunk()
    record = next(record for record in Encoder(Parameters(), EPOCH_NS).chunk(chunk) if record.topic == key)
    value = chunk[channel][-1]
    data = int(value) if key == "meshing_state" else float(value)
    assert record.data == serialize(TOPICS[key].type, message_class(TOPICS[key].type)(data=data))


def test_energy_and_impacts_equal_the_serialisers_own_bytes() -> None:
    chunk, encoder = synthetic_chunk(), Encoder(Parameters(), EPOCH_NS)
    for _ in range(2):
        data = {record.topic: record.data for record in encoder.chunk(chunk)}
        for topic, row, columns, values in (
            ("energy", "sample", ENERGIES, chunk.energies[None, :]),
            ("impacts", "impact", IMPACTS, chunk.impacts),
        ):
            names = [column.name for column in columns]
            assert data[topic] == serialize(TOPICS[topic].type, waveform_message(names, values, row))


def test_a_chunk_without_impacts_brings_no_message_of_them() -> None:
    topics = decoded(synthetic_chunk(rows=2))
    assert "energy" in topics and "impacts" not in topics


def test_joint_states_show_shafts_and_mesh() -> None:
    chunk = synthetic_chunk()
    state = decoded(chunk, Parameters.from_flat({"joint_prefix": "left_"}))["joint_states"]
    last = {name: chunk[name][-1] for name in CHANNEL_NAMES}
    assert state.name == ["left_driving", "left_driven", "left_mesh"]
    assert state.position.tolist() == [*chunk.angles[-1], last["dte"]]
    assert state.velocity.tolist() == [last["driving_speed"], last["driven_speed"], last["dte_rate"]]
    assert state.effort.tolist() == [last["drive_torque"], last["load_torque"], last["mesh_force"]]


PREFIXES = ["", "l", "left_", "cell/left_"]  # one for each padding of what follows a name


@pytest.mark.parametrize("prefix", PREFIXES)
def test_joint_states_equal_the_serialisers_own_bytes(prefix: str) -> None:
    chunk = synthetic_chunk()
    encoder = Encoder(Parameters.from_flat({"joint_prefix": prefix}), EPOCH_NS)
    last = {name: chunk[name][-1] for name in CHANNEL_NAMES}
    expected = joint_state(
        EPOCH_NS + chunk.last_ns,
        [f"{prefix}{joint}" for joint in ("driving", "driven", "mesh")],
        [*chunk.angles[-1], last["dte"]],
        [last["driving_speed"], last["driven_speed"], last["dte_rate"]],
        [last["drive_torque"], last["load_torque"], last["mesh_force"]],
    )
    data = {record.topic: record.data for record in encoder.chunk(chunk)}
    assert data["joint_states"] == serialize(TOPICS["joint_states"].type, expected)


@pytest.mark.parametrize("prefix", PREFIXES)
@pytest.mark.parametrize("gear", ["driving", "driven"])
def test_bearing_force_is_contact_plus_film_and_equals_the_serialisers_own_bytes(
    gear: str, prefix: str
) -> None:
    chunk = synthetic_chunk()
    encoder = Encoder(Parameters.from_flat({"joint_prefix": prefix}), EPOCH_NS)
    vector = message_class("geometry_msgs/msg/Vector3")
    force = vector(
        x=chunk[f"{gear}_contact_force_x"][-1] + chunk[f"{gear}_film_force_x"][-1],
        y=chunk[f"{gear}_contact_force_y"][-1] + chunk[f"{gear}_film_force_y"][-1],
        z=0.0,
    )
    topic = f"{gear}_bearing_force"
    expected = message_class(TOPICS[topic].type)(
        header=message_class("std_msgs/msg/Header")(
            stamp=stamp(EPOCH_NS + chunk.last_ns), frame_id=f"{prefix}{gear}_bearing"
        ),
        wrench=message_class("geometry_msgs/msg/Wrench")(force=force, torque=vector(x=0.0, y=0.0, z=0.0)),
    )
    data = {record.topic: record.data for record in encoder.chunk(chunk)}
    assert data[topic] == serialize(TOPICS[topic].type, expected)


@pytest.mark.parametrize("prefix", PREFIXES)
def test_applied_commands_equal_the_serialisers_own_bytes(prefix: str) -> None:
    encoder = Encoder(Parameters.from_flat({"joint_prefix": prefix}), EPOCH_NS)
    expected = joint_state(
        EPOCH_NS + 1_230_000,
        [f"{prefix}driving", f"{prefix}driven"],
        [],
        [COMMANDS.speed, math.nan],
        [COMMANDS.drive_torque, COMMANDS.load_torque],
    )
    assert encoder.applied(COMMANDS, 123).data == serialize(TOPICS["applied_command"].type, expected)


def test_applied_commands_round_trip_and_read_as_a_joint_command() -> None:
    record = Encoder(Parameters(), EPOCH_NS).applied(COMMANDS, 123)
    message = deserialize(TOPICS["applied_command"].type, record.data)
    assert record.time_ns == stamp_ns(message.header.stamp) == EPOCH_NS + 1_230_000
    assert message.name == ["driving", "driven"]
    assert math.isnan(message.velocity[1])
    assert applied_commands(message) == COMMANDS


def test_event_is_json() -> None:
    counters = Counters(500, 7, 1, 2, 3)
    record = Encoder(Parameters(), EPOCH_NS).event("reset", 250, "by 'operator'\n\u00e9", counters)
    content = json.loads(deserialize(TOPICS["event"].type, record.data).data)
    assert content.pop("counters") == counters._asdict()
    assert content == {"sample": 250, "time": 0.0025, "event": "reset", "message": "by 'operator'\n\u00e9"}
    assert record.time_ns == EPOCH_NS + 2_500_000


def test_a_run_that_ends_badly_still_makes_messages() -> None:
    chunk = synthetic_chunk()
    chunk.samples[-1] = np.nan
    assert decoded(chunk)["meshing_state"].data == 0
    assert Encoder(Parameters(), EPOCH_NS).chunk(synthetic_chunk(0)) == []


def test_needs_neither_ros_nor_rerun() -> None:
    code = (
        "import sys\n"
        "for name in ('rclpy', 'rerun'): sys.modules[name] = None\n"
        "import gear_dynamics_ros.messages.encoder, gear_dynamics_ros.recording.recorder\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
