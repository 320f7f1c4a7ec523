"""Replayed CSV files: what is read, what lies between rows, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.profile import Profile, load_profile
from gear_dynamics_ros.harness.series import CommandSeries, hold_last_value, interpolate_linear, load_series

MakeProfile = Callable[..., Profile]
finite = st.floats(-1e6, 1e6)


@pytest.fixture
def profile(tmp_path: Path) -> MakeProfile:
    """``profile("time,speed\\n...", "extra: keys")``: a profile that replays such a file from 1 s on."""

    def make(rows: str, extra: str = "", before: str = "") -> Profile:
        (tmp_path / "data").mkdir(exist_ok=True)
        (tmp_path / "data" / "run.csv").write_bytes(rows.encode())
        entry = f"{{from: 1.0, csv: data/run.csv{', ' if extra else ''}{extra}}}"
        (tmp_path / "profile.yaml").write_text(f"commands: {{speed: [{before}{entry}]}}")
        return load_profile(tmp_path / "profile.yaml")

    return make


def values(profile: Profile, *times: float) -> list[float | None]:
    return [profile.commands["speed"].value(time) for time in times]


def test_rows_are_joined_by_straight_lines_and_the_last_value_stays(profile: MakeProfile) -> None:
    played = profile("time,speed\n0,10\n0.5,20\n2,-10\n")
    assert values(played, 0.999, 1.0, 1.25, 1.5, 2.25, 3.0, 9.0) == [
        None,
        10.0,
        15.0,
        20.0,
        5.0,
        -10.0,
        -10.0,
    ]
    assert played.duration == 3.0


def test_held_rows_make_steps(profile: MakeProfile) -> None:
    played = profile("time,speed\n0,10\n0.5,20\n2,-10\n", "interpolation: held")
    assert values(played, 1.0, 1.499, 1.5, 2.999, 3.0, 9.0) == [10.0, 10.0, 20.0, 20.0, -10.0, -10.0]


def test_another_column_from_a_spreadsheet(profile: MakeProfile) -> None:
    played = profile("\ufefftime, rig speed ,note\r\n0,1e2,a\r\n\r\n1,2e2,b\r\n", "column: rig speed")
    assert values(played, 1.0, 1.5, 2.0) == [100.0, 150.0, 200.0]


def test_a_ramp_goes_on_from_the_last_row(profile: MakeProfile, tmp_path: Path) -> None:
    profile("time,speed\n0,10\n1,20\n")
    (tmp_path / "profile.yaml").write_text(
        "commands: {speed: [{at: 0, value: 5}, {from: 1, csv: data/run.csv}, {from: 2, to: 4, value: 0}]}"
    )
    assert values(load_profile(tmp_path / "profile.yaml"), 0.5, 1.5, 3.0) == [5.0, 15.0, 10.0]


@pytest.mark.parametrize(
    ("rows", "extra", "said"),
    [
        ("", "", "line 1: 0 columns 'time'"),
        ("time,torque\n0,1\n", "", "line 1: 0 columns 'speed' in 'time, torque', must be one"),
        ("time,speed,speed\n0,1,1\n", "", "line 1: 2 columns 'speed'"),
        ("time,speed\n", "", "no rows below the line of column names"),
        ("time,speed\n0.1,1\n", "", "line 2: the first time is 0.1 s, must be 0"),
        ("time,speed\n0,1\n1,2\n1,3\n", "", "line 4: time is 1 s, must be later than 1 s above"),
        ("time,speed\n0,1\n1\n", "", "line 3: 1 columns, must be 2"),
        ("time,speed\n0,fast\n", "", "line 2: speed is 'fast', must be a finite number"),
        ("time,speed\n0,nan\n", "", "line 2: speed is 'nan', must be a finite number"),
        ("time,speed\n0,1_0\n", "", "line 2: speed is '1_0', must be a finite number"),
        ('time,speed\n0,"1\n', "", "not CSV text"),
        (
            "time,speed\n0,1\n",
            "interpolation: cubic",
            "interpolation is 'cubic', must be one of linear, held",
        ),
        ("time,speed\n0,1\n", "value: 3", "has the unknown key 'value'; known: from, csv, column"),
    ],
)
def test_bad_files_are_refused_by_line(profile: MakeProfile, rows: str, extra: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        profile(rows, extra)
    message = str(caught.value)
    assert said in message
    assert "profile.yaml: commands.speed[0]" in message
    assert "\n" not in message


def test_a_missing_file_is_named(profile: MakeProfile, tmp_path: Path) -> None:
    profile("time,speed\n0,1\n")
    (tmp_path / "data" / "run.csv").unlink()
    with pytest.raises(UsageError, match=r"commands\.speed\[0\]: .*data/run\.csv: No such file"):
        load_profile(tmp_path / "profile.yaml")


@given(
    rows=st.lists(st.tuples(st.integers(1, 10**6), finite), max_size=20), first=finite, time=st.floats(0, 30)
)
def test_both_interpolations_against_a_search_by_hand(
    rows: list[tuple[int, float]], first: float, time: float
) -> None:
    times = np.concatenate([[0.0], np.cumsum([step for step, _ in rows]) * 1e-6])
    series = CommandSeries(times, np.array([first, *(value for _, value in rows)]))
    before = max(row for row in range(len(times)) if times[row] <= time)
    assert hold_last_value(series, time) == series.values[before]
    expected = np.interp(time, times, series.values)
    assert interpolate_linear(series, time) == pytest.approx(expected, rel=1e-12, abs=1e-9)
    assert interpolate_linear(series, times[before]) == series.values[before]
    assert interpolate_linear(series, times[-1] + time) == series.values[-1]


def test_load_series_reads_what_numpy_reads(tmp_path: Path) -> None:
    table = np.column_stack([np.arange(100) * 0.01, np.random.default_rng(1).normal(size=(100, 2))])
    path = tmp_path / "run.csv"
    np.savetxt(path, table, delimiter=",", header="time,a,b", comments="", fmt="%.17g")
    series = load_series(path, "b")
    np.testing.assert_array_equal(series.times, table[:, 0])
    np.testing.assert_array_equal(series.values, table[:, 2])
