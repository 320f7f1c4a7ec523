"""Waveforms of single cases, and what only they show."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.sections import poincare_points
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Samples, Status
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.parameters.changes import updated
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.orbit import mesh_period

WAVEFORM_STEP: Final = 1e-6  # s, the sample interval too
SAMPLES_A_CALL: Final = 20_000


def run_waveform(parameters: Parameters, transient: int, periods: int) -> Samples | None:
    """Every step of ``periods`` mesh periods after ``transient`` more; None if the run ends before."""
    solver = {
        "solver.step": WAVEFORM_STEP,
        "solver.sample_interval": WAVEFORM_STEP,
        "waveform_channels": CHANNEL_NAMES,
    }
    engine = Engine(updated(parameters, solver))
    samples_per_period = mesh_period(parameters) / WAVEFORM_STEP
    skipped = math.ceil(transient * samples_per_period)
    while engine.status is Status.RUNNING and engine.sample < skipped:
        engine.advance(min(SAMPLES_A_CALL, skipped - engine.sample))
    if engine.status is not Status.RUNNING:
        return None
    chunk = engine.advance(math.ceil(periods * samples_per_period))
    if engine.status is not Status.RUNNING:
        return None
    return Samples(chunk.first_sample, WAVEFORM_STEP, CHANNEL_NAMES, chunk.samples)


def loop_area(samples: Samples, gear: str) -> float:
    """Work that the bearing contact of ``gear`` dissipates in a mesh period, J.

    It is the area of the loop of force over penetration, from the first sample to the last that has nearly
    the same penetration, and back: what else the spring holds at the end is no loss. 0 without such a sample.
    """
    penetration, force = samples[f"{gear}_penetration"], samples.contact_force(gear)
    above = penetration > penetration[0]
    crossings = np.flatnonzero(above[:-1] != above[1:])
    if not len(crossings):
        return 0.0
    closed = 1 + int(crossings[-1])
    x, y = np.append(penetration[:closed], penetration[0]), np.append(force[:closed], force[0])
    work = float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))
    return work / (mesh_periods(samples) * closed / len(samples))


def mesh_periods(samples: Samples) -> float:
    """How many mesh periods ``samples`` cover."""
    turns = np.unwrap(samples["mesh_phase"]) / (2.0 * math.pi)
    return float(abs(turns[-1] - turns[0]))


def apart_share(samples: Samples, gear: str) -> float:
    """Share of the time in which the journal of ``gear`` is apart from its sleeve."""
    return float(np.mean(samples[f"{gear}_penetration"] <= 0.0))


def lifts_per_period(samples: Samples, gear: str) -> float:
    """How often in a mesh period the journal of ``gear`` leaves its sleeve."""
    touching = samples[f"{gear}_penetration"] > 0.0
    lifts = np.count_nonzero(touching[:-1] & ~touching[1:])
    return float(lifts / mesh_periods(samples))


def section_of(samples: Samples, *channels: str) -> NDArray[np.float64]:
    """``channels`` at mesh phase 0, shape (points, channels)."""
    values = np.column_stack([samples[name] for name in channels])
    return poincare_points(samples["mesh_phase"], values)


def mean_force(samples: Samples, gear: str) -> tuple[float, float]:
    """Mean over time of the force of bearing contact and film on ``gear``, x and y, N."""
    x, y = (
        float(np.mean(samples[f"{gear}_contact_force_{axis}"] + samples[f"{gear}_film_force_{axis}"]))
        for axis in "xy"
    )
    return x, y
