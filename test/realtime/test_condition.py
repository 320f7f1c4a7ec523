"""Condition of the machine, against whole arrays of the same run."""

from __future__ import annotations

import numpy as np
import pytest

from gear_dynamics_ros.channels import ENERGIES
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime.condition import ConditionSink
from gear_dynamics_ros.simulation.engine import Engine

SAMPLES = 110_000
MESH_LOSS = [energy.name for energy in ENERGIES].index("mesh_loss")


@pytest.mark.parametrize("chunk", [70, 200, 3000, 25_000])
def test_figures_are_those_of_the_last_second(chunk):
    engine = Engine(Parameters())
    sink = ConditionSink()
    chunks = []
    while engine.sample < SAMPLES:
        chunks.append(engine.advance(chunk))
        sink.write(chunks[-1], [])
    found = sink.report()
    # A stretch ends with the first chunk that fills a fiftieth of a second; fifty are looked at.
    stretch = -(-2_000 // chunk) * chunk
    looked_at = 50 * stretch
    end = engine.sample // stretch * stretch
    rows = np.concatenate([part.samples for part in chunks])[max(0, end - looked_at) : end]
    names = dict(zip(("dte", "state"), (rows[:, 1], rows[:, 7]), strict=True))
    assert found.span == pytest.approx(len(rows) * 1e-5)
    assert found.dte_mean == pytest.approx(names["dte"].mean())
    assert found.dte_rms == pytest.approx(np.sqrt(np.mean(names["dte"] ** 2)))
    shares = [np.mean(names["state"] == state) for state in (1.0, 0.0, -1.0)]
    assert (found.drive_share, found.apart_share, found.back_share) == pytest.approx(shares)
    peak = np.hypot(rows[:, 12] + rows[:, 16], rows[:, 13] + rows[:, 17]).max()
    assert found.driving_peak_force == pytest.approx(peak)
    assert found.drive_power == pytest.approx(np.mean(rows[:, 24] * rows[:, 22]))
    losses = {part.first_sample + len(part): part.energies[MESH_LOSS] for part in chunks} | {0: 0.0}
    lost = losses[end] - losses[max(0, end - looked_at)]
    assert found.mesh_loss * found.span == pytest.approx(lost)


def test_nothing_is_known_before_the_first_stretch_nor_after_a_reset():
    engine = Engine(Parameters())
    sink = ConditionSink()
    sink.write(engine.advance(1_999), [])
    assert sink.report() is None
    sink.write(engine.advance(1), [])
    assert sink.report().span == pytest.approx(0.02)
    engine.advance(8_000)
    # A ledger that does not begin at 0, as after a restore, is no loss of this stretch.
    sink.clear(engine.mesh_loss)
    before = engine.mesh_loss
    assert sink.report() is None
    sink.write(engine.advance(200), [])
    sink.write(engine.advance(1_800), [])
    found = sink.report()
    assert found.mesh_loss * found.span == pytest.approx(engine.mesh_loss - before)
