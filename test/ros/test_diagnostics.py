"""What diagnostics tell of a gearbox in trouble, the trouble being real."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32, Float64

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.topics import CHUNK_TOPICS, COMMAND_TOPICS, TOPICS, full_topic_name
from support.domains import free_port
from support.gearbox import Client, Peer, start_gearbox
from support.paths import CONFIG
from support.processes import StartProcess


def test_coarse_steps_are_told_where_they_matter(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    """Steps of 0.1 ms: of contacts, of the surface's waves, and of what the waveform can show."""
    start_gearbox(
        process,
        "solver.step:=1.0e-4",
        "solver.sample_interval:=1.0e-4",
        "surface.waves:=16",
        "operation.control:=torque",
        "operation.speed:=120.0",
        "pacing.real_time_factor:=0.0",
        f"recording.path:={tmp_path / 'bag'}",
        "recording.mode:=ring",
        "rerun.mode:=serve",
        f"rerun.port:={free_port()}",
        "rerun.web_port:=0",
    )
    with Client() as client:
        client.until(lambda: client.status("contacts")[1]["capped"] != "0")
        found = client.statuses()
    messages = {name: status.message for name, status in found.items()}
    assert messages["contacts"] == "some event searches met their limit"
    assert found["contacts"].level == DiagnosticStatus.OK
    assert found["step"].level == DiagnosticStatus.WARN
    assert "solver.step times the frequency of the shortest wave" in messages["step"]
    assert messages["waveform"].startswith("the highest surface waves lie above half the sampling rate")
    waves = {entry.key: float(entry.value) for entry in found["waveform"].values}
    assert waves["half the sampling rate (Hz)"] == 5000.0
    # 40 teeth, each wave 1.5 times as many as the one before; 120 rad/s
    assert waves["highest surface wave (Hz)"] == pytest.approx(40 * 1.5**15 * 120.0 / 6.283185307, rel=1e-5)
    assert messages["pacing"] == "as fast as possible"
    assert messages["recorder"] == "keeping the ring"
    assert messages["viewer"] == "showing"


def test_a_pace_that_cannot_be_kept_is_too_slow(ros_domain: int, process: StartProcess) -> None:
    start_gearbox(process, "pacing.real_time_factor:=1000.0")
    with Client() as client:
        client.until(lambda: client.status("pacing")[0].message.startswith("too slow"))
        status, values = client.status("pacing")
    assert status.level == DiagnosticStatus.WARN
    assert "lower pacing.real_time_factor or lengthen solver.step" in status.message
    assert values["real-time factor wanted"] == "1000"
    assert int(values["overruns"]) > 0 and float(values["slipped (s)"]) > 0.0


def test_a_disk_that_is_full_soon_is_told_while_there_is_room(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    volume = os.statvfs(tmp_path)
    room = 300_000_000  # B, for less than a minute at the pace of a gearbox in real time
    kept_free = volume.f_bavail * volume.f_frsize - room
    start_gearbox(process, f"recording.path:={tmp_path / 'bag'}", f"recording.minimum_free:={kept_free}")
    with Client() as client:
        client.until(lambda: client.status("recorder")[0].level != DiagnosticStatus.OK)
        status, values = client.status("recorder")
    assert status.level == DiagnosticStatus.WARN
    assert status.message == "the disk is full soon: free space or stop recording"
    assert 0.0 < float(values["seconds_left"]) < 60.0


def test_a_lack_of_commands_is_told_until_one_comes(ros_domain: int, process: StartProcess) -> None:
    start_gearbox(
        process,
        "pacing.real_time_factor:=0.2",
        "operation.command_timeout:=0.2",
        "operation.on_timeout:=release",
        "operation.load_viscous:=0.1",
    )
    with Client() as client:
        client.until(lambda: client.status("commands")[0].level == DiagnosticStatus.WARN)
        status, values = client.status("commands")
        assert status.message == "no command within operation.command_timeout"
        assert values["load_torque (N m)"] == "0"
        assert client.in_force() == Commands(0.0, 0.0, client.in_force().speed)
        # Longer than the test, so that one command is enough.
        assert client.put("operation.command_timeout", 1000.0).successful
        client.command("load_torque_command", Float64(data=12.0))
        client.until(lambda: client.in_force().load_torque == 12.0)
        client.statuses()
        status, values = client.status("commands")
        assert (status.level, status.message) == (DiagnosticStatus.OK, "all good")
        assert values["load_torque (N m)"] == "12"


def test_two_gearboxes_are_told_apart(ros_domain: int, process: StartProcess) -> None:
    rigs = ("/rig1", "/rig2")
    for rig in rigs:
        start_gearbox(process, "pacing.real_time_factor:=0.1", remap=[f"__ns:={rig}"])
    with Client("/rig1/gearbox", hears=["diagnostics"]) as client:
        heard = client.heard["diagnostics"]
        client.until(
            lambda: {message.status[0].hardware_id for message in heard} >= {f"{rig}/gearbox" for rig in rigs}
        )
        tasks = {status.name: status.hardware_id for message in heard for status in message.status}
    assert {name.rpartition(": ")[0] for name in tasks} == {"rig1/gearbox", "rig2/gearbox"}
    assert all(node == f"/{name.rpartition(': ')[0]}" for name, node in tasks.items())


def test_a_publisher_of_another_type_on_a_command_is_told(ros_domain: int, process: StartProcess) -> None:
    node = start_gearbox(process, "pacing.real_time_factor:=0.2")
    with Client(hears=("diagnostics",)) as client, Peer("stranger") as stranger:
        stranger.node.create_publisher(Float32, "/gearbox/command/speed", 1)
        client.until(lambda: client.status("commands")[1]["publishers of another type"])
        status, values = client.status("commands")
    assert values["publishers of another type"] == "/gearbox/command/speed: std_msgs/msg/Float32"
    assert values["several publishers"] == ""
    assert status.level == DiagnosticStatus.WARN
    assert status.message == "a publisher of commands has another type: its messages do not arrive"
    told = "a publisher of std_msgs/msg/Float32, whose messages do not arrive: publish std_msgs/msg/Float64"
    assert node.output.count(f"/gearbox/command/speed has {told}") == 1


def test_the_file_for_ros2_bag_record_has_every_topic_of_a_chunk_deep_enough_for_a_second() -> None:
    found = yaml.safe_load((CONFIG / "rosbag2/qos_overrides.yaml").read_text())
    often = {TOPICS[key] for key in (*COMMAND_TOPICS, *CHUNK_TOPICS, "applied_command")} - {TOPICS["clock"]}
    assert all(topic.reliable for topic in often)
    chunks = round(1.0 / 0.0005)
    assert found == {
        full_topic_name(topic): {
            "history": "keep_last",
            "depth": chunks,
            "reliability": "reliable",
            "durability": "transient_local" if topic.latched else "volatile",
        }
        for topic in often
    }
