"""Runs a sweep, whole or what is left of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import xarray as xr

from gear_dynamics_ros.sweeps.branch import PointOutcome
from gear_dynamics_ros.sweeps.plan import Branch, SweepPlan
from gear_dynamics_ros.sweeps.store import SweepFolder, make_dataset
from gear_dynamics_ros.sweeps.workers import (
    Keep,
    Work,
    compute_on_cluster,
    compute_on_threads,
)
from gear_dynamics_ros.system.threads import processor_count


def run(plan: SweepPlan, workers: int | None = None, scheduler: str | None = None) -> xr.Dataset:
    """The dataset of ``plan``, see ``make_dataset``, computed on ``workers`` threads or a Dask cluster.

    ``workers`` are as many as there are processors if not given; ``scheduler`` is the address of a Dask
    scheduler. The numbers depend on neither. Raises GearboxError if the scheduler does not answer.
    """
    outcomes: list[PointOutcome] = []
    works = [Work(branch.points, None) for branch in plan.branches()]
    compute(plan, works, outcomes.append, workers, scheduler)
    return make_dataset(plan, outcomes)


def run_in_folder(
    folder: SweepFolder,
    progress: Callable[[int], None],
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Compute what is not done in ``folder``; ``progress`` gets the number of points done, on any thread.

    What was computed stays when it is interrupted. Raises GearboxError if a point can't be kept, a file of an
    earlier one is damaged, or the scheduler does not answer.
    """
    plan = folder.plan
    works = [work for branch in plan.branches() if (work := what_is_left(folder, branch)).points]
    done = plan.size - sum(len(work.points) for work in works)
    progress(done)
    counter = itertools.count(done + 1)

    def keep(outcome: PointOutcome) -> None:
        folder.put(outcome)
        progress(next(counter))

    compute(plan, works, keep, workers, scheduler)


def compute(
    plan: SweepPlan, works: list[Work], keep: Keep, workers: int | None, scheduler: str | None
) -> None:
    """Compute ``works`` where ``run`` says; ``keep`` gets each outcome."""
    if scheduler is not None:
        compute_on_cluster(plan, works, keep, scheduler)
    else:
        compute_on_threads(plan, works, keep, workers or processor_count())


def what_is_left(folder: SweepFolder, branch: Branch) -> Work:
    """The points of ``branch`` that are not done in ``folder``, and the state that they go on from."""
    missing = next((i for i, point in enumerate(branch.points) if not folder.has(point)), len(branch.points))
    carried: tuple[tuple[int, ...], bytes] | None = None
    if 0 < missing < len(branch.points):
        before = folder.get(branch.points[missing - 1])
        carried = (before.point, before.state) if before.state else None
    return Work(branch.points[missing:], carried)
