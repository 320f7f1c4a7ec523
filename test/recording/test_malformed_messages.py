"""Messages that are not what their topic holds: every tool says so in one line, none ends in a traceback."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import message_class, serialize
from gear_dynamics_ros.messages.decoder import MessageDecoder
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import COMMAND_TOPICS, FLOAT64, TOPICS, is_rows
from support.altering import Change, alter, on_topic
from support.sinks import Keeper

Act = Callable[[Any], object]


def perform(path: Path) -> dict[str, Record]:
    """Recording of six chunks with commands, a change and a restore; returns a message of each topic."""
    parameters = Parameters.from_flat({"solver.chunk": 3e-4, "clock_rate": 1000.0})
    engine, encoder, kept = Engine(parameters), Encoder(parameters, 0), Keeper()
    run = Run(engine, encoder, [RecorderSink(Recorder(path, engine.checkpoint(), 0), engine), kept])
    start = run.checkpoint()
    load = [("load_torque_command", serialize(FLOAT64, message_class(FLOAT64)(data=55.0)))]
    joint = [("joint_command", encoder.applied(Commands(31.0, 25.0, 1500.0), 0).data)]
    run.write_records([encoder.model_info(0, "{}")])
    run.step()
    run.step(engine.commands._replace(load_torque=55.0), load)
    run.change(change_values(engine.parameters, {"oil.viscosity": 0.03}))
    run.step(Commands(31.0, 25.0, 1500.0), joint)
    run.resume(start)
    run.step()
    while not any(record.topic == "impacts" for record in kept.records):
        run.step()
    run.finish("done")
    run.close()
    return {record.topic: record for record in kept.records}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("malformed") / "bag"
    perform(path)
    return path


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Record]:
    return perform(tmp_path_factory.mktemp("samples") / "bag")


def decode(topic: str, data: bytes) -> None:
    """Decode as every tool does; GearboxError is how each of them learns of a fault."""
    decoder = MessageDecoder(CHANNEL_NAMES, "", "bag")
    with suppress(GearboxError):
        decoder.message(topic, 0, data)
    read: dict[str, Callable[[int, bytes], object]] = {
        "applied_command": decoder.applied,
        "event": decoder.event,
    }
    with suppress(GearboxError):
        if is_rows(topic):
            decoder.rows(topic, 0, data)
        elif topic in COMMAND_TOPICS:
            decoder.changes(topic, 0, data)
        elif topic in read:
            read[topic](0, data)


@given(st.randoms(use_true_random=False), st.data())
@settings(max_examples=300, deadline=None)
def test_no_bytes_raise_anything_but_an_error_of_this_package(
    samples: dict[str, Record], rng: random.Random, data: st.DataObject
) -> None:
    topic = data.draw(st.sampled_from(sorted(samples)))
    damaged = bytearray(samples[topic].data)
    for _ in range(rng.choice([0, 1, 1, 3, 30])):
        # Lengths and offsets stand at the beginning.
        at = rng.randrange(min(len(damaged), rng.choice([16, 64, len(damaged)])))
        damaged[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
    cut = rng.choice([None, rng.randrange(len(damaged) + 1)])
    decode(topic, bytes(damaged[:cut]) + rng.randbytes(rng.choice([0, 0, 1, 3, 8])))


@given(st.sampled_from(sorted(TOPICS)), st.binary(max_size=200))
@settings(max_examples=300, deadline=None)
def test_random_bytes_are_refused_or_read(topic: str, content: bytes) -> None:
    if topic != "diagnostics" or len(content) < 100:
        decode(topic, content)
        decode(topic, b"\x00\x01\x00\x00" + content)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda values: st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=5), values, max_size=3),
    max_leaves=5,
)
ENTRIES = ["sample", "time", "event", "message", "counters", "parameters", "checkpoint", "commands"]


@given(st.dictionaries(st.sampled_from(ENTRIES), JSON), st.sampled_from(["", "counters", "sample"]))
@settings(max_examples=300, deadline=None)
def test_no_event_raises_anything_but_an_error_of_this_package(
    samples: dict[str, Record], changed: dict[str, Any], dropped: str
) -> None:
    string = message_class(TOPICS["event"].type)
    content = json.loads(samples["event"].data[8:-1]) | changed
    content.pop(dropped, None)
    decode("event", serialize(TOPICS["event"].type, string(data=json.dumps(content))))


def test_a_message_as_it_was_recorded_is_read(samples: dict[str, Record]) -> None:
    decoder = MessageDecoder(CHANNEL_NAMES, "", "bag")
    assert decoder.applied(*samples["applied_command"][1:]).commands.speed == 1623.156
    assert decoder.event(*samples["event"][1:]).message == "done"
    assert decoder.changes("load_torque_command", 0, samples["load_torque_command"].data) == {
        "load_torque": 55.0
    }
    for topic in ("waveform", "energy", "impacts"):
        assert len(decoder.rows(*samples[topic]))


def in_event(kind: str, change: Callable[[dict[str, Any]], object]) -> Change:
    """Change of the JSON of the event of this kind."""
    string = message_class(TOPICS["event"].type)

    def act(topic: str, data: bytes) -> bytes:
        if topic != "event" or f'"event": "{kind}"'.encode() not in data:
            return data
        content = json.loads(data[8:-1])
        change(content)
        return serialize(TOPICS["event"].type, string(data=json.dumps(content)))

    return act


def cut_short(wanted: str, number: int) -> Change:
    """The message ``number`` on a topic without its last bytes."""
    seen: list[str] = []

    def act(topic: str, data: bytes) -> bytes:
        seen.extend([topic] if topic == wanted else [])
        return data[:-9] if topic == wanted and len(seen) == number + 1 else data

    return act


def put(name: str, value: Any) -> Act:
    return lambda message: setattr(message, name, value)


NONE = np.array([])
COMMANDS: dict[str, Callable[[], Change]] = {
    "without efforts": lambda: on_topic("applied_command", 1, put("effort", NONE)),
    "with one velocity": lambda: on_topic("applied_command", 1, put("velocity", np.array([1.0]))),
    "that are no numbers": lambda: on_topic("applied_command", 1, put("effort", np.array([math.nan, 1.0]))),
    "cut short": lambda: cut_short("applied_command", 1),
}
EVENTS: dict[str, Callable[[], Change]] = {
    "without an entry": lambda: in_event("parameters", lambda entries: entries.pop("sample")),
    "at no sample": lambda: in_event("parameters", lambda entries: entries.update(sample=math.nan)),
    "at half a sample": lambda: in_event("parameters", lambda entries: entries.update(sample=0.5)),
    "without a time": lambda: in_event("parameters", lambda entries: entries.update(time=None)),
    "counting in text": lambda: in_event("parameters", lambda entries: entries["counters"].update(steps="3")),
    "with a list of parameters": lambda: in_event(
        "parameters", lambda entries: entries.update(parameters=[1])
    ),
    "that is not an object": lambda: on_topic("event", 1, put("data", "[1]")),
    "that is no JSON": lambda: on_topic("event", 1, put("data", "{")),
    "cut short": lambda: cut_short("event", 1),
}


def told(capsys: pytest.CaptureFixture[str], tool: str, topic: str) -> None:
    """Assert that one line on stderr names the message."""
    error = capsys.readouterr().err
    assert error.startswith(f"{tool}: error: ") and error.count("\n") == 1
    assert f"the message on ~/{topic} at " in error and " ns is damaged: " in error


def check_tools(
    path: Path, out: Path, capsys: pytest.CaptureFixture[str], topic: str, *commands: list[str]
) -> None:
    for words in commands:
        given = {"BAG": str(path), "OUT": str(out / "out.csv")}
        assert replay_main([given.get(word, word) for word in words]) == 1, words
        told(capsys, "replay", topic)
        assert not (out / "out.csv").exists()
    # What can't be decoded is kept all the same.
    assert replay_main(["recover", str(path)]) == 0
    assert "nothing was lost" in capsys.readouterr().out
    assert recording.open(out / "damaged_recovered").size > 0


TOOLS = (["info", "BAG"], ["verify", "BAG"], ["diff", "BAG", "BAG"], ["publish", "BAG"])


@pytest.mark.parametrize("name", COMMANDS)
def test_damaged_commands_in_force_are_told_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = alter(bag, tmp_path / "damaged", message=COMMANDS[name]())
    export = ["export", "BAG", "--table", "commands", "--output", "OUT"]
    check_tools(path, tmp_path, capsys, "command/applied", *TOOLS, export)
    assert analyze_main([str(path), "--output", str(tmp_path / "out")]) == 1
    told(capsys, "analyze", "command/applied")


@pytest.mark.parametrize("name", EVENTS)
def test_a_damaged_event_is_told_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = alter(bag, tmp_path / "damaged", message=EVENTS[name]())
    export = ["export", "BAG", "--table", "events", "--output", "OUT"]
    check_tools(path, tmp_path, capsys, "event", *TOOLS, export)
    assert analyze_main([str(path), "--output", str(tmp_path / "out")]) == 1
    told(capsys, "analyze", "event")


ROWS: dict[str, tuple[str, Act]] = {
    "waveform of a column too few": ("waveform", lambda m: put("label", "time")(m.layout.dim[1])),
    "waveform of other columns": (
        "waveform",
        lambda m: put("label", ",".join(reversed(CHANNEL_NAMES)))(m.layout.dim[1]),
    ),
    "waveform of other lengths": ("waveform", lambda m: put("data", m.data[:-1])(m)),
    "waveform without a layout": ("waveform", lambda m: put("dim", [])(m.layout)),
    "waveform without a row": (
        "waveform",
        lambda m: (put("data", NONE)(m), put("size", 0)(m.layout.dim[0])),
    ),
    "energy of other columns": ("energy", lambda m: put("label", "time")(m.layout.dim[1])),
    "impacts of other columns": ("impacts", lambda m: put("label", "begin,end")(m.layout.dim[1])),
}


@pytest.mark.parametrize("name", ROWS)
def test_damaged_rows_are_told_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    topic, change = ROWS[name]
    path = alter(bag, tmp_path / "damaged", message=on_topic(topic, 0, change))
    export = ["export", "BAG", "--table", topic, "--output", "OUT"]
    for words in (["verify", "BAG"], export):
        given = {"BAG": str(path), "OUT": str(tmp_path / "out.csv")}
        assert replay_main([given.get(word, word) for word in words]) == 1
        told(capsys, "replay", topic)


@pytest.mark.parametrize("topic", ["waveform", "energy"])
def test_a_number_that_is_not_finite_is_told_by_analyze(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], topic: str
) -> None:
    def spoil(message: Any) -> None:
        message.data[1] = math.nan

    path = alter(bag, tmp_path / "spoilt", message=on_topic(topic, 1, spoil))
    assert analyze_main([str(path), "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("analyze: error: ") and error.count("\n") == 1
    assert "is nan, because the recording has a value that is not finite" in error


@pytest.mark.parametrize("topic", ["load_torque_command", "joint_command"])
def test_a_command_that_is_none_is_told_by_verify(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], topic: str
) -> None:
    path = alter(bag, tmp_path / "damaged", message=cut_short(topic, 0))
    assert replay_main(["verify", str(path)]) == 1
    error = capsys.readouterr().err
    assert f"the message on {TOPICS[topic].name} at " in error and error.count("\n") == 1


@pytest.mark.parametrize("value", [math.inf, 0.5, True, -1, "0", None, 1 << 70])
def test_a_start_that_counts_no_samples_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], value: object
) -> None:
    def change(name: str, data: bytes) -> bytes:
        if name != "start.json":
            return data
        content = json.loads(data)
        content["checkpoint"]["sample"] = value
        return json.dumps(content).encode()

    path = alter(bag, tmp_path / "damaged", attachment=change)
    assert replay_main(["info", str(path)]) == 1
    error = capsys.readouterr().err
    assert "start.json" in error and error.count("\n") == 1
