"""The engine against the referee: two programs that share nothing but the model integrate the same run."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import newton

from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.parameters import Parameters, load
from gear_dynamics_ros.signals import CHANNEL_NAMES
from support.measurements import PUBLISHED
from support.paths import CASES
from support.referee import CHANNELS, Referee, clearest, nested

SAMPLES = 101  # the first millisecond
NANOMETRE = 1e-9
ANGLES = ("driving_angle", "mesh_phase")

ROUGH: dict[str, Any] = {
    "operation.control": "torque",
    "operation.speed": 1000.0,
    "mesh.stiffness_cos": [0.12],
    "mesh.error_cos": [1.0e-5],
    "bearings.driving.clearance": 3.6e-5,
    "bearings.driven.clearance": 3.6e-5,
}
UNEQUAL: dict[str, Any] = {
    "gears.driving.teeth": 23,
    "gears.driven.teeth": 41,
    "gears.driving.mass": 0.6,
    "gears.driven.mass": 1.9,
    "gears.driving.inertia": 4.0e-4,
    "gears.driven.inertia": 4.1e-3,
    "operation.drive_torque": 20.0,
    "operation.load_torque": 20.0 * 41 / 23,
    "mesh.stiffness_cos": [0.1, 0.03],
    "mesh.stiffness_sin": [0.02, 0.0, 0.01],
    "mesh.error_mean": 2.0e-6,
    "mesh.error_cos": [6.0e-6, 0.0, 1.0e-6],
    "mesh.error_sin": [2.0e-6, 1.5e-6],
    "surface.driven.offset": 0.7,
    "surface.driving.roughness": 1.6e-6,
}
LOPSIDED: dict[str, Any] = {
    "bearings.driving.clearance": 1.5e-5,
    "bearings.driving.restitution": 0.7,
    "bearings.driving.length": 0.02,
    "bearings.driven.oil_clearance": 1.0e-4,
    "bearings.driven.kelvin_stiffness": 3.0e8,
    "bearings.driven.kelvin_damping": 800.0,
    "bearings.driven.restitution": 0.35,
}
BACK: dict[str, Any] = {"operation.drive_torque": -40.0, "operation.load_torque": -40.0}
# The default gearbox at 15500 rpm, where the surface's highest waves last six steps.
FAST: dict[str, Any] = {name: Parameters.from_flat({}).to_flat()[name] for name in ROUGH}
FAST |= {"operation.control": "torque", "operation.speed": 1623.156}
RUNS: dict[str, dict[str, Any]] = {
    "traditional, refined, 15500 rpm": {"model": "traditional", **FAST},
    "compared, refined, 15500 rpm": {"model": "compared", **FAST},
    "improved, refined, 15500 rpm": {"model": "improved", **FAST},
    "improved, back flank, unbalanced": {
        "model": "improved",
        "operation.drive_torque": -30.0,
        "operation.load_torque": -20.0,
    },
    "traditional, published": {"model": "traditional", **PUBLISHED},
    "compared, published": {"model": "compared", **PUBLISHED},
    "improved, published": {"model": "improved", **PUBLISHED},
    "traditional, refined": {"model": "traditional"},
    "compared, refined": {"model": "compared"},
    "improved, refined": {"model": "improved"},
    "improved, unequal gears, harmonics": {"model": "improved", **UNEQUAL},
    "compared, published, unequal gears and bearings": {
        "model": "compared",
        **PUBLISHED,
        **UNEQUAL,
        **LOPSIDED,
    },
    "traditional, unequal bearings": {"model": "traditional", **LOPSIDED},
    "improved, back flank": {"model": "improved", "operation.speed": 628.0, **BACK},
    "traditional, published, back flank": {"model": "traditional", **PUBLISHED, **BACK},
    "improved, from rest, governed": {
        "model": "improved",
        "operation.initial": "rest",
        "operation.control": "speed",
        "operation.speed": 50.0,
    },
    "compared, backwards against a brake": {
        "model": "compared",
        "operation.speed": -300.0,
        "operation.load_law": "brake",
        "operation.load_viscous": 0.02,
    },
    "improved, reversal through zero": {
        "model": "improved",
        "operation.speed": 3.0,
        "operation.drive_torque": -60.0,
        "operation.load_torque": 30.0,
    },
    "improved, reversal through zero under load": {
        "model": "improved",
        "operation.speed": 8.0,
        "operation.drive_torque": 20.0,
        "operation.load_torque": 120.0,
    },
}


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


def spread(channel: str, values: NDArray[np.float64]) -> float:
    """What a channel's error is measured against: its range over the run, angles unwrapped.

    A channel that stands still has to agree to rounding.
    """
    if channel in ANGLES:
        values = np.unwrap(values)
    return max(float(np.ptp(values)), 1e-9 * float(np.abs(values).max()), 1e-30)


def disagreement(
    samples: NDArray[np.float64], expected: NDArray[np.float64], channels: int
) -> dict[str, float]:
    """Largest difference of each channel, as a fraction of its range; angles on the circle."""
    found = {}
    for column, channel in enumerate(CHANNELS[:channels]):
        difference = samples[:, column] - expected[:, column]
        if channel in ANGLES:
            difference = (difference + np.pi) % (2.0 * np.pi) - np.pi
        found[channel] = float(np.abs(difference).max()) / spread(channel, expected[:, column])
    return found


def dte_error(samples: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Largest difference in DTE, m."""
    return float(np.abs(samples[:, 1] - expected[:, 1]).max())


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
    samples = Engine(load(CASES / f"{name}.yaml")).advance(SAMPLES).samples
    assert np.abs(samples[:, 1] - recorded[:, 1]).max() < goal * NANOMETRE
    off = disagreement(samples, recorded, 27)
    assert max(off.values()) < 1e-5, off


@pytest.mark.parametrize("name", RUNS)
def test_engine_agrees_with_the_referee(name: str) -> None:
    expected = refereed(name)
    samples = run_engine(name, 1e-6)
    assert dte_error(samples, expected) < 0.1 * NANOMETRE
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
    p = Parameters.from_flat(grazing(name, depth))
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
