"""What --vary accepts, and what it makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.identification.unknowns import read_unknowns, trial_parameters
from gear_dynamics_ros.parameters import Parameters


def test_a_pattern_ties_what_it_matches() -> None:
    (unknown,) = read_unknowns(["bearings.*.clearance=20e-6:40e-6"], Parameters())
    assert [str(entry) for entry in unknown.entries] == [
        "bearings.driving.clearance",
        "bearings.driven.clearance",
    ]
    bearings = trial_parameters(Parameters(), [unknown], np.array([0.5])).bearings
    assert bearings.driving.clearance == bearings.driven.clearance == pytest.approx(30e-6)
    assert unknown.unit == "m"


def test_a_list_ties_too_and_a_number_of_a_list_is_varied_alone() -> None:
    base = Parameters.from_flat({"mesh.error_cos": [9e-6, 1e-6]})
    options = ["mesh.error_cos[1],mesh.error_mean=0:4e-6", "mesh.error_cos[0]=0:2e-5"]
    mesh = trial_parameters(base, read_unknowns(options, base), np.array([0.5, 0.25])).mesh
    assert (mesh.error_cos, mesh.error_mean) == ((5e-6, 2e-6), 2e-6)


def test_bounds_far_apart_are_crossed_by_ratios() -> None:
    (unknown,) = read_unknowns(["oil.viscosity=0.001:0.1"], Parameters())
    assert unknown.value(0.5) == pytest.approx(0.01)
    assert unknown.coordinate(unknown.value(0.3)) == pytest.approx(0.3)
    step = 1e-6
    slope = (unknown.value(0.3 + step) - unknown.value(0.3 - step)) / (2 * step)
    assert unknown.slope(unknown.value(0.3)) == pytest.approx(slope)
    assert (unknown.value(0.0), unknown.value(1.0)) == (0.001, 0.1)


def test_the_start_is_the_value_of_the_parameters_if_it_is_within_the_bounds() -> None:
    inside, outside = read_unknowns(["mesh.stiffness=2e8:4e8", "oil.viscosity=0.1:0.2"], Parameters())
    assert (inside.start(Parameters()), outside.start(Parameters())) == (0.5, 0.5)
    low = Parameters.from_flat({"mesh.stiffness": 2.5e8})
    assert inside.start(low) == 0.25


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("mesh.stiffnes=1e8:2e8", "did you mean mesh.stiffness"),
        ("mesh=1:2", "is a group"),
        ("bearings.*.clearence=1e-5:2e-5", "no parameter matches bearings.*.clearence"),
        ("mesh.stiffness", "write NAME=LOW:HIGH"),
        ("mesh.stiffness=1e8", "write NAME=LOW:HIGH"),
        ("mesh.stiffness=1e8:high", "'high' is not a finite number"),
        ("mesh.stiffness=1e8:inf", "'inf' is not a finite number"),
        ("mesh.stiffness=2e8:1e8", "the lower bound 200000000 must be less than the upper bound 100000000"),
        ("mesh.stiffness=1e8:1e8", "must be less than"),
        ("bearings.driving.restitution=0.01:0.5", "the bound 0.01 must be >= 0.05 and <= 1"),
        ("surface.driving.fractal_dimension=1.0:1.5", "the bound 1 must be > 1 and < 2"),
        ("gears.driving.teeth=20:40", "only real numbers can be fitted"),
        ("mesh.error_cos=0:1e-5", "name one of its numbers, such as mesh.error_cos[0]"),
        ("mesh.error_cos[1]=0:1e-5", "mesh.error_cos has 1 numbers"),
        ("mesh.error_mean[0]=0:1e-5", "is not a list"),
        ("mesh.stiffness,oil.viscosity=1:2", "ties parameters in N/m and Pa s"),
        ("mesh.error_cos[x]=0:1", "is not the name of a parameter"),
    ],
)
def test_what_can_not_be_varied_is_refused_in_words(option: str, told: str) -> None:
    with pytest.raises(UsageError) as refused:
        read_unknowns([option], Parameters())
    assert told in str(refused.value)


def test_nothing_is_varied_twice_and_something_must_be() -> None:
    with pytest.raises(UsageError, match=r"bearings\.driven\.clearance is varied twice"):
        read_unknowns(["bearings.*.clearance=1e-5:2e-5", "bearings.driven.clearance=1e-5:2e-5"], Parameters())
    with pytest.raises(UsageError, match="nothing to fit"):
        read_unknowns([], Parameters())
