"""The real node in a process of its own, over real DDS."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import DescribeParameters
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN, PACE
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import stamp_ns
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.topics import COMMAND_TOPICS, TOPICS, full_topic_name
from support.gearbox import INTERVAL_NS, OUTPUTS, PATIENCE, Client, Peer, shared_gearbox, start_gearbox
from support.processes import Process, StartProcess

CHUNK = 200
CHUNK_NS = 2_000_000
STAMPED = ["joint_states", "driving_bearing_force", "driven_bearing_force"]


class Shared(NamedTuple):
    """A running gearbox that records, and how it was before each test."""

    process: Process
    client: Client
    parameters: dict[str, Any]
    bag: Path


@pytest.fixture(scope="module")
def shared(
    module_ros_domain: int, module_process: StartProcess, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Shared]:
    """At a fifth of real time, so that nothing is missed on a busy machine."""
    bag = tmp_path_factory.mktemp("node") / "bag"
    words = (
        f"recording.path:={bag}",
        f"checkpoint.path:={bag}.json",
        "pacing.real_time_factor:=0.2",
        "operation.speed:=1000",  # an integer where a float is meant, as people type it
    )
    with shared_gearbox(module_process, *words) as (process, client, parameters):
        yield Shared(process, client, parameters, bag)


@pytest.fixture
def node(shared: Shared) -> Process:
    return shared.process


@pytest.fixture
def client(shared: Shared) -> Client:
    """Beside the shared gearbox, which has just begun anew with the parameters it was started with."""
    shared.client.put_back(shared.parameters)
    return shared.client


def test_every_output_comes_with_one_stamp_per_chunk(client: Client) -> None:
    client.until(lambda: all(client.heard[key] for key in OUTPUTS))
    states = client.hear("joint_states", 20)
    assert set(np.diff([stamp_ns(message.header.stamp) for message in states])) == {CHUNK_NS}
    assert list(states[0].name) == ["driving", "driven", "mesh"]
    last = states[-1].header.stamp
    for key in STAMPED:
        client.until(lambda key=key: any(message.header.stamp == last for message in client.heard[key]))
    assert client.heard["driving_bearing_force"][0].header.frame_id == "driving_bearing"
    assert client.heard["driven_bearing_force"][0].header.frame_id == "driven_bearing"
    layout = client.heard["waveform"][0].layout
    assert layout.dim[0].label == "sample" and layout.dim[1].label == ",".join(CHANNEL_NAMES)


def test_types_and_names_are_those_promised(client: Client) -> None:
    offered = dict(client.node.get_topic_names_and_types())
    for key in [*OUTPUTS, *COMMAND_TOPICS]:
        assert offered[full_topic_name(TOPICS[key])] == [TOPICS[key].type]
    assert "/clock" not in offered


def test_the_waveform_loses_and_doubles_no_sample(client: Client) -> None:
    client.hear("waveform", 100)
    indices = client.indices()
    assert len(indices) >= 100 * CHUNK
    np.testing.assert_array_equal(np.diff(indices), 1)


def test_a_command_takes_effect_at_a_chunk_edge_and_the_node_says_at_which(client: Client) -> None:
    client.hear("waveform")
    client.command("load_torque_command", Float64(data=12.5))
    client.until(lambda: client.in_force().load_torque == 12.5)
    sample = client.sample_at(client.heard["applied_command"][-1].header.stamp)
    client.until(lambda: client.sample() > sample)
    index, load = client.indices(), client.rows()[:, COLUMN["load_torque"]]
    assert sample % CHUNK == 0 and (index < sample).any()
    assert np.all(load[index >= sample] == 12.5)
    assert np.all(load[index < sample] == 30.0)


def test_a_joint_command_changes_what_it_names_and_leaves_the_rest(client: Client, node: Process) -> None:
    message = JointState(name=["driven", "joint of others", "driving"])
    message.velocity = [math.nan, 1.0, 900.0]
    message.effort = [14.0, 1.0, math.nan]
    for _ in range(2):
        client.command("joint_command", message)
        client.until(lambda: client.in_force() == Commands(30.0, 14.0, 900.0))
        message.effort[0] += 1.0
        client.command("joint_command", message)
        client.until(lambda: client.in_force() == Commands(30.0, 15.0, 900.0))
        message.effort[0] -= 1.0
    assert node.wait_for("'joint of others'").count("'joint of others'") == 1


def refused(client: Client) -> int:
    return int(client.status("commands")[1]["refused"])


def test_what_cannot_be_is_refused_and_counted(client: Client, node: Process) -> None:
    before = refused(client)
    for key, value in [
        ("load_torque_command", math.nan),
        ("drive_torque_command", math.inf),
        ("speed_command", 5001.0),
    ]:
        client.command(key, Float64(data=value))
    client.until(lambda: refused(client) == before + 3)
    status, values = client.status("commands")
    assert status.level == DiagnosticStatus.OK and status.message == f"{before + 3} refused"
    refusal = values["last refusal"]
    assert "speed" in refusal and "5001" in refusal and "not within -5000 to 5000" in refusal
    assert "refused" in node.wait_for("the last good one stays")
    assert client.in_force() == Commands(30.0, 30.0, 1000.0)


def test_what_is_no_message_is_refused_and_counted(client: Client, node: Process) -> None:
    before = refused(client)
    client.until(lambda: client.publishers["load_torque_command"].get_subscription_count() > 0)
    client.publishers["load_torque_command"].publish(b"\x00\x01\x00\x00\x01")
    client.until(lambda: refused(client) == before + 1)
    assert (
        "/gearbox/command/load_torque: message refused: not valid CDR of std_msgs/msg/Float64" in node.output
    )


def test_diagnostics_tell_every_task(client: Client) -> None:
    found = client.statuses()
    tasks = ["run", "pacing", "commands", "contacts", "condition", "step", "waveform", "recorder", "viewer"]
    assert list(found) == tasks
    messages = {name: status.message for name, status in found.items()}
    del (
        messages["pacing"],
        messages["condition"],
        messages["commands"],
    )  # as fast as the machine, too early, so far
    assert messages == {
        "run": "running",
        "contacts": "all events located",
        "step": "the step bears every rate",
        "waveform": "the highest surface waves lie above half the sampling rate: they alias in the waveform",
        "recorder": "recording",
        "viewer": "off",
    }
    assert {found[name].level for name in messages} == {DiagnosticStatus.OK}
    assert {status.hardware_id for status in found.values()} == {"/gearbox"}
    assert {entry.key: entry.value for entry in found["recorder"].values}["lost"] == "0"


def test_the_condition_is_that_of_the_samples_heard(client: Client) -> None:
    client.until(lambda: client.status("condition")[0].level == DiagnosticStatus.OK)
    assert client.switch("pause", True).success
    client.until(lambda: client.status("condition")[0].level == DiagnosticStatus.STALE)
    client.until(lambda: client.sample() == client.events()[-1]["sample"] - 1)
    status, values = client.status("condition")
    assert status.message == "paused"
    rows = client.rows()
    # Since the reset, in stretches of a fiftieth of a second; fifty are looked at.
    rows = rows[: len(rows) // 2000 * 2000][-100_000:]
    dte, state = rows[:, COLUMN["dte"]], rows[:, COLUMN["meshing_state"]]
    assert float(values["looked at (s)"]) == pytest.approx(len(rows) * 1e-5, rel=5e-3)
    assert float(values["mean DTE (m)"]) == pytest.approx(dte.mean(), rel=1e-5)
    assert float(values["RMS of DTE (m)"]) == pytest.approx(np.sqrt(np.mean(dte**2)), rel=1e-5)
    for name, flank in (("drive flanks", 1.0), ("contact loss", 0.0), ("back flanks", -1.0)):
        assert float(values[f"share of {name}"]) == pytest.approx(np.mean(state == flank), abs=1e-5)
    for gear in ("driving", "driven"):
        x, y = (
            rows[:, COLUMN[f"{gear}_contact_force_{axis}"]] + rows[:, COLUMN[f"{gear}_film_force_{axis}"]]
            for axis in "xy"
        )
        peak = float(values[f"peak bearing force, {gear} (N)"])
        assert peak == pytest.approx(np.hypot(x, y).max(), rel=1e-5)


def test_the_pacing_is_published(client: Client) -> None:
    (message,) = client.hear("pacing")
    columns = message.layout.dim[1].label.split(",")
    row = dict(zip(columns, message.data, strict=True))
    assert columns == [entry.name for entry in PACE]
    assert row["real_time_factor_wanted"] == 0.2 and row["real_time_factor"] > 0.0


def test_the_model_is_described_to_whoever_comes_late(client: Client) -> None:
    told: list[Any] = []
    late = client.subscribe("model_info", told.append)
    client.until(lambda: told)
    client.node.destroy_subscription(late)
    assert told[-1].data == client.heard["model_info"][-1].data
    info = client.info()
    assert [entry["name"] for entry in info["waveform"]] == list(CHANNEL_NAMES)
    assert info["waveform"][1]["unit"] == "m"
    assert info["frames"] == ["driving_bearing", "driven_bearing"]
    assert info["parameters"]["operation.speed"] == 1000.0
    assert info["sample_interval_ns"] == INTERVAL_NS
    # A stamp is the epoch and the simulated time of the chunk's last sample.
    (waveform,) = client.hear("waveform")
    client.until(lambda: client.heard["joint_states"])
    stamps = [client.sample_at(message.header.stamp) for message in client.heard["joint_states"]]
    last = round(waveform.data[-len(CHANNEL_NAMES)] * 1e9 / INTERVAL_NS)
    assert last % CHUNK == CHUNK - 1 and {stamp % CHUNK for stamp in stamps} == {CHUNK - 1}


def test_time_stands_while_paused_and_step_makes_the_chunks_wanted(client: Client) -> None:
    refusal = client.trigger("step")
    assert not refusal.success and "not paused" in refusal.message
    assert client.switch("pause", True).success
    client.until(lambda: client.events()[-1]["event"] == "pause")
    at = client.events()[-1]["sample"]
    client.until(lambda: client.status("pacing")[0].level == DiagnosticStatus.STALE)
    client.until(lambda: client.sample() == at - 1)
    assert client.trigger("step").success
    client.until(lambda: client.sample() > at)
    client.statuses()
    assert client.sample() == at + CHUNK - 1
    assert client.put("stepping.chunks", 7).successful
    answer = client.trigger("step")
    assert answer.success and float(answer.message.split()[1]) == pytest.approx((at + 8 * CHUNK) / 1e5)
    client.until(lambda: client.sample() == at + 8 * CHUNK - 1)
    assert client.switch("pause", False).success
    client.hear("waveform", 2)
    np.testing.assert_array_equal(np.diff(client.indices()), 1)


def test_steps_are_aborted_by_whoever_resumes(client: Client) -> None:
    assert client.switch("pause", True).success
    assert client.put("stepping.chunks", 1_000_000).successful
    steps = client.ask(Trigger, "step")
    client.hear("waveform", 3)
    again = client.trigger("step")
    assert not again.success and "stepping already" in again.message
    assert not steps.done()
    assert client.switch("pause", False).success
    client.until(steps.done)
    assert not steps.result().success and "aborted: resumed" in steps.result().message


def test_steps_time_out(client: Client) -> None:
    assert client.switch("pause", True).success
    assert client.put_all({"stepping.chunks": 1_000_000, "stepping.timeout": 0.05}).successful
    late = client.trigger("step")
    assert not late.success and "stepping.timeout" in late.message
    assert client.switch("pause", False).success


def test_reset_goes_back_to_the_start_state_while_time_goes_on(client: Client) -> None:
    client.command("joint_command", JointState(name=["driven"], effort=[35.0]))
    client.until(lambda: client.in_force().load_torque == 35.0)
    known = len(client.heard["event"])
    assert client.trigger("reset").success
    client.until(lambda: len(client.heard["event"]) > known)
    event = client.events()[-1]
    at = event["sample"]
    assert event["event"] == "reset"
    client.until(lambda: client.sample() >= at)
    (row,) = client.rows()[client.indices() == at]
    assert row[COLUMN["driving_x"]] == 0.0
    assert row[COLUMN["driving_speed"]] == 1000.0
    assert row[COLUMN["load_torque"]] == 30.0
    assert client.in_force() == Commands(30.0, 30.0, 1000.0)
    np.testing.assert_array_equal(np.diff(client.indices()), 1)


def test_parameters_are_described_and_those_that_are_fixed_say_so(client: Client) -> None:
    rows = specifications()
    got = client.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=list(rows)))
    described = {entry.name: entry for entry in got.descriptors}
    assert described["oil.viscosity"].description.endswith("[Pa s]")
    assert described["gears.driving.teeth"].integer_range[0].from_value == 5
    assert {name: not described[name].read_only for name in rows} == {
        name: row.runtime for name, row in rows.items()
    }
    assert client.get("operation.speed") == 1000.0


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("solver.step", 1e-6, "read-only"),
        ("pacing.real_time_factor", math.nan, "pacing.real_time_factor"),
        ("operation.speed", 5001, "beyond operation.speed_limit"),
        ("oil.viscosity", "thick", "expected 'Type.DOUBLE'"),
        ("use_sim_time", True, "must stay false"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_with_the_reason(
    client: Client, name: str, value: Any, said: str
) -> None:
    before = client.get(name)
    result = client.put(name, value)
    assert not result.successful and said in result.reason
    assert client.get(name) == before


def test_a_parameter_that_does_not_exist_is_refused_by_its_name(client: Client) -> None:
    result = client.put("oil.viscosty", 0.03)
    assert not result.successful
    assert result.reason == "there is no parameter oil.viscosty: did you mean oil.viscosity?"
    before = client.get("oil.viscosity")
    result = client.put_all({"oil.viscosity": before * 2.0, "oil": 1.0})
    assert not result.successful and result.reason.startswith("oil is a group, not a parameter")
    assert client.get("oil.viscosity") == before


def test_integers_and_texts_of_numbers_are_taken_for_numbers(client: Client) -> None:
    # As ros2 param set and load send [0, 0], [1e-6, 2e-06], [0, 1e-6] and [0, 0.00001].
    for value, floats in (
        ([0, 0], [0.0, 0.0]),
        (["1e-6", "2e-06"], [1e-6, 2e-6]),
        ("[0, 1e-6]", [0.0, 1e-6]),
        ("[0, 0.00001]", [0.0, 1e-5]),
        ([0.0, 0.0], [0.0, 0.0]),
    ):
        result = client.put("mesh.error_sin", value)
        assert result.successful, result.reason
        assert client.get("mesh.error_sin") == floats
    for wrong in (["1e-6", "thick"], "[0, thick]", "[0", [True, False]):
        assert not client.put("mesh.error_sin", wrong).successful
    assert client.put("surface.driven.roughness", "9e-07").successful
    assert client.get("surface.driven.roughness") == 9e-7


def test_parameters_change_at_a_chunk_edge_all_or_none_and_are_recorded(client: Client) -> None:
    assert not client.put_all({"oil.viscosity": 0.05, "operation.speed": 6000.0}).successful
    assert client.get("oil.viscosity") == 0.0228
    wanted = {"oil.viscosity": 0.05, "operation.load_torque": 17, "mesh.stiffness_cos": [0.05, 0.01]}
    assert client.put_all(wanted).successful
    client.until(lambda: client.events()[-1]["event"] == "parameters")
    change = client.events()[-1]
    assert change["parameters"] == {
        "mesh.stiffness_cos": [0.05, 0.01],
        "oil.viscosity": 0.05,
        "operation.load_torque": 17.0,
    }
    client.until(lambda: client.sample() >= change["sample"])
    index, load = client.indices(), client.rows()[:, COLUMN["load_torque"]]
    assert change["sample"] % CHUNK == 0
    assert np.all(load[index >= change["sample"]] == 17.0) and np.all(load[index < change["sample"]] == 30.0)
    client.until(lambda: client.info()["parameters"]["oil.viscosity"] == 0.05)


def test_control_is_switched_without_a_jump_of_torque(client: Client) -> None:
    client.command("load_torque_command", Float64(data=45.0))
    client.until(lambda: client.rows()[-1, COLUMN["drive_torque"]] > 35.0)
    for control in ("torque", "speed"):
        known = len(client.heard["event"])
        assert client.put("operation.control", control).successful
        client.until(lambda known=known: len(client.heard["event"]) > known)
        at = client.events()[-1]["sample"]
        client.until(lambda at=at: client.sample() > at)
        torque = client.rows()[:, COLUMN["drive_torque"]]
        edge = int(np.searchsorted(client.indices(), at))
        assert torque[edge] == pytest.approx(torque[edge - 1], rel=1e-14)
        assert torque[edge] > 35.0  # not the torque that the parameters ask for


def test_a_checkpoint_is_saved_and_restored_with_its_parameters_and_commands(
    client: Client, shared: Shared
) -> None:
    client.command("joint_command", JointState(name=["driven"], effort=[42.0]))
    client.until(lambda: client.in_force().load_torque == 42.0)
    saved = client.trigger("save_checkpoint")
    file = shared.bag.with_name("bag.json")
    assert saved.success and str(file) in saved.message
    taken = checkpoint.load_checkpoint(file).checkpoint
    assert float(saved.message.split()[-2]) == pytest.approx(taken.sample * 1e-5)
    client.until(lambda: client.sample() >= taken.sample)
    other = {"oil.viscosity": 0.001, "mesh.error_cos": [1e-6], "operation.load_torque": 33.0}
    before = client.get_all(list(other))
    assert client.put_all(other).successful
    client.until(lambda: client.events()[-1]["event"] == "parameters")
    known = len(client.heard["event"])
    restored = client.trigger("restore_checkpoint")
    assert restored.success, restored.message
    client.until(lambda: client.events()[-1]["event"] == "restore")
    at = client.events()[-1]["sample"]
    client.until(lambda: client.sample() >= max(at, taken.sample) + CHUNK)
    assert client.get_all(list(other)) == before
    assert [event["event"] for event in client.events()[known:]] == ["parameters", "restore"]
    rows, index = client.rows(), client.indices()
    (old,), (new,) = rows[index == taken.sample], rows[index == at]
    np.testing.assert_array_equal(old[1:], new[1:])
    assert rows[-1][COLUMN["load_torque"]] == 42.0


def test_without_a_ring_there_is_no_snapshot(client: Client) -> None:
    answer = client.trigger("snapshot")
    assert not answer.success and "recording.mode = 'ring'" in answer.message


def test_deactivating_loses_no_sample(client: Client) -> None:
    client.hear("waveform")
    assert client.transition(Transition.TRANSITION_DEACTIVATE).success
    answer = client.trigger("reset")
    assert not answer.success and "active" in answer.message
    client.until(lambda: client.status("run")[0].message == "inactive")
    assert client.transition(Transition.TRANSITION_ACTIVATE).success
    client.hear("waveform", 3)
    np.testing.assert_array_equal(np.diff(client.indices()), 1)


def test_recording_can_be_split_switched_off_and_on(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    node = start_gearbox(process, f"recording.path:={bag}", "pacing.real_time_factor:=0.2")
    with Client() as client:
        client.hear("waveform")
        client.command("load_torque_command", Float64(data=12.5))
        client.until(lambda: client.in_force().load_torque == 12.5)
        for wanted in (True, False):
            assert client.switch("pause", wanted).success
        assert client.trigger("split").success
        assert client.trigger("reset").success
        client.hear("waveform", 2)
        assert client.switch("record", False).message == f"recorded {bag}"
        client.until(lambda: client.status("recorder")[0].message == "off")
        assert not client.trigger("split").success
        first = recording.open(bag)
        assert first.complete and len(first.parts) == 2
        assert first.commands[0][0] == 0
        assert [event.kind for event in first.events] == ["start", "pause", "resume", "reset"]
        ((_, command),) = first.messages("load_torque_command")
        assert command.data == 12.5
        assert verify_recording(first).difference is None
        assert client.switch("record", True).message == f"recording to {tmp_path / 'bag_2'}"
        client.hear("waveform", 2)
        node.signal(signal.SIGINT)
        assert node.wait() == 0
    second = recording.open(tmp_path / "bag_2")
    assert second.complete and second.first_sample >= first.end_sample
    assert verify_recording(second).difference is None


def test_sigint_twice_leaves_a_complete_recording(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    node = start_gearbox(process, f"recording.path:={bag}", "pacing.real_time_factor:=0.2")
    with Client() as client:
        client.hear("waveform", 5)
        node.signal(signal.SIGINT)
        node.signal(signal.SIGINT)
        assert node.wait() == 0
    found = recording.open(bag)
    assert found.complete
    assert (bag / "metadata.yaml").exists()
    assert found.events[-1].kind == "end" and found.events[-1].message == "SIGINT"


def test_the_node_can_be_cleaned_up_and_brought_up_again(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    node = start_gearbox(
        process, f"recording.path:={bag}", "autostart:=false", "pacing.real_time_factor:=0.2"
    )
    with Client() as client:
        for _ in range(2):
            for transition in (
                Transition.TRANSITION_CONFIGURE,
                Transition.TRANSITION_ACTIVATE,
                Transition.TRANSITION_DEACTIVATE,
                Transition.TRANSITION_CLEANUP,
            ):
                assert client.transition(transition).success
                if transition == Transition.TRANSITION_ACTIVATE:
                    client.hear("waveform", 2)
        assert client.transition(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN).success
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    for path in (bag, tmp_path / "bag_2"):
        found = recording.open(path)
        assert found.complete and found.first_sample == 0
        assert found.events[-1].message == "cleaned up"


def test_a_trip_is_told_and_a_reset_recovers(ros_domain: int, process: StartProcess, tmp_path: Path) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "operation.control:=torque",
        "operation.load_torque:=0.0",
        "operation.speed_limit:=1640.0",
    )
    assert "does not balance" in node.wait_for("run ended: over-speed")
    with Client() as client:
        client.until(lambda: client.heard["diagnostics"])
        status = client.statuses()["run"]
        assert status.level == DiagnosticStatus.ERROR and status.message.startswith("over-speed")
        tripped = recording.open(tmp_path / "bag")
        assert tripped.complete and "operation.speed_limit" in tripped.events[-1].message
        assert not client.switch("pause", False).success
        answer = client.trigger("reset")
        assert answer.success and answer.message.endswith("bag_2")
        # The torques still don't balance, so the new run may have tripped before we look.
        client.until(lambda: client.heard["waveform"])
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    again = recording.open(tmp_path / "bag_2")
    assert again.complete and len(again.waveform()) > 0


def test_duration_ends_the_node_with_a_complete_recording(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    node = start_gearbox(
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
def test_a_wrong_parameter_stops_the_start_with_one_line(
    ros_domain: int, process: StartProcess, override: str, words: list[str]
) -> None:
    node = start_gearbox(process, override)
    assert node.wait() == 2
    (line,) = node.stderr.splitlines()
    assert line.startswith("gearbox: error: ") and all(word in line for word in words)


@pytest.mark.parametrize("what", ["can't be written", "has no room"])
def test_a_recording_that_cannot_begin_leaves_the_gearbox_running(
    ros_domain: int, process: StartProcess, tmp_path: Path, what: str
) -> None:
    (tmp_path / "there").write_text("mine")
    path, told, free = {
        "can't be written": (tmp_path / "there" / "bag", "Not a directory: choose a writable place", 0),
        "has no room": (tmp_path / "bag", "less than recording.minimum_free", 1 << 50),
    }[what]
    node = start_gearbox(process, f"recording.path:={path}", f"recording.minimum_free:={free}")
    with Client() as client:
        client.hear("waveform", 5)
        found = client.statuses()["recorder"]
        assert found.level == DiagnosticStatus.ERROR and told in found.message
        assert node.output.count("recording.path: ") == 1
        node.signal(signal.SIGINT)
        assert node.wait() == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_a_place_that_is_taken_is_left_alone_and_another_beside_it_is_free(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    path = tmp_path / "there"
    path.write_text("mine")
    node = start_gearbox(process, f"recording.path:={path}")
    with Client() as client:
        found = client.statuses()["recorder"]
        assert found.level == DiagnosticStatus.ERROR
        assert "exists already and recordings never overwrite" in found.message
        assert node.output.count("recording.path: ") == 1
        answer = client.switch("record", True)
        assert answer.success and answer.message == f"recording to {tmp_path / 'there_2'}"
        client.until(lambda: client.status("recorder")[0].level == DiagnosticStatus.OK)
        node.signal(signal.SIGINT)
        assert node.wait() == 1
    assert path.read_text() == "mine"


def test_a_ring_is_written_when_asked_for_and_when_the_run_ends_by_a_fault(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "recording.mode:=ring",
        "recording.ring_duration:=0.2",
        "recording.split_duration:=0.1",
    )
    with Client() as client:
        client.hear("waveform", 5)
        assert not (tmp_path / "bag").exists()
        for name in ("bag", "bag_2"):
            answer = client.trigger("snapshot")
            assert answer.success and answer.message == f"recorded {tmp_path / name}"

        def last_snapshot() -> str:
            return client.status("recorder")[1]["last snapshot"]

        client.until(lambda: last_snapshot() == str(tmp_path / "bag_2"))
        status, values = client.status("recorder")
        assert status.message == "keeping the ring" and int(values["ring (bytes)"]) > 0
        # Beside the ring everything may be recorded for a while.
        assert client.switch("record", True).message.endswith("bag_3")
        client.hear("waveform", 100)
        assert client.switch("record", False).success
        assert client.put("operation.speed_limit", 1625.0).successful
        client.put("operation.speed", 1624.9)
        client.put("operation.governor.proportional", 50.0)
        node.wait_for(f"what preceded it is in {tmp_path / 'bag_4'}")
        node.signal(signal.SIGTERM)
        assert node.wait() == 0
    for name in ("bag", "bag_2", "bag_3", "bag_4"):
        found = recording.open(tmp_path / name)
        assert found.complete
        assert verify_recording(found).difference is None
    assert "over-speed" in found.events[-1].message
    assert 0.2 <= found.duration_ns / 1e9 <= 0.23
    assert len(recording.open(tmp_path / "bag_3").parts) >= 2
    with pytest.raises(GearboxError, match="no recording"):
        recording.open(tmp_path / "bag_5")


def test_an_overrun_ends_the_run_where_that_is_wanted(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    node = start_gearbox(
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


def test_a_pace_that_can_be_kept_has_no_overrun_to_end_the_run(
    ros_domain: int, process: StartProcess
) -> None:
    node = start_gearbox(process, "pacing.real_time_factor:=0.005", "pacing.on_overrun:=error")
    with Client() as client:
        client.hear("waveform", 5)
        assert client.status("pacing")[1]["overruns"] == "0"
        assert "overrun" not in node.output


def test_a_recording_switched_off_stays_off_after_a_trip(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    node = start_gearbox(
        process,
        f"recording.path:={tmp_path / 'bag'}",
        "operation.control:=torque",
        "operation.load_torque:=0.0",
        "pacing.real_time_factor:=0.05",  # discovery can take seconds, and the trip comes after half of one
    )
    with Client() as client:
        client.hear("waveform")
        assert client.switch("record", False).success
        node.wait_for("run ended: over-speed")
        # Higher than the limit that ended it, so that the reset can last.
        assert client.put("operation.speed_limit", 1e5).successful
        answer = client.trigger("reset")
        assert answer.success and "recording" not in answer.message
        client.hear("waveform")
    assert not (tmp_path / "bag_2").exists()


def test_a_recording_switched_off_after_a_trip_stays_off(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    settings = ("operation.control:=torque", "operation.load_torque:=0.0", "pacing.real_time_factor:=0.5")
    node = start_gearbox(process, f"recording.path:={tmp_path / 'bag'}", *settings)
    with Client() as client:
        node.wait_for("run ended: over-speed")
        assert client.switch("record", False).success
        assert client.put("operation.speed_limit", 1e5).successful
        answer = client.trigger("reset")
        assert answer.success and "recording" not in answer.message
    assert not (tmp_path / "bag_2").exists()


def test_the_clock_runs_at_its_own_rate_and_two_publishers_are_told_once(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    settings = ("clock_rate:=50.0", "joint_prefix:=left_", "pacing.real_time_factor:=0.5")
    node = start_gearbox(process, *settings, f"recording.path:={bag}")
    with Client() as client:
        clock: list[Any] = []
        client.subscribe("clock", clock.append)
        client.publisher("load_torque_command")
        client.until(lambda: len(clock) > 20)
        heard = [stamp_ns(message.clock) for message in clock]
        (state,) = client.hear("joint_states")
        assert list(state.name) == ["left_driving", "left_driven", "left_mesh"]
        crowded = "/gearbox/command/load_torque"
        client.until(lambda: client.status("commands")[1]["several publishers"] == crowded)
        status, _ = client.status("commands")
        assert status.level == DiagnosticStatus.WARN
        assert status.message.startswith("several publishers on a command")
        assert node.output.count("has several publishers") == 1
    assert node.stop() == 0
    published = [stamp_ns(message.clock) for _, message in recording.open(bag).messages("clock")]
    assert set(np.diff(published)) == {20_000_000}
    # The topic is best effort: a subscriber that is late misses ticks, but gets no others.
    assert set(heard) <= set(published) and heard == sorted(set(heard))


def test_quality_of_service_can_be_overridden(ros_domain: int, process: StartProcess) -> None:
    start_gearbox(process, "qos_overrides./gearbox/dte.publisher.reliability:=best_effort")
    with Client() as client:

        def offered(name: str) -> list[ReliabilityPolicy]:
            found = client.node.get_publishers_info_by_topic(name)
            return [endpoint.qos_profile.reliability for endpoint in found]

        client.until(lambda: offered("/gearbox/dte") and offered("/gearbox/mesh_force"))
        assert offered("/gearbox/dte") == [ReliabilityPolicy.BEST_EFFORT]
        assert offered("/gearbox/mesh_force") == [ReliabilityPolicy.RELIABLE]


def test_a_recording_that_could_not_begin_can_begin_later(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    path.mkdir()
    node = start_gearbox(process, f"recording.path:={path}", "pacing.real_time_factor:=0.2")
    with Client() as client:
        client.hear("waveform")
        node.wait_for("recordings never overwrite")
        path.rmdir()
        assert client.switch("record", True).message == f"recording to {path}"
        client.hear("waveform")


def test_transitions_repeated_leave_nothing_behind(ros_domain: int, process: StartProcess) -> None:
    node = start_gearbox(process, "autostart:=false", "pacing.real_time_factor:=0.2")
    cycle = (
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
    )
    with Peer("switching") as peer:
        switch = peer.node.create_client(ChangeState, "/gearbox/change_state")
        assert switch.wait_for_service(PATIENCE)

        def cycles(count: int) -> int:
            """Descriptors and threads of the node after so many cycles."""
            for transition in cycle * count:
                answer = switch.call_async(ChangeState.Request(transition=Transition(id=transition)))
                peer.until(answer.done)
                assert answer.result().success
            return sum(len(list(Path(f"/proc/{node.pid}/{what}").iterdir())) for what in ("fd", "task"))

        early = cycles(5)
        # DDS has a thread or a descriptor more or less at any moment; what stays behind adds up to 40.
        assert cycles(40) < early + 10
