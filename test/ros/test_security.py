"""Nothing listens beyond this machine unless asked to, and the SROS2 policy grants what the nodes use."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.ros.discovery import (
    DECIDING,
    PROFILES,
    RANGE,
    stay_local,
)
from gear_dynamics_ros.topics import TOPICS, full_topic_name
from support.gearbox import PATIENCE, Peer, start_gearbox
from support.paths import ROOT
from support.processes import until

TCP_LISTEN = "0A"
# That a node has once it is complete.
A_TOPIC = {"gearbox": "/gearbox/waveform", "drive": "/gearbox/command/load_torque"}
COARSE = ("--set", "model=traditional", "--set", "solver.step=1e-5")  # quickly simulated
PROFILE = """
description: longer than the test
duration: 60.0
commands: {speed: [{at: 0.0, value: 900.0}], drive_torque: [{at: 0.0, value: 30.0}],
           load_torque: [{at: 0.0, value: 30.0}]}
"""


class Rule(NamedTuple):
    """What an element of a policy may hold."""

    children: tuple[str, ...] = ()  # at least one of them
    single: bool = False  # no more than one
    required: Mapping[str, tuple[str, ...]] = MappingProxyType(
        {}
    )  # attributes, with patterns of their values
    optional: Mapping[str, tuple[str, ...]] = MappingProxyType({})


ANY = (".+",)
QUALIFIER = ("ALLOW", "DENY")
# The elements of a policy that sros2 (Jazzy) accepts, but for its metadata, xml:base and includes.
GRAMMAR = {
    "policy": Rule(("enclaves",), single=True, required={"version": (r"0\.2\.0",)}),
    "enclaves": Rule(("enclave",)),
    "enclave": Rule(("profiles",), required={"path": ("/.+",)}),
    "profiles": Rule(("profile",), optional={"type": ANY}),
    "profile": Rule(("topics", "services", "actions"), required={"ns": ANY, "node": ANY}),
    "topics": Rule(("topic",), optional={"publish": QUALIFIER, "subscribe": QUALIFIER}),
    "services": Rule(("service",), optional={"reply": QUALIFIER, "request": QUALIFIER}),
    "actions": Rule(("action",), optional={"call": QUALIFIER, "execute": QUALIFIER}),
    "topic": Rule(),
    "service": Rule(),
    "action": Rule(),
}


class Socket(NamedTuple):
    """A socket that can receive."""

    kind: str
    address: ipaddress.IPv4Address | ipaddress.IPv6Address
    port: int
    unread: int


def address_of(text):
    """Address as the kernel prints it: 32-bit words in the order of the machine's bytes."""
    words = [int(text[i : i + 8], 16).to_bytes(4, sys.byteorder) for i in range(0, len(text), 8)]
    return ipaddress.ip_address(b"".join(words))


def sockets(pid):
    """What the process receives on, but for connections."""
    own = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            own.add(os.readlink(entry))
        except FileNotFoundError:
            continue
    found = []
    for kind in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            _, local, _, state, queues, _, _, _, _, inode, *_ = line.split()
            if f"socket:[{inode}]" in own and (kind.startswith("udp") or state == TCP_LISTEN):
                address, port = local.split(":")
                unread = int(queues.split(":")[1], 16)
                found.append(Socket(kind, address_of(address), int(port, 16), unread))
    return found


class Observer(Peer):
    """A ROS 2 node without settings of its own, as others have them."""

    def graph(self, name):
        """Names that the node publishes, subscribes to, serves and calls."""
        node = self.node
        calls = (
            node.get_publisher_names_and_types_by_node,
            node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node,
            node.get_client_names_and_types_by_node,
        )
        return tuple({entry[0] for entry in call(name, "/")} for call in calls)

    def settled_graph(self, name, topic):
        """The graph once it holds ``topic`` and no longer grows."""
        deadline = time.monotonic() + PATIENCE
        before = None
        while time.monotonic() < deadline:
            now = self.graph(name) if (name, "/") in self.node.get_node_names_and_namespaces() else None
            if now is not None and now == before and topic in now[0] | now[1]:
                return now
            before = now
            time.sleep(0.5)
        pytest.fail(f"no settled graph of {name} with {topic}: {before}")


@pytest.fixture
def observer(ros_domain):
    with Observer("observer") as observer:
        yield observer


@pytest.fixture
def environment(monkeypatch):
    for name in (RANGE, *DECIDING):
        # Set first, so that what a test sets in its place is undone as well.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    return monkeypatch


def start(process, tmp_path, *parameters, **variables):
    """A gearbox, and a drive that commands it for longer than a test takes."""
    profile = tmp_path / "profile.yaml"
    profile.write_text(PROFILE)
    return {
        "gearbox": start_gearbox(process, "pacing.real_time_factor:=0.2", *parameters, **variables),
        "drive": process("drive", profile, "--wait", PATIENCE, **variables),
    }


@pytest.mark.parametrize("variables", [{}, {RANGE: "LOCALHOST"}], ids=["unset", "LOCALHOST"])
def test_nothing_is_received_from_beyond_this_machine(
    ros_domain, process, observer, environment, variables, tmp_path
):
    for name, started in start(process, tmp_path, **variables).items():
        observer.settled_graph(name, A_TOPIC[name])
        found = sockets(started.pid)
        elsewhere = [entry for entry in found if not entry.address.is_loopback]
        assert len(elsewhere) < len(found)
        assert {entry.kind for entry in elsewhere} <= {"udp"}

        def unread(pid=started.pid):
            return {entry.port: entry.unread for entry in sockets(pid)}

        local = {entry.port for entry in found if entry.kind == "udp"} - {entry.port for entry in elsewhere}

        def some_read(unread=unread, local=local):
            return any(unread()[port] == 0 for port in local)

        for _ in range(5):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                for entry in (entry for entry in found if entry.kind == "udp"):
                    target = "127.0.0.1" if entry.address.is_unspecified else str(entry.address)
                    sender.sendto(b"is anybody there?", (target, entry.port))
            until(some_read, "what was sent to the loopback interface is read")
        # Sockets for sending only: what comes in stays in the kernel's queue, unread.
        left = unread()
        assert all(left[entry.port] > 0 for entry in elsewhere), (name, elsewhere)
        assert "error" not in started.output.lower()


def test_without_a_wish_everything_stays_on_this_machine(environment):
    stay_local()
    assert os.environ[RANGE] == "LOCALHOST"
    assert os.environ[PROFILES] == str(ROOT / "config/fastdds_local.xml")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (RANGE, "SUBNET"),
        (RANGE, "OFF"),
        (RANGE, "SYSTEM_DEFAULT"),
        ("ROS_LOCALHOST_ONLY", "0"),
        ("ROS_STATIC_PEERS", "192.0.2.7"),
        ("ROS_DISCOVERY_SERVER", "127.0.0.1:11811"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "own.xml"),
        ("FASTDDS_DEFAULT_PROFILES_FILE", "own.xml"),
    ],
)
def test_who_asks_for_more_is_left_alone(environment, name, value):
    environment.setenv(name, value)
    before = dict(os.environ)
    stay_local()
    assert dict(os.environ) == before


def test_what_may_change_while_the_gearbox_runs_cannot_name_a_path():
    changeable = [row for row in specifications().values() if row.runtime]
    assert changeable
    assert not [row.name for row in changeable if row.element is str and not row.choices]


def policy_profile(node):
    """Names that the policy lets ``node`` publish, subscribe to, serve and call."""
    (profile,) = [profile for profile in policy().iter("profile") if profile.get("node") == node]
    namespace = profile.get("ns").rstrip("/")

    def allowed(right):
        names = [entry.text for group in profile if group.get(right) == "ALLOW" for entry in group]
        assert len(names) == len(set(names))
        return {name if name.startswith("/") else f"{namespace}/{name}" for name in names}

    return tuple(allowed(right) for right in ("publish", "subscribe", "reply", "request"))


def breaches(element):
    """What the grammar does not allow in ``element`` and below it, in words."""
    rule = GRAMMAR[element.tag]
    found = [f"{element.tag}: no {name}" for name in rule.required if name not in element.attrib]
    for name, value in element.attrib.items():
        values = {**rule.required, **rule.optional}.get(name, ())
        if not re.fullmatch("|".join(values), value):
            found.append(f"{element.tag}: {name}={value!r}")
    if rule.children and not len(element):
        found.append(f"{element.tag}: empty")
    if rule.single and len(element) > 1:
        found.append(f"{element.tag}: {len(element)} children")
    for child in element:
        found += breaches(child) if child.tag in rule.children else [f"{element.tag}: child {child.tag}"]
    return found


def policy():
    return ElementTree.parse(ROOT / "sros2/policy.xml").getroot()


def test_the_policy_has_the_form_that_sros2_reads():
    assert policy().tag == "policy"
    assert breaches(policy()) == []


@pytest.mark.parametrize(
    ("path", "change", "breach"),
    [
        ("enclaves", lambda element: setattr(element, "tag", "contexts"), "policy: child contexts"),
        (".", lambda element: element.set("version", "0.1.0"), "policy: version='0.1.0'"),
        ("enclaves/enclave", lambda element: element.attrib.pop("path"), "enclave: no path"),
        (".//profile", lambda element: element.attrib.pop("ns"), "profile: no ns"),
        (".//topics", lambda element: element.set("publish", "allow"), "topics: publish='allow'"),
        (".//topics", lambda element: element.set("request", "ALLOW"), "topics: request='ALLOW'"),
        (".//services", lambda element: element.clear(), "services: empty"),
    ],
)
def test_what_sros2_refuses_is_found(path, change, breach):
    changed = policy()
    element = changed.find(path)
    assert element is not None
    change(element)
    assert breaches(changed) == [breach]


def test_every_right_is_allowed_by_name():
    groups = [group for profile in policy().iter("profile") for group in profile]
    assert {value for group in groups for value in group.attrib.values()} == {"ALLOW"}
    assert all(len(group.attrib) == 1 for group in groups)
    # No wildcard.
    names = [entry.text for group in groups for entry in group]
    assert all(name.replace("_", "").replace("/", "").isalpha() for name in names)


def test_the_documented_enclaves_are_those_of_the_policy():
    documented = re.findall(r"--enclave (\S+)", (ROOT / "docs/security.md").read_text())
    assert documented
    assert set(documented) <= {enclave.get("path") for enclave in policy().iter("enclave")}


def test_the_policy_covers_every_topic():
    publish, subscribe, *_ = policy_profile("gearbox")
    assert {full_topic_name(topic) for topic in TOPICS.values()} <= publish | subscribe


def test_the_policy_grants_what_the_live_nodes_use_and_no_more(ros_domain, process, observer, tmp_path):
    started = start(process, tmp_path, "clock_rate:=10.0")
    graph = observer.settled_graph("gearbox", A_TOPIC["gearbox"])
    assert graph == policy_profile("gearbox")
    at_own_pace = observer.settled_graph("drive", A_TOPIC["drive"])
    assert started["drive"].stop() == 130
    process("drive", tmp_path / "profile.yaml", "--lockstep", "--wait", PATIENCE)
    in_lockstep = observer.settled_graph("drive", "/gearbox/command/joint")
    assert tuple(map(set.union, at_own_pace, in_lockstep)) == policy_profile("drive")


def test_the_policy_grants_what_replay_publish_uses_and_no_more(ros_domain, process, observer, tmp_path):
    simulate = process("simulate", "--duration", "60", "--output", tmp_path / "bag", *COARSE)
    assert simulate.wait() == 0, simulate.output
    start_gearbox(process)
    process("replay", "publish", tmp_path / "bag", "--lockstep", "--wait", PATIENCE)
    graph = observer.settled_graph("replay_publish", "/gearbox/command/joint")
    assert graph == policy_profile("replay_publish")


def test_a_middleware_without_security_is_told_in_words(ros_domain, process, tmp_path):
    (tmp_path / "keystore/enclaves/rig").mkdir(parents=True)
    (tmp_path / "profile.yaml").write_text(PROFILE)
    secure = {
        "ROS_SECURITY_KEYSTORE": str(tmp_path / "keystore"),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
    }
    for command in (("gearbox",), ("drive", tmp_path / "profile.yaml")):
        run = process(*command, "--ros-args", "--enclave", "/rig", **secure)
        assert run.wait() == 2, run.output
        assert "Traceback" not in run.output
        last = run.stderr.splitlines()[-1]
        assert last.startswith(f"{command[0]}: error: ROS did not start: error creating node")
        assert last.endswith("or unset ROS_SECURITY_ENABLE")
