"""Verification: whatever a run did comes out again, and whatever is altered is found."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.recording.mcap.records import split_records
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.recording.ring import Ring
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import provenance_differences
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import DEFAULT_NAMES, TOPICS, full_topic_name
from support import altering
from support.altering import alter, in_json, on_topic
from support.recordings import SHORT, SHORT_CHUNK, Recorded, perform

# What may be done between two chunks; "restore" takes up the state that "save" kept.
DEEDS: tuple[Any, ...] = (
    "step",
    "reset",
    "save",
    "restore",
    "split",
    Commands(30.0, 55.0, 1700.0),
    Commands(31.0, -20.0, 1500.0),
    {"operation.control": "torque"},
    {"operation.control": "speed", "operation.speed": 1400.0},
    {"operation.governor.integral": 50.0, "operation.drive_torque": 25.0},
    {"surface.driving.roughness": 2e-6, "mesh.error_cos": [3e-6, 1e-6]},
    {"mesh.error_mean": -20e-6, "oil.viscosity": 0.05},
    {"mesh.error_mean": 0.0, "operation.load_torque": 30.0},
)


@given(
    st.lists(st.one_of(st.just("step"), st.sampled_from(DEEDS)), min_size=1, max_size=20),
    st.sampled_from(["torque", "speed"]),
    st.sampled_from([0.0, 3e-4, 9e-4]),
    st.sampled_from([0.0, 12e-4]),
)
@example(["save", "step", "restore", "step", "split", "step"], "speed", 3e-4, 0.0)
@example(["step", "reset", "step", "split", "step"], "torque", 0.0, 6e-4)
# A command repeated at the edge where something else has put another value in force.
@example([DEEDS[5], "step", "reset", DEEDS[5], "step"], "torque", 3e-4, 0.0)
@example([DEEDS[5], "step", DEEDS[12], DEEDS[5], "step"], "speed", 0.0, 0.0)
@example(["save", DEEDS[5], "step", "restore", DEEDS[5], "step"], "torque", 9e-4, 0.0)
# Done after the last chunk, and on both sides of a split at one edge.
@example(["step", "step", DEEDS[7], "split", "reset", "step", "split", DEEDS[8]], "speed", 6e-4, 0.0)
@settings(max_examples=40, deadline=None)
def test_whatever_is_done_comes_out_again(
    deeds: list[Any], control: str, checkpoints: float, split: float
) -> None:
    values = {
        **SHORT,
        "operation.control": control,
        "recording.checkpoint_interval": checkpoints,
        "recording.split_duration": split,
    }
    parameters = Parameters.from_flat(values)
    chunks = deeds.count("step") + 1
    with tempfile.TemporaryDirectory() as folder:
        path = perform(Path(folder) / "bag", deeds, parameters)
        whole = recording.open(path)
        result = verify_recording(whole)
        assert (result.difference, result.samples) == (None, SHORT_CHUNK * chunks)
        assert result.states >= max(len(whole.parts), chunks * 3e-4 / checkpoints - 1 if checkpoints else 0)
        assert whole.parameters == parameters
        for part in path.glob("*.mcap"):
            assert verify_recording(recording.open(part)).difference is None
        middle = chunks * 3e-4 / 2
        result = verify_recording(whole, middle)
        assert result.difference is None
        assert SHORT_CHUNK * chunks / 2 - 1 <= result.samples <= SHORT_CHUNK * chunks


@given(
    st.lists(st.one_of(st.just("step"), st.sampled_from(DEEDS[:4] + DEEDS[5:])), min_size=10, max_size=60),
    st.sampled_from([6e-4, 3e-3]),
)
@settings(max_examples=20, deadline=None)
def test_what_a_ring_holds_comes_out_again(deeds: list[Any], held: float) -> None:
    parameters = Parameters.from_flat({**SHORT, "recording.ring_duration": held})
    engine = Engine(parameters)
    ring = Ring(engine)
    run = Run(engine, Encoder(parameters, 0), [])
    run.attach(ring)
    saved = run.checkpoint()
    for deed in deeds:
        if isinstance(deed, dict):
            run.change(change_values(engine.parameters, deed))
        elif deed == "reset":
            run.reset()
        elif deed == "save":
            saved = run.checkpoint()
        elif deed == "restore":
            run.resume(saved)
        else:
            run.step(deed if isinstance(deed, Commands) else None)
    run.step()
    with tempfile.TemporaryDirectory() as folder:
        found = recording.open(ring.cut().write(Path(folder) / "bag", 0, DEFAULT_NAMES))
        result = verify_recording(found)
        assert found.complete and result.difference is None and result.states >= 1
        wanted = min(round(held / 1e-5), engine.sample)
        assert wanted <= result.samples <= wanted * 9 / 8 + SHORT_CHUNK
        assert found.end_sample == engine.sample


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen chunks with checkpoints, two parts, commands, changes, a reset and a restore."""
    deeds = [
        *("step", "step", Commands(30.0, 55.0, 1700.0), "step", "save"),
        *({"oil.viscosity": 0.03}, "step", "step", "restore", "step", "split", "step"),
        *({"operation.control": "torque"}, Commands(31.0, 25.0, 1500.0), "step", "reset", *["step"] * 7),
    ]
    parameters = Parameters.from_flat({**SHORT, "recording.checkpoint_interval": 9e-4})
    return perform(tmp_path_factory.mktemp("verify") / "bag", deeds, parameters)


def test_the_recording_that_is_altered_below_verifies_as_it_is(bag: Path, tmp_path: Path) -> None:
    for path in (bag, alter(bag, tmp_path / "copy")):
        result = verify_recording(recording.open(path))
        assert result.difference is None
        assert result.states == 8


def assert_found(altered: Path, what: str, sample: int) -> None:
    """Verification names ``what`` differs from ``sample`` on."""
    difference = verify_recording(recording.open(altered)).difference
    assert difference is not None
    assert what in difference.what and difference.sample == sample, difference
    assert difference.recorded != difference.simulated


def bump(values: Any, index: int = 0) -> None:
    """The next double."""
    values[index] = np.nextafter(values[index], np.inf)


def nudge(name: str) -> Any:
    """Change of an attribute to the next double."""

    def change(message: Any) -> None:
        setattr(message, name, np.nextafter(getattr(message, name), np.inf))

    return change


@pytest.mark.parametrize(
    ("topic", "number", "change", "what", "sample"),
    [
        ("waveform", 3, lambda m: bump(m.data, 28 * 7 + 3), "mesh_force", 97),
        ("waveform", 14, lambda m: bump(m.data, 28 * 29), "time", 449),
        ("dte", 5, nudge("data"), "dte: byte", 150),
        ("mesh_force", 5, nudge("data"), "mesh_force: byte", 150),
        ("pressure_angle", 0, nudge("data"), "pressure_angle: byte", 0),
        ("joint_states", 5, lambda m: bump(m.position, 1), "joint_states: byte", 150),
        ("driving_bearing_force", 5, lambda m: nudge("x")(m.wrench.force), "driving_bearing_force", 150),
        ("driven_bearing_force", 5, lambda m: nudge("y")(m.wrench.force), "driven_bearing_force", 150),
        ("energy", 9, lambda m: bump(m.data, 2), "energy: mesh_loss", 270),
        ("meshing_state", 4, lambda m: setattr(m, "data", m.data - 1), "meshing_state: byte", 120),
        ("applied_command", 1, lambda m: bump(m.effort, 1), "load_torque", 60),
        ("load_torque_command", 0, nudge("data"), "load_torque_command: load_torque", 60),
        ("speed_command", 1, nudge("data"), "speed_command: speed", 210),
        # The governor sets the torque: only what was asked for tells that another was commanded.
        ("applied_command", 1, lambda m: bump(m.effort, 0), "drive_torque_command: drive_torque", 60),
    ],
)
def test_an_altered_message_is_found(
    bag: Path, tmp_path: Path, topic: str, number: int, change: Any, what: str, sample: int
) -> None:
    assert_found(alter(bag, tmp_path / "x", message=on_topic(topic, number, change)), what, sample)


@pytest.mark.parametrize(
    ("kind", "what", "sample"),
    [("reset", "dte", 240), ("restore", "dte", 150), ("parameters", "driving_film_force_x", 90)],
)
def test_a_deed_left_out_is_found(bag: Path, tmp_path: Path, kind: str, what: str, sample: int) -> None:
    def drop(topic: str, data: bytes) -> bytes | None:
        return None if topic == "event" and f'"event": "{kind}"'.encode() in data else data

    assert_found(alter(bag, tmp_path / "x", message=drop), what, sample)


@pytest.mark.parametrize(
    ("topic", "what"),
    # Without its waveform a chunk is none, and so is the edge at which parameters change.
    [("energy", "energy"), ("dte", "dte"), ("waveform", "event parameters")],
)
def test_a_message_left_out_is_found(bag: Path, tmp_path: Path, topic: str, what: str) -> None:
    seen = []

    def drop(name: str, data: bytes) -> bytes | None:
        seen.extend([name] if name == topic else [])
        return None if name == topic and len(seen) == 6 else data

    assert_found(alter(bag, tmp_path / "x", message=drop), what, 150)


def entry(name: str, index: int | None = None) -> Any:
    """Change of an entry of a state to the next double."""

    def change(content: dict[str, Any]) -> None:
        state = content["checkpoint"]["state"]
        if index is None:
            state[name] = float(np.nextafter(state[name], np.inf))
        else:
            bump(state[name], index)

    return change


def command_another_speed(content: dict[str, Any]) -> None:
    content["checkpoint"]["commands"]["speed"] = 1.0


@pytest.mark.parametrize(
    ("name", "sample"), [("checkpoint_90.json", 90), ("checkpoint_360.json", 360), ("end.json", 180)]
)
@pytest.mark.parametrize(
    ("change", "what"),
    [
        (entry("u"), "state.u"),
        (entry("omega", 0), "state.omega"),
        (entry("governor"), "state.governor"),
        (entry("mesh_loss"), "state.mesh_loss"),
        (command_another_speed, "commands.speed"),
    ],
)
def test_an_altered_state_is_found(
    bag: Path, tmp_path: Path, name: str, sample: int, change: Any, what: str
) -> None:
    assert_found(alter(bag, tmp_path / "x", attachment=in_json(name, change)), what, sample)


@pytest.mark.parametrize(
    ("change", "what", "sample"),
    [
        (entry("u"), "dte", 0),
        (entry("omega", 0), "dte_rate", 0),
        (entry("governor"), "drive_torque", 0),
        (entry("mesh_loss"), "mesh_loss", 180),  # where the second part begins
        (command_another_speed, "speed", 0),
    ],
)
def test_an_altered_start_is_found(bag: Path, tmp_path: Path, change: Any, what: str, sample: int) -> None:
    assert_found(alter(bag, tmp_path / "x", attachment=in_json("start.json", change)), what, sample)


def overtaken(tmp_path: Path) -> Path:
    """A recording of what leaves no trace in a sample: overridden, only described, or read by nothing."""
    deeds = [
        "step",
        "tell",
        {"oil.viscosity": 0.03},
        {"oil.viscosity": 0.04},
        "step",
        "split",
        "tell",
        "step",
    ]
    return perform(tmp_path / "bag", deeds, Parameters.from_flat({**SHORT, "solver.chunk": 3e-4}))


def replaced(wanted: str, old: bytes, new: bytes | None) -> Any:
    """Change of the contents named ``wanted`` that hold ``old``; left out where ``new`` is None."""

    def change(name: str, data: bytes) -> bytes | None:
        if name != wanted or old not in data:
            return data
        return None if new is None else data.replace(old, new)

    return change


@pytest.mark.parametrize(
    ("kind", "wanted", "old", "new"),
    [
        ("message", "event", b'{"oil.viscosity": 0.03}', b'{"oil.viscosity": 0.02}'),
        ("message", "event", b'"event": "start"', None),
        ("message", "model_info", b'"told": 1', b'"told": 2'),
        ("message", "model_info", b'"told": 1', None),
        ("message", "pacing", b"late", b"hate"),
        ("message", "pacing", b"late", None),
        ("attachment", "start.json", b'"impact_speed": [\n    0.001', b'"impact_speed": [\n    0.002'),
    ],
)
def test_what_no_sample_depends_on_is_guarded_too(
    tmp_path: Path, kind: str, wanted: str, old: bytes, new: bytes | None
) -> None:
    found = recording.open(alter(overtaken(tmp_path), tmp_path / "x", **{kind: replaced(wanted, old, new)}))
    difference = verify_recording(found).difference
    assert difference is not None and "messages since then" in difference.what
    assert len(str(difference.recorded)) == len(str(difference.simulated)) == 64


NOT_TOLD = ("/clock", "/joint_states", *(f"/gearbox/{name}" for name in (
    "dte", "mesh_force", "pressure_angle", "bearing_force/driving", "bearing_force/driven",
    "meshing_state", "energy", "impacts", "waveform",
)))  # fmt: skip


def numbered(content: bytes) -> bytes:
    return len(content).to_bytes(8, "little") + content


FURTHER = ("epoch_ns", "node", "remapped", "sample_interval_ns", "origin")


def test_the_digests_are_those_that_the_documentation_describes(bag: Path) -> None:
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            attached = {entry.name: entry for entry in reader.iter_attachments()}
            told = [
                (message.log_time, numbered(channel.topic.encode()), numbered(message.data))
                for _, channel, message in reader.iter_messages(log_time_order=False)
                if channel.topic not in NOT_TOLD
            ]
            (run,) = (record.metadata for record in reader.iter_metadata() if record.name != "rosbag2")
        names = ("version", "kernel_hash", "model_hash", "processor", "compiler", "libraries")
        lines = [f"{name}={run[name]}\n" for name in (*names, *FURTHER)]
        opening = numbered("".join(lines).encode())
        opening += numbered(attached["parameters.yaml"].data) + numbered(attached["start.json"].data)
        begin = int(json.loads(attached["start.json"].data)["checkpoint"]["sample"]) * 10_000
        later = [name for name in attached if name not in ("parameters.yaml", "start.json")]
        for name in later:
            end = math.inf if name == "end.json" else attached[name].log_time
            stretch = [
                topic + time.to_bytes(8, "little") + data for time, topic, data in told if begin <= time < end
            ]
            expected = hashlib.sha256(opening + b"".join(stretch)).hexdigest()
            assert json.loads(attached[name].data)["digest"] == expected
            opening, begin = numbered(attached[name].data), attached[name].log_time
        assert later[-1] == "end.json" and len(later) >= 2


def described_otherwise(bag: Path, target: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> Path:
    """A copy whose metadata say 7 for ``name``."""
    add = altering.Writer.add_metadata

    def other(writer: Any, record: str, entries: dict[str, str]) -> None:
        add(writer, record, entries | {name: "7"} if name in entries else entries)

    monkeypatch.setattr(altering.Writer, "add_metadata", other)
    return alter(bag, target)


@pytest.mark.parametrize("name", ["version", "kernel_hash", "model_hash", "processor", "libraries"])
def test_an_altered_description_of_the_run_is_found(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    altered = described_otherwise(bag, tmp_path / "x", monkeypatch, name)
    assert_found(altered, "the state at sample 0, or messages since then", 90)


def test_another_epoch_leaves_messages_between_samples(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    altered = described_otherwise(bag, tmp_path / "x", monkeypatch, "epoch_ns")
    with pytest.raises(GearboxError, match="no sample has the time 290000 ns"):
        recording.open(altered)


def with_one_more(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topic: str, where: str) -> Path:
    """A copy with one more message on ``topic``."""
    register, add, finish = (
        getattr(altering.Writer, name) for name in ("register_channel", "add_message", "finish")
    )
    numbers: dict[str, int] = {}
    begun: set[int] = set()

    def noted(writer: Any, **channel: Any) -> int:
        numbers[channel["topic"]] = number = register(writer, **channel)
        return int(number)

    def put_in(writer: Any, time_ns: int) -> None:
        data = next(data for key, data in told if key == topic)
        number = numbers[full_topic_name(TOPICS[topic])]
        add(writer, channel_id=number, log_time=time_ns, publish_time=time_ns, sequence=9, data=data)

    def first(writer: Any, **message: Any) -> None:
        if where == "before the start" and id(writer) not in begun:
            begun.add(id(writer))
            if message["log_time"] > 0:  # of the second part; before the first there is no time
                put_in(writer, message["log_time"] - 100_000)
        add(writer, **message)

    def last(writer: Any) -> None:
        if where != "before the start":
            put_in(writer, 4_790_000 if where == "at the end" else 100_000)
        finish(writer)

    told: list[tuple[str, bytes]] = []
    alter(bag, tmp_path / "read", message=lambda key, data: told.append((key, data)) or data)
    told.append(("model_info", next(data for key, data in told if key == "event")))
    for name, act in (("register_channel", noted), ("add_message", first), ("finish", last)):
        monkeypatch.setattr(altering.Writer, name, act)
    return alter(bag, tmp_path / "x")


@pytest.mark.parametrize(
    ("where", "topic", "what", "sample"),
    [
        ("before the start", "model_info", "the state at sample 180, or messages since then", 270),
        ("before the start", "dte", "messages of chunks", 480),
        ("before the start", "waveform", "messages of chunks", 480),
        ("at the end", "model_info", "the state at sample 180, or messages since then", 180),
        ("at the end", "dte", "messages of chunks", 480),
        ("at the end", "waveform", "waveform", 180),
        ("long before the end", "dte", "messages of chunks", 480),
        ("long before the end", "waveform", "messages of chunks", 11),
    ],
)
def test_a_message_put_in_is_found(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    where: str,
    topic: str,
    what: str,
    sample: int,
) -> None:
    assert_found(with_one_more(bag, tmp_path, monkeypatch, topic, where), what, sample)


@pytest.mark.parametrize(
    ("where", "topic", "said"),
    [
        ("before the start", "event", r"bag_1\.mcap: it starts at sample 180 but has an action at 150"),
        ("at the end", "event", r"bag_1\.mcap: it starts at sample 180 but has an action at 0"),
        ("long before the end", "event", r"bag_0\.mcap goes back in time .*/gearbox/event"),
        ("long before the end", "model_info", r"bag_0\.mcap goes back in time .*/gearbox/model_info"),
    ],
)
def test_a_message_put_in_where_none_can_be_is_refused(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, topic: str, said: str
) -> None:
    altered = with_one_more(bag, tmp_path, monkeypatch, topic, where)
    with pytest.raises(GearboxError, match=said):
        verify_recording(recording.open(altered))


def test_a_zero_is_a_zero_with_either_sign(tmp_path: Path) -> None:
    zeros = [Commands(30.0, load, 1700.0) for load in (0.0, -0.0, 0.0, -0.0)]
    deeds = [deed for commands in zeros for deed in (commands, "step", "step")]
    parameters = Parameters.from_flat({**SHORT, "operation.load_torque": -0.0, "operation.speed": 1700.0})
    assert verify_recording(recording.open(perform(tmp_path / "bag", deeds, parameters))).difference is None


def test_from_behind_a_lost_chunk_goes_on(bag: Path, tmp_path: Path) -> None:
    """The first part lost its last messages: what the second one repeats can't be compared with them."""
    seen: list[str] = []

    def drop(topic: str, data: bytes) -> bytes | None:
        seen.append(topic)
        return data if len(seen) < 40 else None

    copy = shutil.copytree(bag, tmp_path / "bag")
    (tmp_path / "one").mkdir()
    shutil.copy(bag / "bag_0.mcap", tmp_path / "one")
    shutil.copy(alter(tmp_path / "one", tmp_path / "x", message=drop) / "bag_0.mcap", copy)
    assert_found(copy, "event parameters", 90)
    assert verify_recording(recording.open(copy), 2e-3).difference is None


def test_a_recording_without_a_message_verifies_unless_it_broke_off(tmp_path: Path) -> None:
    parameters = Parameters.from_flat(SHORT)
    engine = Engine(parameters)
    RecorderSink(Recorder(tmp_path / "bag", engine.checkpoint(), 0), engine).close()
    result = verify_recording(recording.open(tmp_path / "bag"))
    assert (result.difference, result.samples, result.states) == (None, 0, 1)
    content = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    begins = [
        len(MCAP0_MAGIC) + offset
        for opcode, offset, _ in split_records(content[len(MCAP0_MAGIC) : -len(MCAP0_MAGIC)])
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
    ]
    # the start lies before them, however long the names of machine and versions in it are
    for begin in begins[1:10:4]:
        (tmp_path / "cut.mcap").write_bytes(content[: begin + 20])
        with pytest.raises(GearboxError, match="broke off before its first message"):
            verify_recording(recording.open(tmp_path / "cut.mcap"))


def test_a_part_alone_verifies_to_its_end(tmp_path: Path) -> None:
    bag = overtaken(tmp_path)
    for path in bag.glob("*.mcap"):
        result = verify_recording(recording.open(path))
        assert result.difference is None and result.states == 1


# Altered in parameters.yaml: text, name, new value, and where it shows if start.json says the same.
ALTERED_PARAMETERS = (
    (b"roughness: 8.0e-07", "surface.driving.roughness", 8.000001e-07, "mesh_force", 0),
    (
        b"minimum_impact_speed: 0.001",
        "bearings.minimum_impact_speed",
        0.0010001,
        "bearings.minimum_impact_speed",
        90,
    ),
    # Of no consequence for this run: told by what else is stored.
    (
        b"kelvin_damping: 2000.0",
        "bearings.driving.kelvin_damping",
        2001.0,
        "bearings.driving.kelvin_damping",
        90,
    ),
)


def parameter_altered(old: bytes, value: float) -> Any:
    new = old.partition(b":")[0] + f": {value!r}".encode()

    def change(name: str, data: bytes) -> bytes:
        return data.replace(old, new, 1) if name == "parameters.yaml" else data

    return change


@pytest.mark.parametrize(("old", "name", "value", "what", "sample"), ALTERED_PARAMETERS)
def test_an_altered_parameter_is_found(
    bag: Path, tmp_path: Path, old: bytes, name: str, value: float, what: str, sample: int
) -> None:
    in_yaml = parameter_altered(old, value)
    altered = alter(bag, tmp_path / "x", attachment=in_yaml)
    assert recording.open(altered).parameters.to_flat()[name] == value
    assert_found(altered, f"parameters.yaml: {name}", 0)

    def in_start(content: dict[str, Any]) -> None:
        assert content["checkpoint"]["parameters"][name] == recording.open(bag).parameters.to_flat()[name]
        content["checkpoint"]["parameters"][name] = value

    in_both = in_json("start.json", in_start)
    altered = alter(bag, tmp_path / "y", attachment=lambda key, data: in_both(key, in_yaml(key, data)))
    assert_found(altered, what, sample)


def test_an_altered_change_of_a_parameter_is_found(bag: Path, tmp_path: Path) -> None:
    def change(topic: str, data: bytes) -> bytes:
        return data.replace(b": 0.03}", b": 0.04}") if topic == "event" else data

    assert_found(alter(bag, tmp_path / "x", message=change), "driving_film_force_x", 90)


def test_an_event_that_cannot_be_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def unknown(topic: str, data: bytes) -> bytes:
        return data.replace(b"oil.viscosity", b"oil.vi5cosity") if topic == "event" else data

    def damaged(topic: str, data: bytes) -> bytes:
        return data.replace(b'"event": "reset"', b'"event"; "reset"') if topic == "event" else data

    for change, told in ((unknown, "oil.vi5cosity"), (damaged, "event")):
        path = alter(bag, tmp_path / told, message=change)
        assert replay_main(["verify", str(path)]) == 1
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1


@pytest.mark.parametrize("channels", [CHANNEL_NAMES, tuple(COLUMN), ("time", "mesh_loss")])
def test_any_choice_of_channels_comes_out_again(tmp_path: Path, channels: tuple[str, ...]) -> None:
    parameters = Parameters.from_flat({**SHORT, "waveform_channels": channels})
    deeds = ["step", Commands(30.0, 55.0, 1700.0), "step", "reset", "step"]
    result = verify_recording(recording.open(perform(tmp_path / "bag", deeds, parameters)))
    assert (result.difference, result.samples) == (None, 4 * SHORT_CHUNK)


def test_from_begins_at_the_last_state_before(bag: Path) -> None:
    read = recording.open(bag)
    assert verify_recording(read, 0.0).samples == 16 * SHORT_CHUNK
    # the part begins at 180, checkpoints lie 90 samples apart
    assert verify_recording(read, 2.8e-3).samples == (16 * SHORT_CHUNK) - 270
    with pytest.raises(UsageError, match=r"lies outside the recording: it holds 0 s to 0\.0048 s"):
        verify_recording(read, 1.0)


def test_a_difference_is_told_with_both_values_and_what_else_differs(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = alter(bag, tmp_path / "x", message=on_topic("waveform", 3, lambda m: bump(m.data, 28 * 7 + 3)))
    assert replay_main(["verify", str(path)]) == 1
    out, err = capsys.readouterr()
    force = recording.open(bag).waveform()[97, 3]
    assert not out
    assert (
        f"sample 97, mesh_force: recorded {float(np.nextafter(force, np.inf))!r}, now {float(force)!r}" in err
    )
    assert replay_main(["verify", str(bag), "--from", "0.003"]) == 0
    out, err = capsys.readouterr()
    assert "are the same to the bit" in out and "times real time" in out


def test_another_processor_or_kernel_is_named(bag: Path) -> None:
    read = recording.open(bag)
    assert provenance_differences(read.run.provenance) == []
    other = read.run.provenance._replace(processor="an abacus", kernel_hash="0" * 64)
    read.run = read.run._replace(provenance=other)
    kernel, processor = provenance_differences(read.run.provenance)
    assert kernel.startswith("kernel hash: recorded by 000")
    assert processor.startswith("processor: recorded by an abacus, this is ")


# The events of ``bag`` in order: kind and sample. The fifth is repeated by the second part from the first.
EVENTS = (
    ("start", 0),
    ("parameters", 90),
    ("parameters", 150),
    ("restore", 150),
    ("", 180),
    ("parameters", 210),
    ("reset", 240),
)


def event_told_otherwise(bag: Path, target: Path, number: int, key: str) -> Path:
    def change(message: Any) -> None:
        content = json.loads(message.data)
        if key == "event":
            content[key] = "nothing known"
        elif key == "counters":
            content[key]["steps"] += 1
        else:
            content[key] -= 10  # a sample between two chunks, where nothing can act
        message.data = json.dumps(content)

    return alter(bag, target, message=on_topic("event", number, change))


@pytest.mark.parametrize(
    ("key", "what"),
    [
        ("sample", "event {kind}"),
        ("time", "event {kind}: time"),
        ("counters", "event {kind}: counters"),
        ("event", "event nothing known"),
    ],
)
@pytest.mark.parametrize("number", [1, 2, 3, 5, 6])
def test_an_event_told_otherwise_is_found(
    bag: Path, tmp_path: Path, number: int, key: str, what: str
) -> None:
    kind, sample = EVENTS[number]
    assert_found(event_told_otherwise(bag, tmp_path / "x", number, key), what.format(kind=kind), sample)


@pytest.mark.parametrize(
    ("key", "what"),
    [("time", "event start: time"), ("counters", "event start: counters"), ("event", "event nothing known")],
)
def test_a_start_told_otherwise_is_found(bag: Path, tmp_path: Path, key: str, what: str) -> None:
    assert_found(event_told_otherwise(bag, tmp_path / "x", 0, key), what, 0)


@pytest.mark.parametrize("key", ["sample", "time", "counters", "event"])
def test_an_event_repeated_otherwise_by_the_next_part_is_found(bag: Path, tmp_path: Path, key: str) -> None:
    assert_found(event_told_otherwise(bag, tmp_path / "x", 4, key), "event", EVENTS[4][1])


@pytest.mark.parametrize(
    ("number", "what", "sample"), [(1, "commands", 60), (2, "applied_command", 180), (3, "commands", 210)]
)
def test_commands_at_no_edge_of_a_chunk_are_found(
    bag: Path, tmp_path: Path, number: int, what: str, sample: int
) -> None:
    def earlier(message: Any) -> None:
        message.header.stamp.nanosec -= 10_000

    change = on_topic("applied_command", number, earlier)
    assert_found(alter(bag, tmp_path / "x", message=change), what, sample)


@pytest.mark.parametrize("topic", ["event", "applied_command"])
def test_what_a_part_should_begin_with_is_missed(bag: Path, tmp_path: Path, topic: str) -> None:
    copy = shutil.copytree(bag, tmp_path / "bag")
    seen: list[str] = []

    def drop(key: str, data: bytes) -> bytes | None:
        seen.extend([key] if key == topic else [])
        return None if key == topic and len(seen) == 1 else data

    (copy / "bag_1.mcap").unlink()
    (tmp_path / "one").mkdir()
    shutil.copy(bag / "bag_1.mcap", tmp_path / "one")
    shutil.copy(alter(tmp_path / "one", tmp_path / "x", message=drop) / "bag_1.mcap", copy)
    difference = verify_recording(recording.open(copy)).difference
    assert difference is not None and difference.what == topic


@pytest.mark.parametrize("number", [0, 1])
def test_a_file_that_is_missing_is_told(bag: Path, tmp_path: Path, number: int) -> None:
    copy = shutil.copytree(bag, tmp_path / "bag")
    (copy / f"bag_{number}.mcap").unlink()
    with pytest.raises(
        GearboxError,
        match=rf"lists bag_{number}.mcap \(0.00\d+ s to 0.00\d+ s\), which is missing: put it back",
    ):
        verify_recording(recording.open(copy))


def test_a_topic_taken_out_with_its_channel_is_missed(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register = altering.Writer.register_channel

    def without_dte(writer: Any, **channel: Any) -> int:
        return -1 if channel["topic"] == "/gearbox/dte" else register(writer, **channel)

    monkeypatch.setattr(altering.Writer, "register_channel", without_dte)
    drop = alter(bag, tmp_path / "x", message=lambda topic, data: None if topic == "dte" else data)
    difference = verify_recording(recording.open(drop)).difference
    assert difference is not None and difference.what == "dte"


def test_a_message_that_stands_twice_is_found(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = altering.Writer.add_message

    def twice(writer: Any, **message: Any) -> None:
        if len(message["data"]) == 12:  # a Float64
            add(writer, **{**message, "data": message["data"][:4] + bytes(8)})
        add(writer, **message)

    monkeypatch.setattr(altering.Writer, "add_message", twice)
    with pytest.raises(GearboxError, match="one chunk has two messages on"):
        verify_recording(recording.open(alter(bag, tmp_path / "x")))


@pytest.mark.parametrize("name", ["drive_torque", "load_torque", "speed"])
def test_commands_of_the_start_told_otherwise_are_found(tmp_path: Path, name: str) -> None:
    whole = perform(
        tmp_path / "bag", ["step"], Parameters.from_flat({**SHORT, "operation.control": "torque"})
    )
    change = in_json("start.json", lambda content: bump_entry(content["checkpoint"]["commands"], name))
    difference = verify_recording(recording.open(alter(whole, tmp_path / "x", attachment=change))).difference
    assert difference is not None and name in difference.what


def bump_entry(values: dict[str, float], name: str) -> None:
    values[name] = float(np.nextafter(values[name], np.inf))


def test_an_end_that_is_not_stored_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay_main(["verify", str(bag)]) == 0
    assert "not concluded" not in capsys.readouterr().out
    cut = alter(bag, tmp_path / "x", attachment=lambda name, data: None if name == "end.json" else data)
    assert replay_main(["verify", str(cut)]) == 0
    assert "the recording was not concluded" in capsys.readouterr().out
    # As a crash right after a split leaves it.
    broken = shutil.copytree(bag, tmp_path / "broken")
    (broken / "metadata.yaml").unlink()
    (broken / "bag_1.mcap").write_bytes(b"")
    assert replay_main(["verify", str(broken)]) == 0
    assert "the recording was not concluded" in capsys.readouterr().out


@pytest.mark.parametrize(
    "values",
    [
        {"mesh.stiffness": 1e13, "solver.sample_interval": 2e-5},
        {"gears.module": 1.0},
        {"gears.driving.mass": 1e-9},
    ],
    ids=lambda values: "_".join(values),
)
def test_a_run_that_ended_with_a_state_that_is_not_finite_verifies(
    tmp_path: Path, values: dict[str, float]
) -> None:
    parameters = Parameters.from_flat({"solver.chunk": 3e-4, **values})
    run = Recorded(tmp_path / "bag", parameters).run
    for _ in range(40):
        if run.state.ended:
            break
        run.step()
    run.close()
    assert "no longer finite" in run.state.reason
    result = verify_recording(recording.open(tmp_path / "bag"))
    assert result.difference is None and result.states >= 1
