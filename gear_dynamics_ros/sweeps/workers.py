"""Computes all branches of a plan: on the threads of this process, or on a Dask cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.sweeps.branch import PointOutcome, compute_branch
from gear_dynamics_ros.sweeps.plan import Index, SweepPlan

Keep = Callable[[PointOutcome], None]
CONNECT_TIMEOUT: Final = 10.0  # s


class Work(NamedTuple):
    """What is left of one branch."""

    points: tuple[Index, ...]
    carried: tuple[Index, bytes] | None  # see ``compute_branch``


def compute_on_threads(plan: SweepPlan, works: Sequence[Work], keep: Keep, workers: int) -> None:
    """Compute ``works`` on ``workers`` threads; ``keep`` gets each outcome, on any of them.

    The first error, or an interruption, ends it when the points under way are done and kept.
    """
    stopping = threading.Event()

    def compute(work: Work) -> None:
        for outcome in _until(stopping, compute_branch(plan, work.points, work.carried)):
            keep(outcome)

    queue = iter(works)
    with ThreadPoolExecutor(workers, thread_name_prefix="sweep") as pool:
        running: set[Future[None]] = set()
        try:
            while True:
                while len(running) < 2 * workers and (work := next(queue, None)) is not None:
                    running.add(pool.submit(compute, work))
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
        finally:
            stopping.set()


def _until(stopping: threading.Event, outcomes: Iterator[PointOutcome]) -> Iterator[PointOutcome]:
    while not stopping.is_set():
        outcome = next(outcomes, None)
        if outcome is None:
            return
        yield outcome


def compute_on_cluster(plan: SweepPlan, works: Sequence[Work], keep: Keep, scheduler: str) -> None:
    """Compute ``works`` on the Dask cluster at the address ``scheduler``; ``keep`` gets each outcome.

    A branch whose worker dies is computed again by another. Raises GearboxError if Dask is not installed, or
    the scheduler does not answer.
    """
    try:
        import distributed
    except ImportError:
        raise GearboxError(
            "--scheduler needs dask.distributed: pip install 'gear_dynamics_ros[cluster]'"
        ) from None
    try:
        client = distributed.Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False
        )
    except (OSError, ValueError, TimeoutError) as error:
        raise GearboxError(f"the Dask scheduler {scheduler} does not answer: {error}") from error
    with client, client.as_current():
        shared = client.scatter(plan, broadcast=True)  # type: ignore[no-untyped-call]
        futures = [client.submit(_compute_all, shared, work, pure=False, retries=3) for work in works]
        for _, outcomes in _finished(distributed, futures):
            for outcome in outcomes:
                keep(outcome)


def _finished(distributed: Any, futures: Sequence[Any]) -> Iterator[tuple[Any, list[PointOutcome]]]:
    yield from distributed.as_completed(futures, with_results=True)


def _compute_all(plan: SweepPlan, work: Work) -> list[PointOutcome]:
    return list(compute_branch(plan, work.points, work.carried))
