"""Chunks that no engine made: numbers to be found again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNEL_NAMES, ENERGIES, IMPACTS
from gear_dynamics_ros.chunk import (
    Chunk,
    Commands,
    Counters,
    Status,
)
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.engine import Engine

INTERVAL_NS = 10_000
NO_COUNTERS = Counters(0, 0, 0, 0, 0)
COMMANDS = Commands(30.0, 20.0, 1000.0)
ROWS = 400
# The extremes of a double, and two NaN that are not the usual one.
ODD = np.concatenate(
    [
        [0.0, -0.0, np.inf, -np.inf, 5e-324, -1.7976931348623157e308, 0.1, 1 / 3, 1e22, np.nan],
        np.array([0x7FF8000000001234, 0xFFF8000000000001], dtype=np.uint64).view(np.float64),
    ]
)


def noise(seed: int, rows: int, columns: int = len(CHANNEL_NAMES)) -> NDArray[np.float64]:
    """Samples that can't be compressed, shape (rows, columns)."""
    return np.random.default_rng(seed).standard_normal((rows, columns))


def chunk_of(first: int, samples: NDArray[np.float64], **other: Any) -> Chunk:
    """Chunk of these samples, the first of which has the index ``first``; all else is 0 but for ``other``."""
    fields: dict[str, Any] = {
        "angles": np.zeros((len(samples), 2)),
        "energies": np.zeros(len(ENERGIES)),
        "impacts": np.zeros((0, len(IMPACTS))),
        "commands": COMMANDS,
        "counters": NO_COUNTERS,
        "status": Status.RUNNING,
        "message": "",
    }
    return Chunk(first_sample=first, interval_ns=INTERVAL_NS, samples=samples, **(fields | other))


def odd_chunk(number: int) -> Chunk:
    """Chunk of ROWS samples with ODD among them; its time is that of the samples."""
    first = number * ROWS
    samples = noise(number, ROWS)
    samples[:, 0] = (first + np.arange(ROWS)) * 1e-5
    samples[: len(ODD), 1] = ODD
    return chunk_of(first, samples, energies=np.full(len(ENERGIES), float(number)))


def record_odd(path: Path, chunks: int) -> Path:
    """Recording of odd chunks: 90 kB each."""
    recorder = Recorder(path, Engine(Parameters()).checkpoint(), 1_000_000_000)
    encoder = Encoder(Parameters(), 1_000_000_000)
    for number in range(chunks):
        recorder.write(encoder.chunk(odd_chunk(number)))
    recorder.close()
    assert recorder.error is None
    return path
