"""Computes the points of one branch; what a worker does, in this process or in another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.orbit import Orbit
from gear_dynamics_ros.sweeps.plan import Index, SweepPlan
from gear_dynamics_ros.sweeps.point import PointResult, ended, measure_orbit


class PointOutcome(NamedTuple):
    """One point and what it gave; ``state`` is the kernel's, as bytes, from which the next point goes on."""

    point: Index
    result: PointResult
    state: bytes  # empty if the run ended, or nothing goes on from it


def compute_branch(
    plan: SweepPlan, points: Sequence[Index], carried: tuple[Index, bytes] | None = None
) -> Iterator[PointOutcome]:
    """Compute ``points``, consecutive ones of a branch of ``plan``, one after the other.

    ``carried`` are the point before the first and the state after it, None at the start of a branch or after
    a run that ended. A point whose parameters don't fit together or whose run ends gives NaN and the reason.
    """
    orbit = None if carried is None else _restored(plan, *carried)
    for point in points:
        try:
            parameters = plan.parameters_at(point)
            if orbit is None:
                orbit = _started(plan, point, parameters)
            else:
                orbit.retarget(parameters)
        except UsageError as error:
            orbit = None
            yield PointOutcome(point, ended(plan.measurement, str(error)), b"")
            continue
        result = measure_orbit(orbit, plan.measurement)
        if orbit.status is not Status.RUNNING or plan.direction == "independent":
            orbit = None
        yield PointOutcome(point, result, b"" if orbit is None else orbit.state.tobytes())


def _started(plan: SweepPlan, point: Index, parameters: Parameters) -> Orbit:
    orbit = Orbit(parameters, plan.measurement.steps_per_period)
    settings = plan.settings(point)
    dte, rate = settings.get("start.dte"), settings.get("start.dte_rate")
    if dte is not None or rate is not None:
        orbit.displace(*(None if value is None else float(value) for value in (dte, rate)))
    return orbit


def _restored(plan: SweepPlan, point: Index, state: bytes) -> Orbit:
    orbit = Orbit(plan.parameters_at(point), plan.measurement.steps_per_period)
    orbit.state[:] = np.frombuffer(state, orbit.state.dtype)
    return orbit
