"""Runs the paper's cases under one set of parameters, and holds what they gave."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar

from gear_dynamics_ros.analysis.chaos import Regime
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.paper.cases import (
    NAMED_CASES,
    WAVEFORM_CASES,
    Case,
    Effort,
    ParameterSet,
    needed_cases,
    scan_cases,
)
from gear_dynamics_ros.paper.waveforms import run_waveform
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.sweeps.point import REGIMES, Measurement, PointResult

Measure = Callable[[Parameters, Measurement], PointResult]
T = TypeVar("T")
Item = TypeVar("Item")

WAVEFORM_PERIODS: Final = 480  # of the mesh, that a waveform keeps
WAVEFORM_TRANSIENT: Final = 1000  # mesh periods at most


class CaseResult(NamedTuple):
    """What one case gave."""

    case: Case
    point: PointResult

    @property
    def regime(self) -> Regime | None:
        """Kind of the motion, None if the run ended before."""
        number = self.point.scalars["regime"]
        return None if math.isnan(number) else REGIMES[int(number)]


@dataclass(frozen=True)
class PaperResults:
    """What all cases gave under one set of parameters."""

    parameter_set: ParameterSet
    effort: Effort
    cases: Mapping[Case, CaseResult]
    waveforms: Mapping[str, Samples]  # by the names of WAVEFORM_CASES, those whose run did not end before

    def at(self, name: str) -> CaseResult:
        """Result of the case ``name`` of NAMED_CASES."""
        return self.cases[NAMED_CASES[name]]

    def scan(self, name: str) -> list[CaseResult]:
        """Results of the scan ``name``, in ascending order."""
        return [self.cases[case] for case in scan_cases(name, self.effort)]

    @property
    def static_force(self) -> float:
        """T_M / r_b of the driving gear, N: the mean mesh force of every steady motion."""
        return static_force(self.parameter_set.parameters)


def static_force(parameters: Parameters) -> float:
    """T_M / r_b of the driving gear, N."""
    return parameters.operation.drive_torque / base_radii(parameters)[0]


def run_cases(
    parameter_set: ParameterSet,
    effort: Effort,
    measure: Measure,
    workers: int,
    done: Callable[[], object],
) -> PaperResults:
    """Run every case under ``parameter_set`` on ``workers`` threads; ``done`` is called after each run.

    Raises UsageError if a value of the set does not suit its parameter.
    """
    cases = needed_cases(effort)

    def one(case: Case) -> CaseResult:
        point = measure(parameter_set.of(case), effort.measurement)
        done()
        return CaseResult(case, point)

    def waveform(name: str) -> Samples | None:
        transient = min(effort.measurement.transient, WAVEFORM_TRANSIENT)
        found = run_waveform(parameter_set.of(NAMED_CASES[name]), transient, WAVEFORM_PERIODS)
        done()
        return found

    results = in_threads(one, cases, workers)
    waveforms = zip(WAVEFORM_CASES, in_threads(waveform, WAVEFORM_CASES, workers), strict=True)
    return PaperResults(
        parameter_set,
        effort,
        dict(zip(cases, results, strict=True)),
        {name: samples for name, samples in waveforms if samples is not None},
    )


def run_count(effort: Effort) -> int:
    """How many runs ``run_cases`` makes."""
    return len(needed_cases(effort)) + len(WAVEFORM_CASES)


def in_threads(act: Callable[[Item], T], items: Iterable[Item], workers: int) -> list[T]:
    """What ``act`` returns for each of ``items``, in their order; no more begin once one has raised."""
    pool = ThreadPoolExecutor(workers, thread_name_prefix="reproduce")
    try:
        return list(pool.map(act, items))
    finally:
        pool.shutdown(cancel_futures=True)
