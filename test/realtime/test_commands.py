"""Commands between their sender and the next chunk edge."""

from __future__ import annotations

import math

import pytest

from gear_dynamics_ros.messages.decoder import joint_changes
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime.mailbox import MOST_RECEIVED, Mailbox


@pytest.fixture
def mailbox():
    return Mailbox(Parameters(), 0)


def test_of_several_the_last_counts_and_each_is_handed_over_once(mailbox):
    mailbox.offer("speed_command", {"speed": 1.0}, b"a", 5)
    mailbox.offer("load_torque_command", {"load_torque": 2.0}, b"b", 6)
    mailbox.offer("speed_command", {"speed": 3.0}, b"c", 7)
    delivery = mailbox.take(10)
    assert delivery.changes == {"speed": 3.0, "load_torque": 2.0}
    assert delivery.received == [
        ("speed_command", b"a"),
        ("load_torque_command", b"b"),
        ("speed_command", b"c"),
    ]
    assert delivery.age_ns == 3
    assert mailbox.take(11) == ({}, [], 4)


@pytest.mark.parametrize(
    "changes",
    [
        {"speed": math.nan},
        {"speed": -5000.1},
        {"drive_torque": math.inf},
        {"load_torque": 1e7},
        {"speed": 10.0, "drive_torque": -math.inf},
    ],
)
def test_what_cannot_be_is_refused_as_a_whole(mailbox, changes):
    assert "refused" in mailbox.offer("joint_command", changes, b"", 5)
    assert mailbox.take(6) == ({}, [], 6)
    assert mailbox.counts(6)[:2] == (0, 1)


def test_a_joint_command_names_what_it_changes():
    names = ["l_driven", "l_driving", "driving", "l_mesh"]
    wanted, unknown = joint_changes("l_", names, [1.0, 2.0, 3.0, 4.0], [4.0, 5.0, 6.0, 7.0])
    assert wanted == {"speed": 2.0, "drive_torque": 5.0, "load_torque": 4.0}
    assert unknown == ["driving"]
    assert joint_changes("", ["driving", "driven"], [], [math.nan])[0] == {}


def test_each_command_has_an_age_of_its_own(mailbox):
    mailbox.offer("speed_command", {"speed": 1.0}, b"", 10**9)
    mailbox.offer("load_torque_command", {"load_torque": 1.0}, b"", 3 * 10**9)
    ages = mailbox.counts(4 * 10**9).ages
    assert ages["speed"] == 3.0 and ages["load_torque"] == 1.0 and math.isnan(ages["drive_torque"])


def test_a_burst_keeps_the_last_value_and_a_bounded_number_of_messages(mailbox):
    burst = MOST_RECEIVED + 7
    for k in range(burst):
        mailbox.offer("load_torque_command", {"load_torque": float(k)}, b"%d" % k, k)
    delivery = mailbox.take(burst)
    assert delivery.changes == {"load_torque": burst - 1.0}
    assert delivery.received[0][1] == b"7" and len(delivery.received) == MOST_RECEIVED
    assert mailbox.counts(burst).unrecorded == 7


def test_a_new_speed_limit_bounds_the_commands_that_follow(mailbox):
    mailbox.limit(Parameters.from_flat({"operation.speed": 10.0, "operation.speed_limit": 20.0}))
    assert "not within -20 to 20" in mailbox.offer("speed_command", {"speed": 21.0}, b"", 5)
    assert "speed 20.0000001 refused: not within" in mailbox.offer(
        "speed_command", {"speed": 20.0000001}, b"", 5
    )
