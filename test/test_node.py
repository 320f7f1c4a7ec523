"""The real node in a process of its own, over real DDS."""

from __future__ import annotations

import json
import math
import signal
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros import recording
from gear_dynamics_ros.messages import TOPICS, resolve
from gear_dynamics_ros.node_topics import COMMANDS, message_type, quality
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.signals import CHANNEL_NAMES, COLUMN

CHUNK = 200
CHUNK_NS = 2_000_000
PATIENCE = 120.0  # a first start compiles the kernel
OUTPUTS = [key for key in TOPICS if key not in COMMANDS and key != "clock"]
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
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard = {key: [] for key in OUTPUTS}
        self.publishers = {}
        for key in OUTPUTS:
            topic = TOPICS[key]
            self.node.create_subscription(
                message_type(topic.type), resolve(topic), self.heard[key].append, quality(topic)
            )
        for key in COMMANDS:
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
        return self.heard[key][known:]

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

    def events(self):
        return [json.loads(message.data) for message in self.heard["event"]]

    def rows(self):
        return np.vstack([np.asarray(m.data).reshape(-1, len(CHANNEL_NAMES)) for m in self.heard["waveform"]])

    def statuses(self):
        (array,) = self.hear("diagnostics")
        return {status.name: status for status in array.status}

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
        module_process, f"recording.path:={bag}", "pacing.real_time_factor:=0.2", "operation.speed:=1000"
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
    for key in [*OUTPUTS, *COMMANDS]:
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
    tasks = ("run", "pacing", "commands", "contacts", "step", "waveform", "recorder", "viewer")
    assert [name.removeprefix("gearbox: ") for name in found] == list(tasks)
    assert found["gearbox: recorder"].level == DiagnosticStatus.OK
    assert found["gearbox: run"].hardware_id == "/gearbox"


def test_time_stands_while_paused_and_step_makes_one_chunk(client):
    assert not client.call(Trigger, "step").success
    assert client.call(SetBool, "pause", SetBool.Request(data=True)).success
    client.until(lambda: client.events()[-1]["event"] == "pause")
    at = client.events()[-1]["sample"]
    client.statuses()
    client.heard["waveform"].clear()
    assert client.call(Trigger, "step").success
    client.until(lambda: client.heard["waveform"])
    client.statuses()
    (message,) = client.heard["waveform"]
    assert round(message.data[0] * 1e5) == at
    assert client.call(SetBool, "pause", SetBool.Request(data=False)).success
    client.hear("waveform", 2)
    np.testing.assert_array_equal(np.rint(client.rows()[:, 0] * 1e5).astype(int)[[CHUNK]], at + CHUNK)


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


def test_parameters_are_described_and_only_the_pace_may_change(client):
    names = list(specifications())
    got = client.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names))
    described = {entry.name: entry for entry in got.descriptors}
    assert described["oil.viscosity"].description.endswith("[Pa s]")
    assert described["gears.driving.teeth"].integer_range[0].from_value == 5
    assert [name for name in names if not described[name].read_only] == ["pacing.real_time_factor"]
    values = client.call(GetParameters, "get_parameters", GetParameters.Request(names=["operation.speed"]))
    assert values.values[0].double_value == 1000.0

    def put(name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return client.call(SetParameters, "set_parameters", request).results[0]

    assert not put("oil.viscosity", 0.1).successful
    assert not put("pacing.real_time_factor", math.nan).successful
    assert put("pacing.real_time_factor", 1).successful
    assert put("pacing.real_time_factor", 0.2).successful


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
        ("recording.path:=/", ["recording.path", "exists"]),
        ("mesh.error_cos:=[]", ["array"]),
    ],
)
def test_a_wrong_parameter_stops_the_start_with_one_line(ros_domain, process, override, words):
    node = gearbox(process, override)
    assert node.wait() == 2
    (line,) = node.stderr.splitlines()
    assert line.startswith("gearbox: error: ") and all(word in line for word in words)
