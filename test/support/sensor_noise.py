"""Recordings as a test rig would make them: with noise on some channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.offline import simulate_to_recording
from gear_dynamics_ros.simulation.engine import Engine


class NoisyEngine(Engine):
    """Adds normal noise of a standard deviation for each channel to the samples, and not to the state."""

    def __init__(self, parameters: Parameters, noise: Mapping[str, float], seed: int) -> None:
        super().__init__(parameters)
        self._noise = noise
        self._random = np.random.default_rng(seed)

    def advance(self, samples: int | None = None) -> Chunk:
        chunk = super().advance(samples)
        rows = chunk.samples.copy()
        for channel, deviation in self._noise.items():
            rows[:, COLUMN[channel]] += self._random.normal(0.0, deviation, len(rows))
        return replace(chunk, samples=rows)


def record_with_noise(
    path: Path, parameters: Parameters, noise: Mapping[str, float], duration: float, seed: int = 1
) -> Path:
    """Recording of ``duration`` s, with ``noise`` on its channels."""
    engine = NoisyEngine(parameters, noise, seed)
    simulate_to_recording(engine, path, duration, lambda samples: None, lambda: "")
    return path
