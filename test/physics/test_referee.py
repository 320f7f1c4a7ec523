"""The referee itself, against two recorded runs of another independent program."""

from __future__ import annotations

import numpy as np
import pytest

from support.paths import CASES
from support.referee import CHANNELS, Referee, load_case

SAMPLES = 101  # the first millisecond


@pytest.mark.parametrize("name", ["traditional_6000", "refined_9000"])
def test_agrees_with_a_recorded_run(name: str) -> None:
    recorded = np.genfromtxt(CASES / f"{name}.csv", delimiter=",", names=True)[:SAMPLES]
    samples = Referee(load_case(CASES / f"{name}.yaml")).run(SAMPLES)
    assert np.abs(samples[:, 1] - recorded["dte"]).max() < 1e-12
    for column, channel in enumerate(CHANNELS[:-1]):
        expected = recorded[channel]
        assert (
            np.abs(samples[:, column] - expected).max()
            <= 1e-7 * np.ptp(expected) + 1e-9 * np.abs(expected).max()
        )
