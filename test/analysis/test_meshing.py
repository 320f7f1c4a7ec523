"""Contact times between samples, against closed forms and against what the kernel adds up."""

from __future__ import annotations

import numpy as np
import pytest

from gear_dynamics_ros.analysis.meshing import MeshingTimeline, contact_fractions
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.simulation.engine import Engine
from support.paths import CONFIG

INTERVAL = 1e-5


def test_contact_lasts_as_long_as_a_sine_is_positive() -> None:
    """Twelve samples a period: sin(w t) - 0.5 is positive for a third of the time."""
    turns = np.arange(1203) / 12.0 + 0.013
    fractions = contact_fractions(np.sin(2.0 * np.pi * turns) - 0.5)
    assert len(fractions) == 1200
    assert ((fractions >= 0.0) & (fractions <= 1.0)).all()
    assert fractions.mean() == pytest.approx(1.0 / 3.0, abs=1e-3)


@pytest.mark.parametrize("speed", [600.0, 1623.156])
def test_shares_are_those_that_the_kernel_adds_up(speed: float) -> None:
    engine = Engine(load_parameters(CONFIG / "gearbox.yaml", [f"operation.speed={speed}"]))
    engine.advance(5000)
    before = engine.checkpoint().state
    timeline = MeshingTimeline(capacity=64)
    for _ in range(10):
        chunk = engine.advance(1500)
        timeline.add(Samples(chunk.first_sample, INTERVAL, CHANNEL_NAMES, chunk.samples))
    after = engine.checkpoint().state
    drive, back = ((after[name] - before[name]) / 0.15 for name in ("drive_time", "back_time"))
    shares = timeline.shares()
    assert shares is not None and timeline.from_events
    assert tuple(shares) == pytest.approx((drive, 1.0 - drive - back, back), abs=5e-4)
    course, edges = timeline.course(20), timeline.edges(20)
    assert len(course) <= 20 and len(edges) == len(course) + 1
    np.testing.assert_allclose(course.sum(axis=1), 1.0)
    np.testing.assert_allclose(np.diff(edges) @ course / 0.15, tuple(shares), atol=5e-4)
    assert (edges[0], edges[-1]) == pytest.approx((0.05, 0.2), abs=3.0 * INTERVAL)


def test_without_the_motion_samples_are_counted() -> None:
    states = np.array([1.0, 1.0, 0.0, -1.0, 0.0])
    timeline = MeshingTimeline()
    assert timeline.shares() is None and len(timeline.course(10)) == 0
    timeline.add(Samples(7, INTERVAL, ("meshing_state",), states[:, None]))
    assert timeline.shares() == pytest.approx((0.4, 0.4, 0.2)) and not timeline.from_events
