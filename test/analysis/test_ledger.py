"""The energy ledger and the list of impacts: they agree with each other and with the waveform."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.analysis import ledger
from gear_dynamics_ros.channels import (
    CHANNEL_NAMES,
    COLUMN,
    ENERGIES,
    IMPACTS,
)
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine

MODELS = ("traditional", "compared", "improved")
DURATION = 5e-3  # s
SMOOTH = {"surface.driving.roughness": 0.0, "surface.driven.roughness": 0.0}
IMPACT = {entry.name: column for column, entry in enumerate(IMPACTS)}


def run(**changed: Any) -> Chunk:
    """5 ms of the gearbox at 15500 rpm, with the energies."""
    parameters = Parameters.from_flat({"waveform_channels": tuple(COLUMN), **changed})
    return Engine(parameters).advance(round(DURATION / parameters.solver.sample_interval) + 1)


def energies(chunk: Chunk) -> NDArray[np.float64]:
    return chunk.samples[:, len(CHANNEL_NAMES) :]


def unexplained(chunk: Chunk) -> float:
    """Greatest residual of the balance over the energy that works and losses moved."""
    rows = energies(chunk)
    moved = np.abs(np.diff(rows[:, : -len(ledger.STORED)], axis=0)).sum()
    return float(np.abs((rows - rows[0]) @ ledger.RESIDUAL_SIGNS).max() / moved)


@pytest.mark.parametrize("surface", [{}, SMOOTH], ids=["rough", "smooth"])
@pytest.mark.parametrize("model", MODELS)
def test_the_ledger_closes(model: str, surface: dict[str, float]) -> None:
    chunk = run(model=model, **surface)
    assert len(chunk) == 501
    assert unexplained(chunk) < (1e-6 if surface else 1e-5)
    for step, tolerance in ((1e-6, 1e-6), (1.25e-7, 1e-8)):
        assert unexplained(run(model=model, **surface, **{"solver.step": step})) < tolerance


def test_the_published_geometry_does_work_from_no_source() -> None:
    published = run(mesh_geometry="published")
    finer = run(mesh_geometry="published", **{"solver.step": 1.25e-7})
    assert unexplained(published) > 1e-4
    assert unexplained(finer) == pytest.approx(unexplained(published), rel=0.1)


def test_asking_for_energies_changes_no_other_channel() -> None:
    plain = Engine(Parameters()).advance(501)
    assert energies(run()).shape == (501, len(ENERGIES))
    assert run().samples[:, : len(CHANNEL_NAMES)].tobytes() == plain.samples.tobytes()
    assert run().energies.tobytes() == plain.energies.tobytes()


def test_losses_only_grow() -> None:
    losses = energies(run())[:, [ledger.ENERGY_NAMES.index(name) for name in ledger.LOSSES]]
    assert (np.diff(losses, axis=0) >= -1e-12 * losses.max()).all()


@pytest.mark.parametrize("model", MODELS)
def test_impacts_are_what_the_waveform_shows(model: str) -> None:
    engine = Engine(Parameters.from_flat({"model": model}))
    chunks = [engine.advance() for _ in range(25)]
    rows = np.concatenate([chunk.impacts for chunk in chunks])
    samples = np.concatenate([chunk.samples for chunk in chunks])
    time = samples[:, COLUMN["time"]]
    seen = 0
    for number, gear in enumerate(("driving", "driven")):
        penetration = samples[:, COLUMN[f"{gear}_penetration"]]
        force = np.hypot(*(samples[:, COLUMN[f"{gear}_contact_force_{axis}"]] for axis in "xy"))
        mine = rows[rows[:, IMPACT["bearing"]] == number]
        assert len(mine) >= 1
        for before, after in pairwise(mine):
            assert before[IMPACT["end"]] <= after[IMPACT["begin"]]
        for begin, end, _, _, rebound, peak in mine:
            inside = (time > begin) & (time < end)
            seen += np.count_nonzero(inside)
            assert (penetration[inside] > 0.0).all()
            assert force[inside].max(initial=0.0) <= peak * (1.0 + 1e-15)  # hypot rounds otherwise
            assert rebound >= 0.0
    assert seen > 10


# What analyze makes of them


def test_a_reset_begins_the_ledger_anew() -> None:
    parameters = Parameters.from_flat({"solver.step": 1e-6})
    engine = Engine(parameters)
    found = ledger.EnergyLedger([engine.parameters.solver.samples_per_chunk * 5])
    expected = np.zeros(len(ENERGIES))
    for stretch in range(2):
        chunks = [engine.advance() for _ in range(5)]
        for chunk in chunks:
            found.add(chunk.first_sample + len(chunk), chunk.energies)
        expected += chunks[-1].energies - chunks[0].energies
        if stretch == 0:
            engine.reset()
    block = found.to_json(1e-5, parameters)
    assert block is not None
    assert [block[name] for name in ledger.ENERGY_NAMES] == pytest.approx(list(expected), rel=1e-9)
    assert (block["from"], block["to"]) == (pytest.approx(0.002), pytest.approx(0.02))
    assert abs(block["residual"]) < 1e-6 * block["exchanged"]


def test_totals_of_impacts() -> None:
    rows = np.array(
        [
            [0.0, 1e-4, 0.0, 0.1, 0.02, 900.0],
            [1.0, 1.1, 1.0, 5e-4, 4e-4, 3.0],
            [2.0, 2.1, 0.0, 0.3, 0.12, 700.0],
            [3.0, 3.1, 0.0, 0.0, 0.1, 1.0],
        ]
    )
    totals = ledger.ImpactTotals(minimum_speed=1e-3)
    totals.add(rows[:1])
    totals.add(rows[1:])
    block = totals.to_json()
    assert block["driving"] == {
        "count": 3,
        "mean_impact_speed": pytest.approx(0.4 / 3),
        "max_impact_speed": 0.3,
        "mean_restitution": pytest.approx(0.3),
        "max_peak_force": 900.0,
    }
    assert (block["driven"]["count"], block["driven"]["mean_restitution"]) == (1, None)
    assert ledger.csv_lines(rows)[1] == "1.0,1.1,driven,0.0005,0.0004,0.8,3.0\n"
    assert ledger.csv_lines(rows)[3] == "3.0,3.1,driving,0.0,0.1,nan,1.0\n"
