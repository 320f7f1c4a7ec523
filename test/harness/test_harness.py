"""Profiles, their values over time, and expectations evaluated on the way, against NumPy on the whole."""

from __future__ import annotations

import io
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli import drive
from gear_dynamics_ros.cli.progress import ProgressLine
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness.player import Player
from gear_dynamics_ros.harness.profile import Profile, load_profile
from gear_dynamics_ros.harness.profile import parse_profile as parse_profile_in
from gear_dynamics_ros.harness.results import format_results
from gear_dynamics_ros.parameters import Parameters
from support.paths import CONFIG, ROOT

PROFILES = sorted((CONFIG / "profiles").glob("*.yaml"))
CHANNELS = ("time", "dte", "meshing_state")
INTERVAL = 1e-5


def waveform(first: int, samples: int, seed: int = 1) -> NDArray[np.float64]:
    """Samples ``first`` and following of one endless record, shape (samples, 3)."""
    generator = np.random.default_rng(seed)
    whole = generator.normal(size=first + samples), generator.integers(-1, 2, first + samples)
    times = np.arange(first, first + samples) * INTERVAL
    return np.column_stack([times, whole[0][first:], whole[1][first:]])


def parse_profile(data: object) -> Profile:
    return parse_profile_in(data, Path())


def expecting(*entries: dict[str, Any]) -> Profile:
    return parse_profile({"expectations": list(entries)})


def play(profile: Profile, record: NDArray[np.float64], chunks: list[int]) -> Player:
    player = Player(profile, CHANNELS)
    for chunk in np.split(record, np.cumsum(chunks)):
        if len(chunk):
            player.feed(chunk)
    return player


def command(*entries: dict[str, float]) -> Profile:
    return parse_profile({"commands": {"speed": list(entries)}})


def values(profile: Profile, *times: float) -> list[float | None]:
    return [profile.commands["speed"].value(time) for time in times]


def test_steps_and_ramps() -> None:
    profile = command(
        {"at": 1, "value": 10}, {"from": 2.0, "to": 4.0, "value": 20.0}, {"at": 4.0, "value": -5.0}
    )
    assert values(profile, 0.0, 0.999, 1.0, 2.0, 2.5, 3.999999, 4.0, 100.0) == [
        None, None, 10.0, 10.0, 12.5, pytest.approx(20.0, abs=1e-4), -5.0, -5.0,
    ]  # fmt: skip
    assert profile.duration == 4.0


def test_sine_rides_on_the_value_in_force_and_ends_there() -> None:
    profile = command(
        {"at": 0.0, "value": 100.0}, {"from": 1.0, "to": 2.0, "amplitude": 5.0, "frequency": 2.0}
    )
    assert values(profile, 1.0, 1.125, 1.375, 2.0, 3.0) == pytest.approx([100.0, 105.0, 95.0, 100.0, 100.0])


def test_sine_on_a_ramp() -> None:
    profile = command(
        {"at": 0.0, "value": 0.0},
        {"from": 0.0001, "to": 2.0001, "value": 10.0, "amplitude": 1.0, "frequency": 1.0},
    )
    assert values(profile, 0.2501, 2.0001) == pytest.approx([1.25 + 1.0, 10.0])


def test_chirp_has_its_frequencies_at_its_ends() -> None:
    profile = command(
        {"at": 0.0, "value": 0.0},
        {"from": 1.0, "to": 3.0, "amplitude": 1.0, "frequency": 2.0, "end_frequency": 6.0},
    )
    track = profile.commands["speed"]
    step = 1e-6
    slopes = [(track.value(t + step) - track.value(t)) / step for t in (1.0, 3.0 - 2 * step)]  # type: ignore[operator]
    assert slopes == pytest.approx([2 * math.pi * 2.0, 2 * math.pi * 6.0], rel=1e-3)


@pytest.mark.parametrize(
    ("commands", "said"),
    [
        ({"torque": []}, "commands has the unknown key 'torque'"),
        ({"speed": []}, "commands.speed is empty"),
        ({"speed": {"at": 0}}, "commands.speed is {'at': 0}, must be a list"),
        (
            {"speed": [{"at": 0.0, "value": math.nan}]},
            "commands.speed[0].value is nan, must be a finite number",
        ),
        ({"speed": [{"at": math.inf, "value": 1}]}, "commands.speed[0].at is inf, must be a finite number"),
        ({"speed": [{"at": 0.0, "value": True}]}, "commands.speed[0].value is True"),
        ({"speed": [{"at": 0.0, "value": "fast"}]}, "commands.speed[0].value is 'fast'"),
        ({"speed": [{"at": -1.0, "value": 1.0}]}, "commands.speed[0].at is -1 s, must be >= 0"),
        ({"speed": [{"at": 0.0}]}, "commands.speed[0] has no value"),
        ({"speed": [{"at": 0.0, "value": 1.0, "to": 2.0}]}, "commands.speed[0] has the unknown key 'to'"),
        ({"speed": [{"from": 0.0, "to": 1.0, "value": 1.0}]}, "commands.speed[0] has no value to start from"),
        (
            {"speed": [{"at": 1.0, "value": 1.0}, {"at": 1.0, "value": 2.0}]},
            "commands.speed[1] starts at 1 s",
        ),
        (
            {
                "speed": [
                    {"at": 0.0, "value": 1.0},
                    {"from": 1.0, "to": 3.0, "value": 2.0},
                    {"at": 2.0, "value": 2.0},
                ]
            },
            "commands.speed[2] starts at 2 s, before the entry above ends (1 to 3 s)",
        ),
        (
            {"speed": [{"at": 0.0, "value": 1.0}, {"from": 3.0, "to": 3.0, "value": 2.0}]},
            "commands.speed[1].to is 3 s, must be later",
        ),
        ({"speed": [{"at": 0.0, "value": 1.0}, {"from": 1.0, "to": 3.0}]}, "neither value nor amplitude"),
        (
            {
                "speed": [
                    {"at": 0.0, "value": 1.0},
                    {"from": 1.0, "to": 3.0, "amplitude": 1.0, "frequency": 0.0},
                ]
            },
            "commands.speed[1].frequency is 0 Hz, must be > 0",
        ),
        (
            {"speed": [{"at": 0.0, "value": 1.0}, {"from": 1.0, "to": 3.0, "value": 1.0, "frequency": 1.0}]},
            "commands.speed[1].frequency has no amplitude",
        ),
    ],
)
def test_bad_commands_are_refused_by_name(commands: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_profile({"commands": commands})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mean": None}, "expectations[0] must have exactly one of every, smallest"),
        ({"rms": "dte"}, "it has mean and rms"),
        ({"mean": "dta"}, "expectations[0].mean is 'dta', must be one of time, dte"),
        (
            {"mean": None, "share": "front"},
            "expectations[0].share is 'front', must be one of drive, apart, back",
        ),
        ({"maximum": None}, "must have minimum, maximum or both, or else target and tolerance"),
        ({"target": 1.0}, "must have minimum, maximum or both, or else target and tolerance"),
        (
            {"maximum": None, "target": 1.0, "tolerance": -1.0},
            "expectations[0].tolerance is -1, must be >= 0",
        ),
        ({"minimum": 2.0}, "expectations[0].minimum is 2, above its maximum 1"),
        ({"to": 0.0}, "expectations[0].to is 0 s, must be later than its from, 0 s"),
        ({"name": 3}, "expectations[0].name is 3, must be text"),
        ({"limit": 3}, "expectations[0] has the unknown key 'limit'"),
    ],
)
def test_bad_expectations_are_refused_by_name(change: dict[str, Any], said: str) -> None:
    entry = {"from": 0.0, "to": 1.0, "mean": "dte", "maximum": 1.0, **change}
    with pytest.raises(UsageError) as caught:
        expecting({key: value for key, value in entry.items() if value is not None})
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (
            {"mean": "dte", "maximum": 1.0, "within": 0.1},
            "expectations[0] (mean) has the unknown key 'within'; known: name, from, to, mean, minimum",
        ),
        (
            {"settling": "dte", "maximum": 1.0},
            "expectations[0] (settling) has the unknown key 'maximum'",
        ),
        ({"settling": "dte", "tolerance": 0.1, "within": 0.1}, "expectations[0] has no target"),
        ({"settling": "dte", "target": 0.0, "tolerance": 0.1}, "expectations[0] has no within"),
        (
            {"settling": "dte", "target": 0.0, "tolerance": 0.1, "from": 0.5, "within": 0.75},
            "expectations[0].within is 0.75 s, longer than the window (0.5 s)",
        ),
        ({"monotone": "dte"}, "expectations[0] has no direction: give one of rising, falling"),
        ({"monotone": "dte", "direction": "up"}, "expectations[0].direction is 'up', must be one of rising"),
        (
            {"monotone": "dte", "direction": "rising", "tolerance": -1},
            "expectations[0].tolerance is -1, must be >= 0",
        ),
    ],
)
def test_each_measure_takes_its_own_keys(entry: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        expecting({"from": 0.0, "to": 1.0, **entry})
    assert said in str(caught.value)


def test_expectations_are_told_apart_by_name() -> None:
    calm = {"mean": "dte", "from": 0.0, "to": 1.0, "maximum": 1.0}
    assert len({e.name for e in expecting(calm, {**calm, "to": 2.0}).expectations}) == 2
    with pytest.raises(
        UsageError, match=r"expectations\[1\].name is 'calm', the same as that of expectations\[0\]"
    ):
        expecting({**calm, "name": "calm"}, {**calm, "name": "calm"})


def test_parameters_keep_their_types() -> None:
    given = {
        "stepping.chunks": 1,
        "oil.viscosity": 1.5,
        "operation.control": "torque",
        "autostart": True,
        "mesh.error_cos": [1, 0.5],
        "mesh.error_sin": [0],
        "waveform_channels": ["time", "dte"],
    }
    parameters = parse_profile({"duration": 1.0, "parameters": given}).parameters
    assert parameters == given
    assert [type(entry) for entry in parameters["mesh.error_sin"]] == [float]  # type: ignore[union-attr]
    assert type(parameters["stepping.chunks"]) is int


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (["oil.viscosity"], "parameters is ['oil.viscosity'], must be a mapping of dotted names"),
        ({"oil": {"viscosity": 0.1}}, "parameters.oil is {'viscosity': 0.1}, must be one value or a list"),
        ({"mesh.error_cos": [0.1, "x"]}, "parameters.mesh.error_cos is [0.1, 'x']"),
        ({"mesh.error_cos": []}, "parameters.mesh.error_cos is []"),
        ({"mesh.stifness": 3.0e8}, "parameters: there is no parameter mesh.stifness"),
    ],
)
def test_bad_parameters_are_refused_by_name(parameters: object, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_profile({"duration": 1.0, "parameters": parameters})
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (None, "the profile is None, must be a mapping"),
        ([], "the profile is [], must be a mapping"),
        ({}, "duration is 0 s, must be > 0"),
        ({"duration": 0.0}, "duration is 0 s, must be > 0"),
        ({"duration": -1.0}, "duration is -1 s, but an entry ends at 0 s"),
        ({"speed": []}, "the profile has the unknown key 'speed'"),
    ],
)
def test_a_profile_that_plays_nothing_is_refused(data: object, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_profile(data)
    assert said in str(caught.value)


def test_duration_covers_every_entry() -> None:
    with pytest.raises(UsageError, match="duration is 1 s, but an entry ends at 2 s"):
        parse_profile({"duration": 1.0, "commands": {"speed": [{"at": 2.0, "value": 1.0}]}})


def test_numbers_are_read_as_ros_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text("commands: {load_torque: [{at: 1e-3, value: 3e1}]}\n")
    assert load_profile(path).commands["load_torque"].value(1e-3) == 30.0


def test_a_reset_is_wanted_or_not() -> None:
    assert parse_profile({"duration": 1.0, "reset": True}).reset
    assert not parse_profile({"duration": 1.0}).reset
    with pytest.raises(UsageError, match=r"the profile\.reset is 'often', must be true or false"):
        parse_profile({"duration": 1.0, "reset": "often"})


@pytest.mark.parametrize("text", ["commands: [", "a: 1\na: 2\n", "\x00", "commands: !!python/name:os.system"])
def test_text_that_is_no_profile_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", PROFILES, ids=lambda path: path.stem)
def test_shipped_profiles_are_sound(path: Path) -> None:
    profile = load_profile(path)
    assert profile.expectations
    Player(profile, CHANNEL_NAMES)


def test_the_documented_profile_is_sound(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "drive.md").read_text()
    (example,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "profile.yaml").write_text(example)
    (tmp_path / "load.csv").write_text("time,torque\n0.0,30.0\n2.5,50.0\n")
    profile = load_profile(tmp_path / "profile.yaml")
    assert profile.commands["load_torque"].value(3.5) == 50.0
    assert profile.parameters.keys() <= Parameters().to_flat().keys()
    Player(profile, CHANNEL_NAMES)


def test_running_measures_equal_those_of_the_whole() -> None:
    bounds = {"from": 0.00102, "to": 0.00311, "minimum": -9.0}
    profile = expecting(
        *({measure: "dte", **bounds} for measure in ("every", "smallest", "largest", "mean", "rms")),
        *({"share": state, **bounds} for state in ("drive", "apart", "back")),
    )
    origin = 70
    record = waveform(40, 500)
    player = play(profile, record, [30, 1, 2, 97, 3, 110, 64])
    window = record[origin - 40 + 102 : origin - 40 + 311]
    dte, state = window[:, 1], window[:, 2]
    expected = [
        (dte.min(), dte.max()),
        (dte.min(),),
        (dte.max(),),
        (dte.mean(),),
        (np.sqrt(np.mean(dte**2)),),
        ((state == 1).mean(),),
        ((state == 0).mean(),),
        ((state == -1).mean(),),
    ]
    results = player.results()
    for result, value in zip(results, expected, strict=True):
        assert result.values == pytest.approx(value, rel=1e-12)
        assert (result.samples, result.missing, result.complete, result.passed) == (209, 0, True, True)
    assert player.started_at == pytest.approx(origin * INTERVAL)
    assert player.finished


@pytest.mark.parametrize(
    ("limits", "passed"),
    [
        ({"minimum": 1.0}, True),
        ({"minimum": 1.1}, False),
        ({"maximum": 1.0}, True),
        ({"maximum": 0.9}, False),
        ({"target": 1.2, "tolerance": 0.25}, True),
        ({"target": 1.2, "tolerance": 0.15}, False),
    ],
)
def test_limits(limits: dict[str, float], passed: bool) -> None:
    record = waveform(0, 200)
    record[:, 1] = 1.0
    (result,) = play(expecting({"mean": "dte", "from": 0.0, "to": 0.001, **limits}), record, [100]).results()
    assert result.passed is passed
    assert "is 1 m, expected" in result.reason()


@pytest.mark.parametrize("measure", ["every", "smallest", "largest", "mean", "rms"])
def test_a_nan_never_passes(measure: str) -> None:
    record = waveform(0, 300)
    record[150, 1] = math.nan
    (result,) = play(
        expecting({measure: "dte", "from": 0.0, "to": 0.002, "minimum": -1e9, "maximum": 1e9}),
        record,
        [100, 100],
    ).results()
    assert not result.passed


def test_lost_samples_fail_what_needed_them_and_nothing_else() -> None:
    profile = expecting(
        {"mean": "dte", "from": 0.0, "to": 0.001, "minimum": -9.0},
        {"mean": "dte", "from": 0.001, "to": 0.003, "minimum": -9.0},
    )
    record = waveform(0, 400)
    player = Player(profile, CHANNELS)
    for first in (0, 100, 300):
        player.feed(record[first : first + 100])
    before, across = player.results()
    assert before.passed
    assert (across.samples, across.missing, across.passed) == (100, 100, False)
    assert "lacks 100 of 200 samples" in across.reason()


def test_a_window_between_two_samples_is_told() -> None:
    profile = expecting({"mean": "dte", "from": 0.000501, "to": 0.000502, "minimum": -9.0})
    (result,) = play(profile, waveform(0, 200), [100]).results()
    assert not result.passed
    assert result.reason().endswith("holds no sample: lengthen it")


def test_an_unfinished_window_has_not_passed() -> None:
    profile = expecting({"mean": "dte", "from": 0.0, "to": 0.002, "minimum": -9.0})
    (before,) = Player(profile, CHANNELS).results()
    (midway,) = play(profile, waveform(0, 200), [100]).results()
    assert not before.passed
    assert not midway.passed
    assert midway.missing == 0
    assert "was not reached" in midway.reason()
    assert format_results([midway]).splitlines()[1].startswith("open")


def test_time_that_runs_back_is_an_error() -> None:
    player = Player(expecting({"mean": "dte", "from": 0.0, "to": 0.1, "minimum": -9.0}), CHANNELS)
    player.feed(waveform(500, 100))
    player.feed(waveform(600, 100))
    with pytest.raises(GearboxError, match=r"simulated time went back from 0\.007 s to 0 s"):
        player.feed(waveform(0, 100))


def test_a_missing_channel_is_named() -> None:
    profile = expecting({"name": "x", "mean": "mesh_force", "from": 0.0, "to": 1.0, "minimum": 0.0})
    with pytest.raises(
        GearboxError, match=r"channel mesh_force is needed by expectation 'x'.*waveform_channels"
    ):
        Player(profile, CHANNELS)


def test_a_frequency_that_a_chunk_cannot_carry_is_refused() -> None:
    profile = command(
        {"at": 0.0, "value": 0.0}, {"from": 1.0, "to": 2.0, "amplitude": 1.0, "frequency": 600.0}
    )
    with pytest.raises(GearboxError, match=r"commands.speed asks for 600 Hz.*at most 500 Hz"):
        Player(profile, CHANNELS).feed(waveform(0, 100))


def due(player: Player, chunk: NDArray[np.float64]) -> dict[str, float]:
    player.feed(chunk)
    return player.commands()


def test_commands_are_due_at_the_end_of_the_chunk_before_them() -> None:
    profile = command(
        {"at": 0.0, "value": 1.0}, {"at": 0.002, "value": 2.0}, {"from": 0.002001, "to": 0.01, "value": 3}
    )
    player = Player(profile, CHANNELS)
    assert due(player, waveform(300, 100)) == {"speed": 1.0}
    assert due(player, waveform(400, 100)) == {"speed": 1.0}
    assert due(player, waveform(500, 100)) == {"speed": 2.0}
    assert 2.0 < due(player, waveform(600, 100))["speed"] < 3.0


def test_table_is_aligned_and_names_failures() -> None:
    profile = expecting(
        {"name": "calm", "rms": "dte", "from": 0.0, "to": 0.001, "maximum": 0.5},
        {"name": "back flanks carry", "share": "back", "from": 0.0, "to": 0.001, "minimum": 0.1},
    )
    lines = format_results(play(profile, waveform(0, 200), [100]).results()).splitlines()
    assert len(lines) == 3
    assert lines[1].startswith("FAIL  calm")
    assert lines[2].startswith("pass  back flanks carry")
    assert lines[1].index("rms of dte") == lines[2].index("share of back") == lines[0].index("measure")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    profile = parse_profile(
        {
            "commands": {"speed": [{"at": 0.0, "value": 123.0}]},
            "expectations": [
                {"mean": "dte", "from": 0.0, "to": 0.001, "minimum": 9.0},
                {"mean": "dte", "from": 0.0, "to": 0.003, "minimum": -9.0},
            ],
        }
    )
    player = Player(profile, CHANNELS)
    player.feed(waveform(0, 100))
    player.acted(100, Commands(drive_torque=0.0, load_torque=0.0, speed=123.0))
    player.feed(waveform(100, 100))
    for terminal, expected in (
        (Terminal(), "0.00 of 0.003 s  speed 123  expectations: 0 passed, 1 failed, 1 to come"),
        (io.StringIO(), ""),
    ):
        monkeypatch.setattr(sys, "stderr", terminal)
        with ProgressLine() as line:
            drive._Watch(line)(player)
        assert expected in terminal.getvalue()
        assert bool(terminal.getvalue()) is bool(expected)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [([], "PROFILE"), (["p.yaml", "--wait", "0"], "--wait"), (["p.yaml", "--timeout", "nan"], "--timeout")],
)
def test_bad_usage_exits_2(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        drive.drive_main(arguments)
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert "drive: error:" in error and said in error.splitlines()[-1]


def test_a_missing_profile_exits_2_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert drive.drive_main([str(tmp_path / "none.yaml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        line
        == f"drive: error: profile {tmp_path}/none.yaml: No such file or directory; name a readable YAML file"
    )
