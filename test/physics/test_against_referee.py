"""The engine against the referee: two programs that share nothing but the model integrate the same run."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import newton

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.parameters import Parameters, load_parameters
from gear_dynamics_ros.simulation.engine import Engine
from support.measurements import PUBLISHED
from support.paths import CASES
from support.referee import CHANNELS, Referee, clearest, nested
from support.referee_runs import NANOMETRE, ROUGH, RUNS, SAMPLES, disagreement, dte_error

BACKWARDS: dict[str, Any] = {
    "operation.speed": 800.0,
    "operation.drive_torque": -30.0,
    "operation.load_torque": -20.0,
}


class Graze(NamedTuple):
    """A run that only just meets an event: how, the parameter to tune, the event and when to look for it."""

    changes: dict[str, Any]
    parameter: str
    guess: float
    event: str
    window: tuple[float, float]  # s

    @property
    def depths(self) -> tuple[float, ...]:
        return FORCES if self.event == "mesh clamp" else GAPS

    def is_plain(self, depth: float) -> bool:
        """Whether the kernel's own error at 1 us leaves no doubt that the event happens, or doesn't."""
        return abs(depth) >= 0.1 * self.depths[-1]


BEARING = ("bearings.driving.clearance", 9.0e-6, "bearing 0 strikes", (1.0e-4, 2.15e-4))
BACK_FLANK = ("gears.backlash", 4.5e-5, "back flank meets", (1.0e-4, 2.4e-4))
GRAZES: dict[str, Graze] = {
    "traditional, bearing": Graze({"model": "traditional", **BACKWARDS}, *BEARING),
    "compared, bearing": Graze({"model": "compared", **BACKWARDS}, *BEARING),
    "improved, bearing": Graze({"model": "improved", **BACKWARDS}, *BEARING),
    "traditional, back flank": Graze({"model": "traditional"}, *BACK_FLANK),
    "improved, back flank": Graze({"model": "improved"}, *BACK_FLANK),
    "compared, published, back flank": Graze({"model": "compared", **PUBLISHED}, *BACK_FLANK),
    "compared, drive flank": Graze(
        {"model": "compared", "operation.speed": 300.0},
        *("operation.drive_torque", 30.0, "drive flank meets", (3.1e-4, 3.7e-4)),
    ),
    "improved, mesh clamp": Graze(
        {"model": "improved", **BACKWARDS},
        *("operation.drive_torque", -34.0, "mesh clamp", (6.3e-5, 6.7e-5)),
    ),
    "improved, mesh clamp between steps": Graze(
        {"model": "improved", **BACKWARDS, "operation.speed": 795.0},
        *("operation.drive_torque", -34.0, "mesh clamp", (6.3e-5, 6.75e-5)),
    ),
}
# How far the surface is overstepped: a gap in m, a clamp in N; negative: it is not reached.
GAPS = (-1e-9, -1e-12, 1e-12, 1e-11, 1e-10, 1e-9)
FORCES = (-10.0, -0.01, 0.01, 0.1, 1.0, 10.0)
DEPTHS = [(name, depth) for name, graze in GRAZES.items() for depth in graze.depths]


@cache
def refereed(name: str) -> NDArray[np.float64]:
    """The referee's samples of one of RUNS."""
    return Referee(nested(Parameters.from_flat({**ROUGH, **RUNS[name]}).to_flat())).run(SAMPLES)


def run_engine(name: str, step: float) -> NDArray[np.float64]:
    p = Parameters.from_flat({**ROUGH, **RUNS[name], "solver.step": step})
    return Engine(p).advance(SAMPLES).samples


@cache
def touching(name: str) -> tuple[float, float]:
    """Value of the tuned parameter that just touches the surface, and the slope of the closest approach."""
    graze = GRAZES[name]

    def approach(value: float) -> float:
        tree = nested(Parameters.from_flat({**ROUGH, **graze.changes, graze.parameter: value}).to_flat())
        return clearest(tree, graze.event, graze.window)

    value = float(newton(approach, graze.guess, x1=1.001 * graze.guess, tol=1e-12 * abs(graze.guess)))
    shift = 1e-5 * graze.guess
    return value, (approach(value + shift) - approach(value - shift)) / (2.0 * shift)


def grazing(name: str, depth: float) -> dict[str, Any]:
    """Parameters of a run that oversteps the event's surface by ``depth``."""
    graze = GRAZES[name]
    value, slope = touching(name)
    return {**ROUGH, **graze.changes, graze.parameter: value - depth / slope}


def test_same_channels() -> None:
    assert CHANNELS == CHANNEL_NAMES


@pytest.mark.parametrize(("name", "goal"), [("traditional_6000", 0.01), ("refined_9000", 0.1)])
def test_recorded_runs(name: str, goal: float) -> None:
    recorded = np.genfromtxt(CASES / f"{name}.csv", delimiter=",", skip_header=1)[:SAMPLES]
    samples = Engine(load_parameters(CASES / f"{name}.yaml")).advance(SAMPLES).samples
    assert np.abs(samples[:, 1] - recorded[:, 1]).max() < goal * NANOMETRE
    off = disagreement(samples, recorded, 27)
    assert max(off.values()) < 1e-5, off


@pytest.mark.parametrize("name", RUNS)
def test_engine_agrees_with_the_referee_at_the_default_step(name: str) -> None:
    samples = run_engine(name, Parameters.from_flat({}).solver.step)
    goal = 0.1 if "18000 rpm" in name else 0.05
    assert dte_error(samples, refereed(name)) < goal * NANOMETRE


@pytest.mark.parametrize("name", RUNS)
def test_engine_agrees_with_the_referee(name: str) -> None:
    expected = refereed(name)
    samples = run_engine(name, 1e-6)
    assert dte_error(samples, expected) < 0.01 * NANOMETRE
    off = disagreement(samples, expected, len(CHANNELS))
    assert max(off.values()) < 1e-5, off


@pytest.mark.parametrize("name", RUNS)
def test_an_eighth_of_the_step(name: str) -> None:
    assert dte_error(run_engine(name, 0.125e-6), refereed(name)) < 1e-3 * NANOMETRE


@pytest.mark.parametrize("name", [name for name in RUNS if name.startswith("traditional")])
def test_fourth_order_where_the_forces_are_smooth(name: str) -> None:
    """A Hertz contact is no such: it begins with the power 1.5 of the penetration."""
    coarse, fine = (dte_error(run_engine(name, step), refereed(name)) for step in (2e-6, 0.25e-6))
    assert np.log2(coarse / fine) / 3.0 > 3.8


def test_the_film_carries_load_where_the_shafts_reverse() -> None:
    samples = refereed("improved, reversal through zero under load")
    for speed, film in (("driving_speed", "driving_film_force"), ("driven_speed", "driven_film_force")):
        omega = samples[:, CHANNELS.index(speed)]
        at = int(np.argmax(omega < 0.0))
        column = CHANNELS.index(f"{film}_x")
        assert omega[0] > 0.0 and np.hypot(*samples[at, column : column + 2]) > 10.0


@pytest.mark.parametrize(("name", "depth"), DEPTHS)
def test_grazing_contact(name: str, depth: float) -> None:
    graze = GRAZES[name]
    p = Parameters.from_flat({**grazing(name, depth), "solver.step": 1e-6})
    referee, engine = Referee(nested(p.to_flat())), Engine(p)
    expected = referee.run(SAMPLES)
    until = round(graze.window[1] / p.solver.sample_interval)
    before = engine.advance(until)
    samples = np.vstack((before.samples, engine.advance(SAMPLES - until).samples))
    assert dte_error(samples, expected) < 0.1 * NANOMETRE
    off = disagreement(samples, expected, len(CHANNELS))
    assert max(off.values()) < 1e-5, off
    met = [t for t, event in referee.events if event == graze.event and graze.window[0] < t < graze.window[1]]
    assert bool(met) == (depth > 0.0)
    if graze.is_plain(depth):
        assert before.counters.events == sum(t < graze.window[1] for t, _ in referee.events)
