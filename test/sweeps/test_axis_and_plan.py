"""Ranges as they are typed, and the points and branches that they give."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.sweeps import Measurement, SweepPlan, parse_axis

SHORT = Measurement(0, 2)


def plan(*over: str, models: tuple[str, ...] = ("improved",), direction: str = "independent") -> SweepPlan:
    return SweepPlan(Parameters(), tuple(map(parse_axis, over)), models, SHORT, direction)


def test_a_range_holds_both_ends_in_si_units() -> None:
    axis = parse_axis("operation.speed=2000:18000:801rpm")
    assert axis.unit == "rad/s" and len(axis.values) == 801
    assert axis.values[0] == pytest.approx(2000 * math.pi / 30) and axis.values[-1] == pytest.approx(
        600 * math.pi
    )
    steps = np.diff(np.array(axis.values, dtype=float))
    assert steps == pytest.approx(np.full(800, 20 * math.pi / 30))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("gears.backlash=40,50um", (40e-6, 50e-6)),
        ("gears.pressure_angle=20,22.5deg", (math.radians(20), math.radians(22.5))),
        ("oil.viscosity=0.02,3e-2", (0.02, 0.03)),
        ("surface.waves=4:8:3", (4, 6, 8)),
        ("mesh.error_cos[0]=5:10:2um", (5e-6, 1e-5)),
        ("mesh_geometry=exact,published", ("exact", "published")),
        ("start.dte=-20:20:3um", (-2e-5, 0.0, 2e-5)),
        ("operation.load_torque=10,20N m", (10.0, 20.0)),
    ],
)
def test_ranges_and_lists_are_read(text: str, values: tuple[float, ...]) -> None:
    if text.endswith("N m"):
        with pytest.raises(UsageError):
            parse_axis(text)
        return
    found = parse_axis(text).values
    assert [type(value) for value in found] == [type(value) for value in values]
    assert found == (values if isinstance(values[0], str) else pytest.approx(values, abs=1e-18))


def test_a_pattern_sets_all_it_names() -> None:
    axis = parse_axis("bearings.*.restitution=0.2,1.0")
    assert [target.name for target in axis.targets] == [
        "bearings.driving.restitution",
        "bearings.driven.restitution",
    ]
    parameters = plan("bearings.*.restitution=0.2,1.0").parameters_at((0, 0, 1))
    assert parameters.bearings.driving.restitution == parameters.bearings.driven.restitution == 1.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("operation.speed", "is not a range"),
        ("operation.sped=1,2", "did you mean operation.speed"),
        ("operation.speed=1:2", "write START:STOP:COUNT"),
        ("operation.speed=1:2:1", "COUNT = 1 must be a whole number from 2 to 100000"),
        ("operation.speed=1:2:2.5", "COUNT = 2.5 must be a whole number"),
        ("operation.speed=1,a", "'a' is not a number"),
        ("operation.speed=1,nan", "must be finite|is not a number"),
        ("operation.speed=1,2um", "the unit um doesn't fit: write rpm or none for rad/s"),
        ("operation.speed=5,5", "5.0 is given twice"),
        ("operation.speed=7,2e6", "2e+06|2000000"),
        ("mesh.error_cos=1,2", "is a list: name one of its numbers"),
        ("gears.backlash[0]=1,2", "is not a list: leave"),
        ("surface.waves=4,4.5", "must be a whole number"),
        ("autostart=true", "true or false, which can't be swept"),
        ("mesh_phase=nominal,wrong", "wrong"),
        ("bearings.*.nothing=1,2", "no parameter matches"),
        ("gears.driving.*=1,2", "different kinds"),
    ],
)
def test_what_is_no_range_is_refused_in_words(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace("+", r"\+")):
        parse_axis(text)


@pytest.mark.parametrize(
    ("over", "models", "direction", "words"),
    [
        ((), ("improved",), "independent", "at least one range"),
        (("oil.viscosity=1e-2,2e-2", "oil.*=3e-2,4e-2"), ("improved",), "independent", "different kinds"),
        (("oil.viscosity=1e-2,2e-2",) * 2, ("improved",), "independent", "set the same parameter"),
        (("model=improved,compared",), ("improved",), "independent", "give --models"),
        (("oil.viscosity=1e-2,2e-2",), ("better",), "independent", "'better' must be one of"),
        (("oil.viscosity=1e-2,2e-2",), ("improved",) * 2, "independent", "each of them once"),
        (("start.dte=1,2um",), ("improved",), "up", "can't be swept up"),
        (("mesh_phase=nominal,actual",), ("improved",), "both", "can't be swept both"),
        (("oil.viscosity=1e-2:1:1001", "operation.speed=1:2:1001"), ("improved",), "up", "1002001 points"),
    ],
)
def test_plans_that_cannot_be_are_refused(
    over: tuple[str, ...], models: tuple[str, ...], direction: str, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        plan(*over, models=models, direction=direction)


@given(st.sampled_from(["independent", "up", "down", "both"]), st.integers(2, 5), st.integers(2, 4))
def test_the_branches_hold_every_point_once(direction: str, first: int, second: int) -> None:
    swept = plan(f"operation.speed=500:400:{first}", f"oil.viscosity=0.01:0.02:{second}", direction=direction)
    points = [point for branch in swept.branches() for point in branch.points]
    assert sorted(points) == list(swept.points()) and len(points) == swept.size
    for branch in swept.branches():
        speeds = [swept.settings(point)["operation.speed"] for point in branch.points]
        assert speeds == sorted(speeds, reverse=swept.ways[branch.points[0][1]] == "down")
