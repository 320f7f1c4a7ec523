"""A gearbox with remapped topics: graph, recording and tools agree on the names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.cli.replay import replay_main
from support.gearbox import Client, start_gearbox
from support.processes import StartProcess

RULES = {
    "/gearbox/waveform": "/rig/wf",
    "/gearbox/event": "/rig/notes",
    "/gearbox/command/load_torque": "/rig/load",
    "joint_states": "/rig/joint_states",
}
REMAP = [f"{name}:={new}" for name, new in RULES.items()]
PROFILE = """
commands: {load_torque: [{at: 0.0, value: 20.0}]}
expectations:
  - {name: load applied, every: load_torque, from: 0.2, to: 0.3, target: 20.0, tolerance: 0.0}
"""


def test_a_recording_has_the_names_of_the_graph_and_every_tool_finds_them(
    ros_domain: int, process: StartProcess, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, profile = tmp_path / "bag", tmp_path / "load.yaml"
    profile.write_text(PROFILE)
    node = start_gearbox(process, f"recording.path:={bag}", "pacing.real_time_factor:=0.5", remap=REMAP)
    with Client(hears=["model_info"]) as client:
        client.until(lambda: client.heard["model_info"])
        described = client.info()["topics"]
        graph = {name for name, _ in client.node.get_topic_names_and_types()}
    rules = [word for rule in REMAP for word in ("-r", rule)]
    # The names come from ~/model_info; rules of its own come first.
    for options in ([], ["--lockstep"], ["--ros-args", *rules]):
        run = process("drive", str(profile), *options)
        assert run.wait() == 0, run.output
    assert node.stop() == 0
    new = set(RULES.values())
    assert new <= graph and new <= described.keys()
    assert described["/rig/wf"]["declared"] == "~/waveform"
    with AnyReader([bag]) as reader:
        recorded = set(reader.topics)
    assert new - {"/rig/load"} <= recorded and "/gearbox/waveform" not in recorded
    found = recording.open(bag)
    assert found.end_sample > 0 and found.events and found.topic_names["waveform"] == "/rig/wf"
    assert 20.0 in {commands.load_torque for _, commands in found.commands}
    assert replay_main(["verify", str(bag)]) == 0
    assert analyze_main([str(bag), "--output", str(tmp_path / "figures")]) == 0
    assert json.loads((tmp_path / "figures" / "summary.json").read_text())
    (bag / "metadata.yaml").unlink()
    assert replay_main(["recover", str(bag)]) == 0
    rescued = recording.open(tmp_path / "bag_recovered")
    assert (rescued.end_sample, rescued.topic_names) == (found.end_sample, found.topic_names)
    capfd.readouterr()
    assert replay_main(["info", str(bag)]) == 0
    assert "/rig/wf" in capfd.readouterr().out
