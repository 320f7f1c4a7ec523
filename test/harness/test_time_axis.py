"""The time axis of a profile follows the commands that acted, and windows follow the axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.lockstep import profile_script
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile, parse_profile
from gear_dynamics_ros.script import ChangeAction, ResetAction, agree

CHUNK = 100  # samples
INTERVAL_NS = 10_000
CHANNELS = ("time", "load_torque")
START = Commands(0.0, 10.0, 100.0)


class Gearbox:
    """Makes chunks that show the load in force; a command acts ``late`` chunks after the first it could."""

    def __init__(self, profile: Profile) -> None:
        self.player = Player(profile, CHANNELS)
        self.in_force = START
        self.sample = 0
        self.sent: list[tuple[int, dict[str, float]]] = []  # sample to act at, values

    def make(self, late: int = 0) -> None:
        """One chunk; commands that the player gives then act ``late`` chunks later."""
        due = [values for at, values in self.sent if at == self.sample]
        self.sent = [(at, values) for at, values in self.sent if at > self.sample]
        for values in due:
            before, self.in_force = self.in_force, self.in_force._replace(**values)
            if before != self.in_force:
                self.player.acted(self.sample, self.in_force)
        self.player.feed(self._waveform())
        self.sample += CHUNK
        if self.player.commands():
            self.sent.append((self.sample + late * CHUNK, self.player.commands()))

    def _waveform(self) -> NDArray[np.float64]:
        times = (self.sample + np.arange(CHUNK)) * (INTERVAL_NS * 1e-9)
        return np.column_stack([times, np.full(CHUNK, self.in_force.load_torque)])

    def play(self, lateness: list[int]) -> Player:
        """As many chunks as the profile needs; ``lateness`` of commands by chunk, then 0."""
        waiting = [*lateness]
        self.player.acted(0, START)
        for _ in range(1000):
            self.make(waiting.pop(0) if waiting else 0)
            if self.player.finished:
                return self.player
        raise AssertionError("the profile did not end")


def steps(*expectations: dict[str, Any]) -> Profile:
    load = [{"at": 0.0, "value": 20.0}, {"at": 0.01, "value": 45.0}, {"at": 0.02, "value": 30.0}]
    return parse_profile({"commands": {"load_torque": load}, "expectations": list(expectations)}, Path())


def exactly(value: float, start: float, end: float) -> dict[str, Any]:
    return {
        "name": f"{value}", "every": "load_torque", "from": start, "to": end,
        "target": value, "tolerance": 0.0,
    }  # fmt: skip


@pytest.mark.parametrize("late", [0, 1, 7, 30])
def test_windows_hold_exactly_the_samples_between_two_commands_however_late_they_act(late: int) -> None:
    profile = steps(exactly(20.0, 0.0, 0.01), exactly(45.0, 0.01, 0.02), exactly(30.0, 0.02, 0.03))
    player = Gearbox(profile).play([late, 0, 1] * 40)
    assert [result.status for result in player.results()] == ["pass"] * 3
    assert [result.samples for result in player.results()] == [1000, 1000, 1000]
    assert [result.missing for result in player.results()] == [0, 0, 0]


def test_the_same_windows_fail_if_they_follow_the_time_of_sending() -> None:
    profile = steps(exactly(20.0, 0.0, 0.01))
    gearbox = Gearbox(profile)
    gearbox.player.begin(0, INTERVAL_NS)  # and no command is ever told to have acted
    for _ in range(20):
        gearbox.player.feed(gearbox._waveform())
        gearbox.sample += CHUNK
    (result,) = gearbox.player.results()
    assert (result.status, result.samples) == ("open", 0)


def test_a_window_over_a_late_command_has_the_samples_of_the_wait_too() -> None:
    whole = {"name": "whole", "every": "load_torque", "from": 0.0, "to": 0.03, "minimum": 0.0}
    (result,) = Gearbox(steps(whole)).play([0] * 10 + [20] * 30).results()
    assert result.passed
    assert result.samples > 3000 + 15 * CHUNK


def test_lateness_is_what_passed_between_due_and_acting() -> None:
    profile = steps(exactly(20.0, 0.0, 0.01))
    player = Gearbox(profile).play([3] * 100)
    assert player.lateness[0] == pytest.approx(3 * CHUNK * INTERVAL_NS * 1e-9)


def ramp(*expectations: dict[str, Any]) -> Profile:
    load = [{"at": 0.0, "value": 20.0}, {"from": 0.01, "to": 0.03, "value": 40.0}]
    return parse_profile({"commands": {"load_torque": load}, "expectations": list(expectations)}, Path())


MIDDLE = {
    "name": "middle",
    "mean": "load_torque",
    "from": 0.015,
    "to": 0.025,
    "target": 30.0,
    "tolerance": 0.6,
}


@pytest.mark.parametrize("late", [0, 1, 5])
def test_a_ramp_is_measured_where_its_values_act(late: int) -> None:
    (result,) = Gearbox(ramp(MIDDLE)).play([late] * 200).results()
    assert result.status == "pass", result.reason()


def test_what_failed_after_values_were_left_out_is_not_judged() -> None:
    impossible = {**MIDDLE, "target": 99.0}
    (judged,) = Gearbox(ramp(impossible)).play([0] * 200).results()
    assert (judged.status, judged.failed) == ("FAIL", True)

    gearbox = Gearbox(ramp(impossible))
    gearbox.player.acted(0, START)
    while gearbox.player.time < 0.017:
        gearbox.make()
    for _ in range(5):  # chunks that drive takes at once: it sends the commands of the last one only
        gearbox.player.feed(gearbox._waveform())
        gearbox.sample += CHUNK
    gearbox.sent = [(gearbox.sample, gearbox.player.commands())]
    while not gearbox.player.finished:
        gearbox.make()
    (late,) = gearbox.player.results()
    assert (late.status, late.failed, late.passed) == ("late", False, False)
    assert "values of its commands came too late to act" in late.reason()


def test_a_command_that_the_gearbox_refuses_is_not_waited_for() -> None:
    profile = steps(exactly(10.0, 0.0, 0.03))
    player = Player(profile, CHANNELS, lambda name, value: False)
    player.begin(0, INTERVAL_NS)
    gearbox = Gearbox(profile)
    while not player.finished:
        player.feed(gearbox._waveform())
        gearbox.sample += CHUNK
    (result,) = player.results()
    assert (result.status, result.samples) == ("pass", 3000)


def test_the_script_of_a_profile_has_each_new_value_at_its_chunk_edge() -> None:
    profile = parse_profile(
        {
            "duration": 0.01,
            "reset": True,
            "parameters": {"oil.viscosity": 0.05},
            "commands": {
                "load_torque": [{"at": 0.002, "value": 20.0}, {"from": 0.004, "to": 0.006, "value": 40.0}],
                "speed": [{"at": 0.0, "value": 300.0}],
            },
        },
        Path(),
    )
    script = profile_script(profile, 1_000_000)
    assert script.duration_ns == 10_000_000
    assert script.steps[0].actions == (ChangeAction({"oil.viscosity": 0.05}), ResetAction())
    assert [step.time_ns for step in script.steps] == [0, 2_000_000, 5_000_000, 6_000_000]
    assert [step.commands.load_torque for step in script.steps[1:]] == [20.0, 30.0, 40.0]
    first = script.steps[0].commands
    assert agree(first, Commands(1.0, 2.0, 300.0)) and not agree(first, Commands(1.0, 2.0, 301.0))
    with pytest.raises(
        UsageError, match=r"the profile has commands or events 0\.002 s .*\.chunk = 0\.001 s$"
    ):
        profile_script(profile, 3_000_000)
