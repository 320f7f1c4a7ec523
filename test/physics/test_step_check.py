"""The step against the model's rates: closed forms of the rates, and what is said about them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.parameters import Parameters, load_parameters
from gear_dynamics_ros.physics import step_check
from gear_dynamics_ros.physics.advice import parameter_warnings
from gear_dynamics_ros.physics.kernel.film import capone_film
from support.paths import CONFIG

STEADY = {"mesh.stiffness_cos": [0.0], "model": "traditional"}
FREE = {"bearings.driving.kelvin_stiffness": 1.0, "bearings.driven.kelvin_stiffness": 1.0}
HELD = {"gears.driving.mass": 1e6, "gears.driven.mass": 1e6}


def hertz(changes: dict[str, Any]) -> float:
    """Highest natural frequency in Hz."""
    return step_check.natural_frequency(Parameters.from_flat(changes)) / (2.0 * math.pi)


@pytest.mark.parametrize("config", ["gearbox.yaml", "paper.yaml"])
@pytest.mark.parametrize("model", ["traditional", "compared", "improved"])
def test_the_packages_configurations_need_no_warning(config: str, model: str) -> None:
    assert parameter_warnings(load_parameters(CONFIG / config, [f"model={model}"])) == []


@pytest.mark.parametrize(
    ("changes", "expected", "tolerance"),
    [(HELD, 4654.6, 1e-5), (FREE, 6071.5, 1e-5), ({}, 6160.4, 1e-5)],
    ids=["torsion alone", "free gears", "Kelvin bearings closed"],
)
def test_natural_frequency_in_closed_form(changes: dict[str, Any], expected: float, tolerance: float) -> None:
    assert hertz({**STEADY, **changes}) == pytest.approx(expected, rel=tolerance)


def test_the_mesh_counts_at_its_stiffest() -> None:
    modulated = hertz({**STEADY, **FREE, "mesh.stiffness_cos": [0.0, 0.2], "mesh.stiffness_sin": [0.0, 0.1]})
    peak = 1.0 + math.hypot(0.2, 0.1)
    assert modulated == pytest.approx(math.sqrt(peak) * 6071.5, rel=1e-3)


@pytest.mark.parametrize("eps", [0.0, 0.18, 0.9])
def test_film_damping_is_the_kernels(eps: float) -> None:
    speed = 1e-3
    fx, _ = capone_film(1.0, 0.0, eps, 0.0, speed, 0.0)
    assert step_check.film_damping(1.0, eps) == pytest.approx(-fx / speed, rel=1e-12)


def test_film_damping_of_a_centred_shaft() -> None:
    assert step_check.film_damping(1.0, 0.0) == pytest.approx(2.0 * math.pi, rel=1e-15)


def test_mesh_damping_of_free_gears() -> None:
    p = Parameters.from_flat({"mesh.damping_ratio": 0.1})
    torsion, free = 2.0 * math.pi * 4654.57885, 2.0 * math.pi * 6071.51397
    assert step_check.mesh_damping_rate(p) == pytest.approx(2.0 * 0.1 * free**2 / torsion, rel=1e-7)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"solver.step": 1e-5, "model": "compared", "mesh.stiffness": 6e8},
            ("natural frequency", "more than 0.5: it is integrated coarsely"),
        ),
        (
            {"mesh.stiffness": 1e13, "mesh.damping_ratio": 0.0},
            ("natural frequency", "more than 2.83: the method is unstable"),
        ),
        ({"mesh.damping_ratio": 10.0, "solver.step": 5e-6}, ("damping rate of the mesh", "more than 2.79")),
        (
            {"model": "traditional", "bearings.driving.kelvin_damping": 1.5e6},
            ("damping rate of the driving bearing (1.5e+06 1/s) is 3, more than", "solver.step to 1.9e-06 s"),
        ),
        ({"oil.viscosity": 200.0}, ("damping rate of the driven oil film", "the method is unstable")),
        ({"operation.speed": 3000.0}, ("shortest wave", "fewer than 2 steps")),
        (
            {"operation.speed": 3000.0, "mesh.error_cos": [0.0] * 7 + [1e-6]},
            ("highest harmonic (1.528e+05 1/s) is 0.306", "fewer than 4 steps"),
        ),
    ],
)
def test_what_the_step_does_not_bear_is_named(changes: dict[str, Any], said: tuple[str, ...]) -> None:
    lines = parameter_warnings(Parameters.from_flat(changes))
    assert any(all(part in line for part in said) for line in lines), lines


def test_a_smooth_pair_has_no_short_waves() -> None:
    smooth = {"surface.driving.roughness": 0.0, "surface.driven.roughness": 0.0}
    assert step_check.waves_per_turn(Parameters.from_flat(smooth)) == 0.0
    assert step_check.harmonics_per_turn(Parameters.from_flat(smooth)) == 40.0
    assert step_check.waves_per_turn(Parameters.from_flat({})) == pytest.approx(40.0 * 1.5**7)
    assert parameter_warnings(Parameters.from_flat({**smooth, "operation.speed": 3000.0})) == []


def test_a_speed_in_force_replaces_the_one_of_the_start() -> None:
    p = Parameters.from_flat({})
    assert not all(check.holds for check in step_check.checks(p, -3000.0))
    assert all(check.holds for check in step_check.checks(p, 0.0))


def test_simulate_warns_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--params-file", str(CONFIG / "gearbox.yaml"), "--duration", "0.001"]
    assert (
        simulate_main([*command, "--output", str(tmp_path / "bag"), "--set", "operation.speed=3000.0"]) == 0
    )
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert line.startswith("simulate: warning: solver.step times the frequency of the shortest wave")
