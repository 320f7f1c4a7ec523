"""One point of a sweep: an orbit whose transient is dropped, and what its kept periods give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.analysis import chaos
from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES, amplitude_spectrum
from gear_dynamics_ros.analysis.surface_scatter import hunting_periods, section_width
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.simulation.orbit import (
    EXTREMES,
    SAMPLES_PER_PERIOD,
    STEPS_PER_PERIOD,
    Orbit,
    OrbitRecord,
)
from gear_dynamics_ros.simulation.separated_pair import SEPARATION, SeparatedPair

BLOCK: Final = 200  # periods advanced at once: their samples take 0.9 MB
SPECTRUM_PERIODS: Final = 200  # periods in each of the spectra that are averaged
HIGHEST_ORDER: Final = 5.0  # of the mesh frequency
DONE: Final = "done"
REGIMES: Final[tuple[chaos.Regime, ...]] = ("periodic", "quasi-periodic", "chaotic")  # by number
# Intervals of a separated pair, of 5 mesh periods each.
SKIPPED_INTERVALS: Final = 10
EXPONENT_INTERVALS: Final = 50

# Unit of every scalar result, by name.
SCALARS: Final[Mapping[str, str]] = {
    "drive_share": "1",
    "apart_share": "1",
    "back_share": "1",
    "ldmf": "1",
    **{f"{name}_{kind}": unit for name, unit in EXTREMES.items() for kind in ("min", "max", "mean")},
    "pressure_angle_min": "rad",
    "pressure_angle_max": "rad",
    "period": "1",
    "regime": "1",
    "lyapunov": "1/s",
    "zero_one": "1",
    "section_spread": "m",
    "section_cloud": "m",
    "section_width": "m",
    "closing_error": "m",
    "section_phase_error": "rad",
    "events": "1",
    "capped": "1",
}
ARRAYS: Final[Mapping[str, str]] = {"section_dte": "m", "section_dte_rate": "m/s", "dte_spectrum": "m"}


class PointResult(NamedTuple):
    """What one point gave, SI units: NaN where its run ended before, which ``status`` tells."""

    scalars: dict[str, float]  # by the names of SCALARS
    arrays: dict[str, NDArray[np.float64]]  # by the names of ARRAYS
    status: str  # DONE, or why the run ended


class Measurement(NamedTuple):
    """How a point is measured."""

    transient: int  # periods of the mesh that are dropped
    keep: int  # periods after them
    steps_per_period: int = STEPS_PER_PERIOD
    exponent_intervals: int = EXPONENT_INTERVALS  # of a separated pair; without them, no exponent


def measure(parameters: Parameters, measurement: Measurement) -> PointResult:
    """What a gearbox that starts with ``parameters`` does after the transient."""
    return measure_orbit(Orbit(parameters, measurement.steps_per_period), measurement)


def measure_orbit(orbit: Orbit, measurement: Measurement) -> PointResult:
    """``measure``, from the present state of ``orbit`` on."""
    skip(orbit, measurement.transient)
    records = []
    for begin in range(0, measurement.keep, BLOCK):
        if orbit.status is Status.RUNNING:
            records.append(orbit.advance(min(BLOCK, measurement.keep - begin)))
    if orbit.status is not Status.RUNNING:
        return ended(measurement, orbit.reason)
    return _result(records, orbit, measurement)


def skip(orbit: Orbit, count: int) -> None:
    """Advance by ``count`` periods, or to the end of the run."""
    for begin in range(0, count, BLOCK):
        if orbit.status is Status.RUNNING:
            orbit.advance(min(BLOCK, count - begin))


def ended(measurement: Measurement, status: str) -> PointResult:
    """The result of a point that gave nothing, because of ``status``."""
    arrays = {
        "section_dte": np.full(measurement.keep, np.nan),
        "section_dte_rate": np.full(measurement.keep, np.nan),
        "dte_spectrum": np.full(len(spectrum_orders(measurement.keep)), np.nan),
    }
    return PointResult(dict.fromkeys(SCALARS, np.nan), arrays, status)


def spectrum_orders(keep: int) -> NDArray[np.float64]:
    """Orders of the mesh frequency at which the DTE spectrum of ``keep`` periods is given, shape (m,)."""
    periods = min(keep, SPECTRUM_PERIODS)
    if periods * SAMPLES_PER_PERIOD < MIN_SAMPLES:
        return np.zeros(0)
    return np.arange(int(HIGHEST_ORDER * periods) + 1) / periods


def _result(records: list[OrbitRecord], orbit: Orbit, measurement: Measurement) -> PointResult:
    parameters = orbit.parameters
    time = sum(record.time for record in records)
    drive = sum(record.drive_time for record in records) / time
    back = sum(record.back_time for record in records) / time
    section = np.concatenate([record.section for record in records])[: measurement.keep]
    alpha = np.concatenate([record.samples[:, COLUMN["pressure_angle"]] for record in records])
    extremes = _joined_extremes(records)
    static = abs(parameters.operation.load_torque) / base_radii(parameters)[1]
    scalars = {
        "drive_share": drive,
        "apart_share": max(0.0, 1.0 - drive - back),
        "back_share": back,
        "ldmf": extremes["mesh_force_max"] / static if static > 0.0 else np.nan,
        **extremes,
        "pressure_angle_min": float(alpha.min()),
        "pressure_angle_max": float(alpha.max()),
        **_motion(section, orbit, measurement.exponent_intervals),
        "section_phase_error": max(record.phase_error for record in records),
        "events": float(sum(record.counters.events for record in records)),
        "capped": float(sum(record.counters.capped for record in records)),
    }
    dte = np.concatenate([record.samples[:, COLUMN["dte"]] for record in records])
    whole = np.vstack([section, np.full((measurement.keep - len(section), 2), np.nan)])
    arrays = {
        "section_dte": whole[:, 0],
        "section_dte_rate": whole[:, 1],
        "dte_spectrum": mean_spectrum(dte, measurement.keep),
    }
    return PointResult(scalars, arrays, DONE)


def _motion(section: NDArray[np.float64], orbit: Orbit, exponent_intervals: int) -> dict[str, float]:
    """What kind of motion ``section`` (n, 2) shows; NaN what it is too short for. ``orbit`` is its end."""
    parameters = orbit.parameters
    width = section_width(parameters)
    motion = {
        "period": np.nan,
        "regime": np.nan,
        "lyapunov": np.nan,
        "zero_one": np.nan,
        "section_spread": float(np.ptp(section[:, 0])) if len(section) else np.nan,
        "section_cloud": np.nan,
        "section_width": width,
        "closing_error": np.nan,
    }
    if len(section) < chaos.MIN_VALUES:
        return motion
    found = chaos.periodicity(section, hunting_periods(parameters), width)
    teeth = (parameters.gears.driving.teeth, parameters.gears.driven.teeth)
    zero_one = chaos.zero_one_test(section[:, 0], teeth)
    exponent = _largest_exponent(orbit, exponent_intervals)
    regime = chaos.regime(found, exponent, zero_one, orbit.period)
    return motion | {
        "period": float(found.period),
        "regime": float(REGIMES.index(regime)),
        "lyapunov": exponent,
        "zero_one": zero_one,
        "section_cloud": found.cloud,
        "closing_error": found.closing_error,
    }


def _largest_exponent(orbit: Orbit, intervals: int) -> float:
    """In 1/s, from copies of ``orbit``; NaN if their run ends, or without ``intervals``."""
    if not intervals:
        return np.nan
    pair = SeparatedPair(orbit.copy())
    try:
        return chaos.largest_exponent(pair, intervals, pair.interval, SEPARATION, SKIPPED_INTERVALS)
    except GearboxError:
        return np.nan


def _joined_extremes(records: list[OrbitRecord]) -> dict[str, float]:
    joined: dict[str, float] = {}
    steps = sum(record.counters.steps for record in records)
    for name in EXTREMES:
        parts = [record.extremes[name] for record in records]
        weights = [record.counters.steps / steps for record in records]
        joined[f"{name}_min"] = min(part.minimum for part in parts)
        joined[f"{name}_max"] = max(part.maximum for part in parts)
        joined[f"{name}_mean"] = sum(w * part.mean for w, part in zip(weights, parts, strict=True))
    return joined


def mean_spectrum(dte: NDArray[np.float64], keep: int) -> NDArray[np.float64]:
    """Root mean square, over consecutive windows, of the amplitude (m) at ``spectrum_orders(keep)``.

    ``dte`` (m) has SAMPLES_PER_PERIOD samples for each of ``keep`` periods; what is left over at the end of
    the last whole window does not count.
    """
    orders = spectrum_orders(keep)
    length = min(keep, SPECTRUM_PERIODS) * SAMPLES_PER_PERIOD
    if not len(orders):
        return np.zeros(0)
    windows = dte[: len(dte) // length * length].reshape(-1, length)
    powers = [amplitude_spectrum(window, 1.0).amplitude[: len(orders)] ** 2 for window in windows]
    mean: NDArray[np.float64] = np.sqrt(np.mean(powers, axis=0))
    return mean
