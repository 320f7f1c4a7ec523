"""Whatever is done to the real node, at any pace, verifies bit for bit; so does what a kill leaves of it."""

from __future__ import annotations

import random
import signal
from pathlib import Path

import pytest
from std_msgs.msg import Float64

from gear_dynamics_ros import recording
from gear_dynamics_ros.events import (
    CHANGE,
    PAUSE,
    RESET,
    RESTORE,
    RESUME,
)
from gear_dynamics_ros.recording.recover import recover
from gear_dynamics_ros.replay.verify import verify_recording
from support.gearbox import Client, start_gearbox

# The clock comes at every edge of a chunk, states or not.
PACES = {
    "flat out": ("pacing.real_time_factor:=0", "solver.chunk:=0.002", "clock_rate:=500.0"),
    "real time": ("pacing.real_time_factor:=1", "solver.chunk:=0.002", "clock_rate:=500.0"),
    "slow, short chunks": ("pacing.real_time_factor:=0.1", "solver.chunk:=0.0005", "clock_rate:=2000.0"),
    "catching up, compared": (
        "pacing.real_time_factor:=1.5",
        "pacing.on_overrun:=catch_up",
        "solver.chunk:=0.01",
        "clock_rate:=100.0",
        "model:=compared",
        "operation.control:=torque",
    ),
}


def trouble(client: Client, rng: random.Random) -> None:
    """A course of deeds, in an order that differs from pace to pace."""
    numbers = [rng.uniform(10.0, 40.0) for _ in range(6)]
    deeds = {
        "load": lambda: client.command("load_torque_command", Float64(data=numbers[0])),
        "drive": lambda: client.command("drive_torque_command", Float64(data=numbers[1])),
        "speed": lambda: client.command("speed_command", Float64(data=1500.0 + numbers[2])),
        "oil": lambda: client.put("oil.viscosity", numbers[3] / 1000.0),
        "torque": lambda: client.put("operation.control", "torque"),
        "governed": lambda: client.put("operation.control", "speed"),
        "split": lambda: client.trigger("split"),
        "reset": lambda: client.trigger("reset"),
        "save": lambda: client.trigger("save_checkpoint"),
        "halt": lambda: client.switch("pause", True),
        "step": lambda: client.trigger("step"),
        "go": lambda: client.switch("pause", False),
    }
    names = list(deeds)
    paused = ("halt", "step", "go")
    order = [name for name in names if name not in paused]
    rng.shuffle(order)
    at = rng.randrange(len(order))
    for name in [*order[:at], *paused, *order[at:], "restore", "split"]:
        if name == "restore":
            assert client.trigger("restore_checkpoint").success
        else:
            deeds[name]()
        if name not in ("halt", "step"):
            client.hear("waveform", 2)


@pytest.mark.parametrize("pace", PACES)
def test_a_recording_of_the_node_verifies(ros_domain, process, tmp_path: Path, pace: str) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        f"checkpoint.path:={tmp_path / 'state.json'}",
        "recording.checkpoint_interval:=0.1",
        "recording.split_duration:=1.0",
        "stepping.chunks:=3",
        "operation.load_viscous:=0.02",  # torques that don't balance must not run away
        *PACES[pace],
    )
    with Client() as client:
        client.hear("waveform", 2)
        trouble(client, random.Random(pace))
        node.signal(signal.SIGINT)
        assert node.wait() == 0, node.output
    bag = recording.open(tmp_path / "bag")
    assert bag.complete and len(bag.parts) >= 3
    assert {event.kind for event in bag.events} >= {CHANGE, PAUSE, RESUME, RESET, RESTORE}
    result = verify_recording(bag)
    assert result.difference is None
    assert result.samples == bag.end_sample - bag.first_sample
    assert result.states >= len(bag.parts)
    for part in bag.parts:
        assert verify_recording(recording.open(part.path)).difference is None
    assert verify_recording(bag, bag.duration_ns / 2e9).difference is None


def test_what_a_killed_node_leaves_is_recovered_and_verifies(ros_domain, process, tmp_path: Path) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "recording.checkpoint_interval:=0.1",
        "recording.split_duration:=0.5",
        "pacing.real_time_factor:=0.5",
    )
    with Client() as client:
        client.hear("waveform", 100)
        client.command("load_torque_command", Float64(data=40.0))
        flushed = 0
        while flushed < 5000:
            flushed = int(client.status("recorder")[1]["flushed"])
        node.signal(signal.SIGKILL)
        assert node.wait() == -signal.SIGKILL
    assert not recording.open(tmp_path / "bag").complete
    recover(tmp_path / "bag", tmp_path / "whole")
    bag = recording.open(tmp_path / "whole")
    assert bag.complete
    assert sum(topic.messages for topic in bag.topics) >= flushed
    result = verify_recording(bag)
    assert result.difference is None and result.samples == bag.end_sample - bag.first_sample > 0
