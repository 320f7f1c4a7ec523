"""The real node in a process of its own, over real DDS."""

from __future__ import annotations

import json
import math
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
import rclpy.parameter
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros import recording, replay
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.node_topics import message_type, quality
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.signals import CHANNEL_NAMES, COLUMN, PACE
from gear_dynamics_ros.topics import COMMAND_TOPICS, TOPICS, resolve

CHUNK = 200
CHUNK_NS = 2_000_000
PATIENCE = 120.0  # a first start compiles the kernel
OUTPUTS = [key for key in TOPICS if key not in COMMAND_TOPICS and key != "clock"]
STAMPED = ["joint_states", "driving_bearing_force", "driven_bearing_force"]


def gearbox(start, *overrides):
    arguments = [word for override in overrides for word in ("-p", override)]
    return start(sys.executable, "-m", "gear_dynamics_ros.cli.gearbox", "--ros-args", *arguments)


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Client:
    """Hears everything the node sends, commands it and calls its services."""

    def __init__(self):
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("client", context=self.context)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard = {key: [] for key in OUTPUTS}
        self.publishers = {}
        for key in OUTPUTS:
            topic = TOPICS[key]
            self.node.create_subscription(
                message_type(topic.type), resolve(topic), self.heard[key].append, quality(topic)
            )
        for key in COMMAND_TOPICS:
            topic = TOPICS[key]
            self.publishers[key] = self.node.create_publisher(
                message_type(topic.type), resolve(topic), quality(topic)
            )

    def until(self, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "the awaited never came"
            self.executor.spin_once(timeout_sec=0.1)

    def hear(self, key, count=1):
        """The next ``count`` messages of a topic."""
        known = len(self.heard[key])
        self.until(lambda: len(self.heard[key]) >= known + count)
        return self.heard[key][known : known + count]

    def call(self, kind, name, request=None):
        client = self.node.create_client(kind, f"/gearbox/{name}")
        assert client.wait_for_service(PATIENCE)
        future = client.call_async(request or kind.Request())
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def command(self, key, message):
        self.until(lambda: self.publishers[key].get_subscription_count() > 0)
        self.publishers[key].publish(message)

    def put(self, name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, "set_parameters", request).results[0]

    def get(self, name):
        found = self.call(GetParameters, "get_parameters", GetParameters.Request(names=[name]))
        return rclpy.parameter.parameter_value_to_python(found.values[0])

    def sample(self):
        """Index of the last sample heard of."""
        return round(self.heard["waveform"][-1].data[-len(CHANNEL_NAMES)] * 1e5)

    def events(self):
        return [json.loads(message.data) for message in self.heard["event"]]

    def rows(self):
        return np.vstack([np.asarray(m.data).reshape(-1, len(CHANNEL_NAMES)) for m in self.heard["waveform"]])

    def statuses(self):
        """The latest diagnostics; several may have come at once."""
        self.hear("diagnostics")
        return {status.name: status for status in self.heard["diagnostics"][-1].status}

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return tmp_path_factory.mktemp("node") / "bag"


@pytest.fixture(scope="module")
def node(module_ros_domain, module_process, bag):
    # An integer where a float is meant, as people type it.
    return gearbox(
        module_process,
        f"recording.path:={bag}",
        f"checkpoint.path:={bag}.json",
        "pacing.real_time_factor:=0.2",
        "operation.speed:=1000",
    )


@pytest.fixture(scope="module")
def client(node):
    client = Client()
    client.until(lambda: client.heard["waveform"])
    yield client
    client.close()


def test_every_output_comes_with_one_stamp_per_chunk(client):
    client.until(lambda: all(client.heard[key] for key in OUTPUTS))
    states = client.hear("joint_states", 20)
    assert set(np.diff([stamp_of(message) for message in states])) == {CHUNK_NS}
    assert list(states[0].name) == ["driving", "driven", "mesh"]
    last = stamp_of(states[-1])
    for key in STAMPED:
        client.until(lambda key=key: any(stamp_of(message) == last for message in client.heard[key]))
    assert client.heard["driving_bearing_force"][0].header.frame_id == "driving_bearing"
    layout = client.heard["waveform"][0].layout
    assert layout.dim[0].label == "sample" and layout.dim[1].label == ",".join(CHANNEL_NAMES)


def test_types_and_names_are_those_promised(client):
    offered = dict(client.node.get_topic_names_and_types())
    for key in [*OUTPUTS, *COMMAND_TOPICS]:
        assert offered[resolve(TOPICS[key])] == [TOPICS[key].type]
    assert "/clock" not in offered


def test_the_waveform_loses_and_doubles_no_sample(client):
    client.heard["waveform"].clear()
    client.hear("waveform", 100)
    times = client.rows()[:, 0]
    np.testing.assert_array_equal(np.diff(np.rint(times * 1e5).astype(int)), 1)


def test_a_command_takes_effect_at_a_chunk_edge_and_the_node_says_at_which(client):
    client.hear("waveform")
    client.command("load_torque_command", Float64(data=12.5))
    client.until(lambda: client.heard["applied_command"][-1].effort[1] == 12.5)
    applied = stamp_of(client.heard["applied_command"][-1])
    client.hear("waveform", 2)
    first = stamp_of(client.heard["applied_command"][0])
    sample = round((applied - first) / 10_000)
    rows = client.rows()
    index = np.rint(rows[:, COLUMN["time"]] * 1e5).astype(int)
    load = rows[:, COLUMN["load_torque"]]
    assert np.all(load[index >= sample] == 12.5)
    assert np.all(load[index < sample] == 30.0)
    assert sample % CHUNK == 0 and (index < sample).any()


def test_a_joint_command_changes_what_it_names_and_leaves_the_rest(client):
    message = JointState(name=["driven", "stranger", "driving"])
    message.velocity = [math.nan, 1.0, 900.0]
    message.effort = [14.0, 1.0, math.nan]
    client.command("joint_command", message)
    client.until(lambda: client.heard["applied_command"][-1].velocity[0] == 900.0)
    assert list(client.heard["applied_command"][-1].effort) == [30.0, 14.0]


def test_what_cannot_be_is_refused_and_counted(client, node):
    for key, value in [
        ("load_torque_command", math.nan),
        ("drive_torque_command", math.inf),
        ("speed_command", 5001.0),
    ]:
        client.command(key, Float64(data=value))
    commands = {}
    while commands.get("refused") != "3":
        commands = {entry.key: entry.value for entry in client.statuses()["gearbox: commands"].values}
    assert "speed" in commands["last refusal"]
    assert "refused" in node.wait_for("the last good one stays")
    assert node.wait_for("'stranger'").count("'stranger'") == 1
    assert list(client.heard["applied_command"][-1].effort) == [30.0, 14.0]


def test_diagnostics_tell_every_task(client):
    found = client.statuses()
    tasks = ["run", "pacing", "commands", "contacts", "condition", "step", "waveform", "recorder", "viewer"]
    assert [name.removeprefix("gearbox: ") for name in found] == list(tasks)
    assert found["gearbox: recorder"].level == DiagnosticStatus.OK
    assert {status.hardware_id for status in found.values()} == {"/gearbox"}
    values = {entry.key: entry.value for entry in found["gearbox: recorder"].values}
    assert values["lost"] == "0"


def test_the_condition_is_that_of_the_last_second_heard(client):
    client.until(lambda: client.statuses()["gearbox: condition"].level == DiagnosticStatus.OK)
    values = {entry.key: entry.value for entry in client.statuses()["gearbox: condition"].values}
    assert 0.0 < float(values["looked at (s)"]) <= 1.0
    shares = [float(values[f"share of {state}"]) for state in ("drive flanks", "contact loss", "back flanks")]
    assert sum(shares) == pytest.approx(1.0, abs=1e-5)
    rows = client.rows()
    assert float(values["RMS of DTE (m)"]) <= np.abs(rows[:, COLUMN["dte"]]).max()
    assert float(values["peak bearing force, driven (N)"]) > 0.0


def test_the_pacing_is_published(client):
    (message,) = client.hear("pacing")
    columns = message.layout.dim[1].label.split(",")
    row = dict(zip(columns, message.data, strict=True))
    assert columns == [entry.name for entry in PACE]
    assert row["real_time_factor_wanted"] == 0.2 and row["real_time_factor"] > 0.0


def test_the_model_is_described_to_whoever_comes_late(client):
    topic = TOPICS["model_info"]
    told = []
    late = client.node.create_subscription(
        message_type(topic.type), resolve(topic), told.append, quality(topic)
    )
    client.until(lambda: told)
    client.node.destroy_subscription(late)
    info = json.loads(told[0].data)
    assert [entry["name"] for entry in info["waveform"]] == list(CHANNEL_NAMES)
    assert info["waveform"][1]["unit"] == "m"
    assert info["frames"] == ["driving_bearing", "driven_bearing"]
    assert info["parameters"]["operation.speed"] == 1000.0
    client.hear("joint_states")
    last = stamp_of(client.heard["joint_states"][-1]) - info["epoch_ns"]
    assert last % info["sample_interval_ns"] == 0 and last < 3600 * 10**9


def test_time_stands_while_paused_and_step_makes_the_chunks_wanted(client):
    assert not client.call(Trigger, "step").success
    assert client.call(SetBool, "pause", SetBool.Request(data=True)).success
    client.until(lambda: client.events()[-1]["event"] == "pause")
    at = client.events()[-1]["sample"]
    client.until(lambda: client.statuses()["gearbox: pacing"].level == DiagnosticStatus.STALE)
    client.heard["waveform"].clear()
    assert client.call(Trigger, "step").success
    client.until(lambda: client.heard["waveform"])
    client.statuses()
    (message,) = client.heard["waveform"]
    assert round(message.data[0] * 1e5) == at
    assert client.put("stepping.chunks", 7).successful
    answer = client.call(Trigger, "step")
    assert answer.success and float(answer.message.split()[1]) == pytest.approx((at + 8 * CHUNK) / 1e5)
    client.until(lambda: client.sample() == at + 8 * CHUNK - 1)
    assert client.call(SetBool, "pause", SetBool.Request(data=False)).success
    client.hear("waveform", 2)
    np.testing.assert_array_equal(np.diff(np.rint(client.rows()[:, 0] * 1e5).astype(int)), 1)


def test_steps_are_aborted_by_whoever_resumes_and_time_out(client):
    assert client.call(SetBool, "pause", SetBool.Request(data=True)).success
    assert client.put("stepping.chunks", 1_000_000).successful
    stepper = client.node.create_client(Trigger, "/gearbox/step")
    assert stepper.wait_for_service(PATIENCE)
    steps = stepper.call_async(Trigger.Request())
    client.hear("waveform", 3)
    again = client.call(Trigger, "step")
    assert not again.success and "stepping already" in again.message
    assert not steps.done()
    assert client.call(SetBool, "pause", SetBool.Request(data=False)).success
    client.until(steps.done)
    assert not steps.result().success and "aborted: resumed" in steps.result().message
    assert client.call(SetBool, "pause", SetBool.Request(data=True)).success
    assert client.put("stepping.timeout", 0.05).successful
    late = client.call(Trigger, "step")
    assert not late.success and "stepping.timeout" in late.message
    assert client.call(SetBool, "pause", SetBool.Request(data=False)).success
    client.node.destroy_client(stepper)


def test_reset_goes_back_to_the_start_state_while_time_goes_on(client):
    assert client.call(Trigger, "reset").success
    client.until(lambda: client.events()[-1]["event"] == "reset")
    at = client.events()[-1]["sample"]
    client.until(lambda: round(client.heard["waveform"][-1].data[0] * 1e5) >= at)
    rows = client.rows()
    (row,) = rows[np.rint(rows[:, 0] * 1e5).astype(int) == at]
    assert row[COLUMN["driving_x"]] == 0.0
    assert row[COLUMN["driving_speed"]] == 1000.0
    assert row[COLUMN["load_torque"]] == 30.0


def test_parameters_are_described_and_those_that_are_fixed_say_so(client):
    rows = specifications()
    got = client.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=list(rows)))
    described = {entry.name: entry for entry in got.descriptors}
    assert described["oil.viscosity"].description.endswith("[Pa s]")
    assert described["gears.driving.teeth"].integer_range[0].from_value == 5
    assert {name: not described[name].read_only for name in rows} == {
        name: row.runtime for name, row in rows.items()
    }
    assert client.get("operation.speed") == 1000.0
    assert "read-only" in client.put("solver.step", 2e-6).reason
    assert not client.put("pacing.real_time_factor", math.nan).successful
    assert "beyond operation.speed_limit" in client.put("operation.speed", 5001).reason
    assert client.put("mesh.error_sin", [0, 0]).successful
    assert client.put("surface.driven.roughness", "8e-07").successful
    assert client.get("surface.driven.roughness") == 8e-7
    assert not client.put("oil.viscosity", "thick").successful
    assert "must stay false" in client.put("use_sim_time", True).reason


def test_parameters_change_at_a_chunk_edge_all_or_none_and_are_recorded(client):
    def both(**values):
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name.replace("__", "."), value=value).to_parameter_msg()
                for name, value in values.items()
            ]
        )
        return client.call(SetParametersAtomically, "set_parameters_atomically", request).result

    assert not both(oil__viscosity=0.05, operation__speed=6000.0).successful
    assert client.get("oil.viscosity") == 0.0228
    assert both(oil__viscosity=0.05, operation__load_torque=17, mesh__stiffness_cos=[0.05, 0.01]).successful
    client.until(lambda: client.events()[-1]["event"] == "parameters")
    change = client.events()[-1]
    assert change["parameters"] == {
        "mesh.stiffness_cos": [0.05, 0.01],
        "oil.viscosity": 0.05,
        "operation.load_torque": 17.0,
    }
    client.until(lambda: client.sample() >= change["sample"])
    rows = client.rows()
    index = np.rint(rows[:, 0] * 1e5).astype(int)
    load = rows[:, COLUMN["load_torque"]]
    assert change["sample"] % CHUNK == 0
    assert np.all(load[index >= change["sample"]] == 17.0) and 17.0 not in load[index < change["sample"]]
    client.until(
        lambda: json.loads(client.heard["model_info"][-1].data)["parameters"]["oil.viscosity"] == 0.05
    )


def test_control_is_switched_without_a_jump_of_torque(client):
    for control in ("torque", "speed"):
        assert client.put("operation.control", control).successful
        client.until(lambda: client.events()[-1]["event"] == "parameters")
        at = client.events()[-1]["sample"]
        client.until(lambda at=at: client.sample() > at)
        rows = client.rows()
        torque = rows[:, COLUMN["drive_torque"]]
        edge = int(np.searchsorted(np.rint(rows[:, 0] * 1e5), at))
        # The governor itself moves by less than its proportional part of a sample's change of speed.
        assert torque[edge] == pytest.approx(torque[edge - 1], abs=1.0)


def test_a_checkpoint_is_saved_and_restored_with_its_parameters_and_commands(client, bag):
    client.command("joint_command", JointState(name=["driven"], effort=[42.0]))
    client.until(lambda: client.heard["applied_command"][-1].effort[1] == 42.0)
    saved = client.call(Trigger, "save_checkpoint")
    assert saved.success and f"{bag}.json" in saved.message
    taken = json.loads(bag.with_name("bag.json").read_text())["checkpoint"]
    assert float(saved.message.split()[-2]) == pytest.approx(taken["sample"] * 1e-5)
    client.until(lambda: client.sample() >= taken["sample"])
    other = {"oil.viscosity": 0.001, "mesh.error_cos": [1e-6], "operation.load_torque": 33.0}
    before = {name: client.get(name) for name in other}
    for name, value in other.items():
        assert client.put(name, value).successful
    client.heard["event"].clear()
    restored = client.call(Trigger, "restore_checkpoint")
    assert restored.success, restored.message
    client.until(lambda: client.events()[-1]["event"] == "restore")
    at = client.events()[-1]["sample"]
    client.until(lambda: client.sample() >= max(at, taken["sample"]) + CHUNK)
    assert {name: client.get(name) for name in other} == before
    assert [event["event"] for event in client.events()] == ["parameters", "restore"]
    rows = client.rows()
    index = np.rint(rows[:, 0] * 1e5).astype(int)
    (old,), (new,) = rows[index == taken["sample"]], rows[index == at]
    np.testing.assert_array_equal(old[1:], new[1:])
    assert rows[-1][COLUMN["load_torque"]] == 42.0


def test_what_is_no_message_is_refused_and_counted(client, node):
    def refused():
        commands = {entry.key: entry.value for entry in client.statuses()["gearbox: commands"].values}
        return int(commands["refused"])

    known = refused()
    client.publishers["load_torque_command"].publish(b"\x00\x01\x00\x00\x01")
    client.until(lambda: refused() > known)
    assert "no std_msgs/msg/Float64" in node.output


def test_without_a_ring_there_is_no_snapshot(client, node):
    answer = client.call(Trigger, "snapshot")
    assert not answer.success and "recording.mode = 'ring'" in answer.message


def test_recording_can_be_split_switched_off_and_on(client, bag, process):
    assert client.call(Trigger, "split").success
    assert client.call(SetBool, "record", SetBool.Request(data=False)).success
    assert not client.call(Trigger, "split").success
    first = recording.open(bag)
    assert first.complete and len(first.parts) == 2
    assert first.commands[0][0] == 0 and {event.kind for event in first.events} >= {"start", "pause", "reset"}
    assert next(first.messages("load_torque_command"))[1].data == 12.5
    verified = process(sys.executable, "-m", "gear_dynamics_ros.cli.replay", "verify", bag)
    # A client that does not listen meanwhile loses what exceeds the depth of its queue.
    client.until(lambda: verified.returncode is not None)
    assert verified.wait() == 0, verified.output
    times = first.waveform()[:, 0]
    np.testing.assert_array_equal(np.rint(times * 1e5).astype(int), np.arange(len(times)))
    assert client.call(SetBool, "record", SetBool.Request(data=True)).message.endswith("bag_2")


def test_deactivating_loses_no_sample(client):
    def change(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert client.call(ChangeState, "change_state", request).success

    client.heard["waveform"].clear()
    client.hear("waveform")
    change(Transition.TRANSITION_DEACTIVATE)
    assert not client.call(Trigger, "reset").success
    change(Transition.TRANSITION_ACTIVATE)
    client.hear("waveform", 3)
    np.testing.assert_array_equal(np.diff(np.rint(client.rows()[:, 0] * 1e5).astype(int)), 1)


def test_sigint_twice_leaves_a_complete_recording(client, node, bag):
    client.hear("waveform", 5)
    node.signal(signal.SIGINT)
    node.signal(signal.SIGINT)
    assert node.wait() == 0
    found = recording.open(bag.with_name("bag_2"))
    assert found.complete
    assert (bag.with_name("bag_2") / "metadata.yaml").exists()
    assert found.events[-1].kind == "end" and found.events[-1].message == "SIGINT"


def test_the_node_can_be_cleaned_up_and_brought_up_again(ros_domain, process, tmp_path):
    bag = tmp_path / "bag"
    node = gearbox(process, f"recording.path:={bag}", "autostart:=false", "pacing.real_time_factor:=0.2")
    client = Client()
    try:
        for _ in range(2):
            for transition in (
                Transition.TRANSITION_CONFIGURE,
                Transition.TRANSITION_ACTIVATE,
                Transition.TRANSITION_DEACTIVATE,
                Transition.TRANSITION_CLEANUP,
            ):
                request = ChangeState.Request(transition=Transition(id=transition))
                assert client.call(ChangeState, "change_state", request).success
                if transition == Transition.TRANSITION_ACTIVATE:
                    client.hear("waveform", 2)
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_UNCONFIGURED_SHUTDOWN))
        assert client.call(ChangeState, "change_state", request).success
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    finally:
        client.close()
    for path in (bag, tmp_path / "bag_2"):
        found = recording.open(path)
        assert found.complete and found.first_sample == 0
        assert found.events[-1].message == "cleaned up"


def test_a_trip_is_told_and_a_reset_recovers(ros_domain, process, tmp_path):
    node = gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "operation.control:=torque",
        "operation.load_torque:=0.0",
        "operation.speed_limit:=1640.0",
    )
    assert "does not balance" in node.wait_for("run ended: over-speed")
    client = Client()
    try:
        client.until(lambda: client.heard["diagnostics"])
        assert client.statuses()["gearbox: run"].level == DiagnosticStatus.ERROR
        tripped = recording.open(tmp_path / "bag")
        assert tripped.complete and "operation.speed_limit" in tripped.events[-1].message
        assert not client.call(SetBool, "pause", SetBool.Request(data=False)).success
        answer = client.call(Trigger, "reset")
        assert answer.success and answer.message.endswith("bag_2")
        # The torques still don't balance, so the new run may have tripped before we look.
        client.until(lambda: client.heard["waveform"])
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    finally:
        client.close()
    again = recording.open(tmp_path / "bag_2")
    assert again.complete and len(again.waveform()) > 0


def test_duration_ends_the_node_with_a_complete_recording(ros_domain, process, tmp_path):
    node = gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "pacing.duration:=0.0501",
        "pacing.real_time_factor:=0",
    )
    assert node.wait() == 0
    found = recording.open(tmp_path / "bag")
    assert found.complete and len(found.waveform()) == 5010


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("gears.driving.teth:=40", ["gears.driving.teth", "gears.driving.teeth"]),
        ("oil.viscosity:=.nan", ["oil.viscosity", "nan"]),
        ("operation.speed:=6000.0", ["operation.speed", "6000", "speed_limit"]),
        ("checkpoint.path:=/nowhere/state.json", ["checkpoint.path", "/nowhere", "does not exist"]),
        ("mesh.error_cos:=[]", ["array"]),
        ("qos_overrides./gearbox/dte.publisher.reliability:=sometimes", ["qos_overrides", "reliability"]),
    ],
)
def test_a_wrong_parameter_stops_the_start_with_one_line(ros_domain, process, override, words):
    node = gearbox(process, override)
    assert node.wait() == 2
    (line,) = node.stderr.splitlines()
    assert line.startswith("gearbox: error: ") and all(word in line for word in words)


@pytest.mark.parametrize("what", ["exists", "can't be written", "has no room"])
def test_a_recording_that_cannot_begin_leaves_the_gearbox_running(ros_domain, process, tmp_path, what):
    (tmp_path / "there").write_text("mine")
    path, told, free = {
        "exists": (tmp_path / "there", "exists already and recordings never overwrite", 0),
        "can't be written": (tmp_path / "there" / "bag", "Not a directory: choose a writable place", 0),
        "has no room": (tmp_path / "bag", "less than recording.minimum_free", 1 << 50),
    }[what]
    node = gearbox(process, f"recording.path:={path}", f"recording.minimum_free:={free}")
    client = Client()
    try:
        client.hear("waveform", 5)
        found = client.statuses()["gearbox: recorder"]
        assert found.level == DiagnosticStatus.ERROR and told in found.message
        assert node.output.count("recording.path: ") == 1
        if what == "exists":
            # another place beside it is free
            answer = client.call(SetBool, "record", SetBool.Request(data=True))
            assert answer.success and answer.message.endswith("there_2")
            client.until(lambda: client.statuses()["gearbox: recorder"].level == DiagnosticStatus.OK)
        node.signal(signal.SIGINT)
        assert node.wait() == 1
    finally:
        client.close()
    assert (tmp_path / "there").read_text() == "mine"


def test_a_ring_is_written_when_asked_for_and_when_the_run_ends_by_a_fault(ros_domain, process, tmp_path):
    node = gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "recording.mode:=ring",
        "recording.ring_duration:=0.2",
        "recording.split_duration:=0.1",
    )
    client = Client()
    try:
        client.hear("waveform", 5)
        assert not (tmp_path / "bag").exists()
        for name in ("bag", "bag_2"):
            answer = client.call(Trigger, "snapshot")
            assert answer.success and answer.message == f"recorded {tmp_path / name}"

        def told(key):
            return {entry.key: entry.value for entry in client.statuses()["gearbox: recorder"].values}[key]

        client.until(lambda: told("last snapshot") == str(tmp_path / "bag_2"))
        assert int(told("ring (bytes)")) > 0
        # Beside the ring everything may be recorded for a while.
        assert client.call(SetBool, "record", SetBool.Request(data=True)).message.endswith("bag_3")
        client.hear("waveform", 100)
        assert client.call(SetBool, "record", SetBool.Request(data=False)).success
        assert client.put("operation.speed_limit", 1625.0).successful
        client.put("operation.speed", 1624.9)
        client.put("operation.governor.proportional", 50.0)
        node.wait_for(f"what led to it is in {tmp_path / 'bag_4'}")
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    finally:
        client.close()
    for name in ("bag", "bag_2", "bag_3", "bag_4"):
        found = recording.open(tmp_path / name)
        assert found.complete
        assert replay.verify(found).difference is None
    assert "over-speed" in found.events[-1].message
    assert 0.2 <= found.duration_ns / 1e9 <= 0.23
    assert len(recording.open(tmp_path / "bag_3").parts) >= 2
    with pytest.raises(GearboxError, match="no recording"):
        recording.open(tmp_path / "bag_5")


def test_an_overrun_ends_the_run_where_that_is_wanted(ros_domain, process, tmp_path):
    node = gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "pacing.real_time_factor:=1000.0",
        "pacing.on_overrun:=error",
    )
    assert "call ~/reset" in node.wait_for("run ended: overrun")
    node.signal(signal.SIGTERM)
    assert node.wait() == 0
    found = recording.open(tmp_path / "bag")
    assert found.complete and "pacing.on_overrun" in found.events[-1].message


def test_a_pace_that_can_be_kept_has_no_overrun_to_end_the_run(ros_domain, process):
    node = gearbox(process, "pacing.real_time_factor:=0.02", "pacing.on_overrun:=error")
    client = Client()
    try:
        client.hear("waveform", 5)
        assert "overrun" not in node.output
    finally:
        client.close()


def test_a_recording_switched_off_stays_off_after_a_trip(ros_domain, process, tmp_path):
    node = gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "operation.control:=torque",
        "operation.load_torque:=0.0",
        "pacing.real_time_factor:=0.2",
    )
    client = Client()
    try:
        client.hear("waveform")
        assert client.call(SetBool, "record", SetBool.Request(data=False)).success
        node.wait_for("run ended: over-speed")
        # Higher than the limit that ended it, so that the reset can last.
        assert client.put("operation.speed_limit", 1e5).successful
        answer = client.call(Trigger, "reset")
        assert answer.success and "recording" not in answer.message
        client.hear("waveform")
    finally:
        client.close()
    assert not (tmp_path / "bag_2").exists()


def test_the_clock_runs_at_its_own_rate_and_two_publishers_are_told_once(ros_domain, process):
    node = gearbox(process, "clock_rate:=50.0", "joint_prefix:=left_", "pacing.real_time_factor:=0.5")
    client = Client()
    try:
        clock = []
        topic = TOPICS["clock"]
        client.node.create_subscription(message_type(topic.type), "/clock", clock.append, quality(topic))
        client.node.create_publisher(Float64, "/gearbox/command/load_torque", 10)
        client.until(lambda: len(clock) > 20)
        times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clock]
        assert min(np.diff(times)) >= 20_000_000
        (state,) = client.hear("joint_states")
        assert list(state.name) == ["left_driving", "left_driven", "left_mesh"]
        crowded = ""
        while crowded != "/gearbox/command/load_torque":
            status = client.statuses()["gearbox: commands"]
            crowded = next(entry.value for entry in status.values if entry.key == "several publishers")
        assert status.level == DiagnosticStatus.WARN
        client.statuses()
        assert node.output.count("has several publishers") == 1
    finally:
        client.close()


def test_quality_of_service_can_be_overridden(ros_domain, process):
    gearbox(process, "qos_overrides./gearbox/dte.publisher.reliability:=best_effort")
    client = Client()

    def offered(name):
        found = client.node.get_publishers_info_by_topic(name)
        return [endpoint.qos_profile.reliability for endpoint in found]

    try:
        client.until(lambda: offered("/gearbox/dte") and offered("/gearbox/mesh_force"))
        assert offered("/gearbox/dte") == [ReliabilityPolicy.BEST_EFFORT]
        assert offered("/gearbox/mesh_force") == [ReliabilityPolicy.RELIABLE]
    finally:
        client.close()


def test_a_recording_that_could_not_begin_can_begin_later(ros_domain, process, tmp_path):
    path = tmp_path / "bag"
    path.mkdir()
    node = gearbox(process, f"recording.path:={path}", "pacing.real_time_factor:=0.2")
    client = Client()
    try:
        client.hear("waveform")
        node.wait_for("recordings never overwrite")
        path.rmdir()
        assert client.call(SetBool, "record", SetBool.Request(data=True)).message == f"recording to {path}"
        client.hear("waveform")
    finally:
        client.close()


def test_transitions_repeated_leave_nothing_behind(ros_domain, process):
    node = gearbox(process, "autostart:=false", "pacing.real_time_factor:=0.2")
    client = Client()
    switch = client.node.create_client(ChangeState, "/gearbox/change_state")
    cycle = (
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
    )

    def cycles(count):
        for transition in cycle * count:
            answer = switch.call_async(ChangeState.Request(transition=Transition(id=transition)))
            client.until(answer.done)
            assert answer.result().success
        return sum(len(list(Path(f"/proc/{node.pid}/{what}").iterdir())) for what in ("fd", "task"))

    try:
        assert switch.wait_for_service(PATIENCE)
        early = cycles(5)
        # DDS has a thread or a descriptor more or less at any moment; what stays behind adds up to 40.
        assert cycles(40) < early + 10
    finally:
        client.close()
