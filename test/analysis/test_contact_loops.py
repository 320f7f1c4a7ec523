"""Areas of the loops of contact force over penetration, against the energy that the kernel adds up."""

from __future__ import annotations

import numpy as np
import pytest

from gear_dynamics_ros.analysis.contact_loops import loss_per_period
from gear_dynamics_ros.analysis.sections import mesh_frequency
from gear_dynamics_ros.channels import CHANNEL_NAMES, ENERGIES, GEARS
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.simulation.engine import Engine
from support.paths import CONFIG

INTERVAL = 1e-5
COUNT = 15_000


@pytest.mark.parametrize(
    ("changes", "tolerance"),
    [(["operation.speed=1000.0"], 0.005), (["model=traditional"], 0.005), (["model=compared"], 0.08)],
    ids=["impacts", "lasting contact", "oscillation of few samples a period"],
)
def test_the_area_is_the_energy_that_the_contact_loses(changes: list[str], tolerance: float) -> None:
    engine = Engine(load_parameters(CONFIG / "gearbox.yaml", changes))
    before = engine.advance(5000)
    after = engine.advance(COUNT)
    samples = Samples(5000, INTERVAL, CHANNEL_NAMES, after.samples)
    periods = abs(mesh_frequency(samples["mesh_phase"], INTERVAL)) * COUNT * INTERVAL
    names = [energy.name for energy in ENERGIES]
    for gear in GEARS:
        column = names.index(f"{gear}_contact_loss")
        lost = (after.energies[column] - before.energies[column]) / periods
        assert loss_per_period(samples, gear) == pytest.approx(lost, rel=tolerance)


def test_no_area_without_the_mesh_phase_or_in_a_few_samples() -> None:
    names = ("driving_penetration", "driving_contact_force_x", "driving_contact_force_y")
    samples = Samples(0, INTERVAL, names, np.zeros((500, 3)))
    assert loss_per_period(samples, "driving") is None
    phase = np.linspace(0.0, 40.0, 50)[:, None] % 6.28
    few = Samples(0, INTERVAL, (*names, "mesh_phase"), np.hstack([np.zeros((50, 3)), phase]))
    assert loss_per_period(few, "driving") is None
