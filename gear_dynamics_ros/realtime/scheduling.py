"""Priority, processors and memory of the thread that computes, as the parameters ask for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import PacingParameters
from gear_dynamics_ros.system.memory import lock_memory
from gear_dynamics_ros.system.threads import run_on, schedule_fifo


def schedule(pacing: PacingParameters) -> None:
    """Schedule this thread as ``pacing`` says. Raises GearboxError where the system refuses."""
    if pacing.processors:
        _apply(
            lambda: run_on(pacing.processor_numbers),
            f"pacing.processors = {pacing.processors!r}",
            "nproc --all tells how many there are, taskset -p $$ which are allowed; '' takes all",
        )
    if pacing.lock_memory:
        _apply(
            lock_memory,
            "pacing.lock_memory = true",
            "raise the limit memlock (ulimit -l) or set it false",
        )
    if pacing.priority:
        _apply(
            lambda: schedule_fifo(pacing.priority),
            f"pacing.priority = {pacing.priority}",
            "raise the limit rtprio (ulimit -r), grant CAP_SYS_NICE, or set it to 0",
        )


def require_schedulable(pacing: PacingParameters) -> None:
    """Raise GearboxError if ``schedule`` would, on a thread of the engine's kind."""
    with ThreadPoolExecutor(max_workers=1) as probe:
        probe.submit(schedule, pacing).result()


def _apply(act: Callable[[], None], setting: str, remedy: str) -> None:
    try:
        act()
    except (OSError, AttributeError) as error:  # other systems have none of these calls
        reason = getattr(error, "strerror", None) or "only Linux has it"
        raise GearboxError(f"{setting} is refused by the system ({reason}): {remedy}") from error
