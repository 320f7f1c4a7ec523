"""Settings of threads in the operating system: names, precision of timed waits, priority, processors."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Final

LOCK_INTERVAL: Final = 0.5e-3  # s


class Doorbell:
    """Wakes one waiting thread. A ring while nobody waits ends the next wait at once; more rings add nothing.

    A timed wait of a Condition takes several times as long to return.
    """

    def __init__(self) -> None:
        self._silent = threading.Lock()
        self._silent.acquire()

    def ring(self) -> None:
        """Wake the waiting thread; for any thread."""
        with contextlib.suppress(RuntimeError):  # it rings already
            self._silent.release()

    def wait(self, timeout: float | None) -> bool:
        """Whether it rang within ``timeout`` s; None waits without end."""
        return self._silent.acquire(timeout=-1.0 if timeout is None else timeout)


def processor_count() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def begin_thread() -> None:
    """Set what this thread otherwise inherits from the one that started it, on Linux.

    That is its name in top, perf and /proc, from the first 15 characters of its name in Python, and the
    processors that it may run on, those of the main thread.
    """
    thread = threading.current_thread()
    with contextlib.suppress(OSError):
        Path(f"/proc/self/task/{thread.native_id}/comm").write_text(thread.name[:15], encoding="utf-8")
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setaffinity(0, os.sched_getaffinity(os.getpid()))


def wake_punctually() -> None:
    """Make timed waits of this thread, and of those it starts later, end on time, on Linux.

    By default the system adds up to 50 us to each, to wake the processor less often.
    """
    with contextlib.suppress(OSError):
        Path(f"/proc/{threading.get_native_id()}/timerslack_ns").write_text("1", encoding="utf-8")


def share_lock_promptly() -> None:
    """Let a thread that is busy in Python give way after 0.5 ms, not 5 ms, to one that waits for it."""
    sys.setswitchinterval(LOCK_INTERVAL)


def schedule_fifo(priority: int) -> None:
    """Run this thread, but none that it starts, before all of lower priority, on Linux. Raises OSError."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def run_on(processors: Iterable[int]) -> None:
    """Keep this thread on these processors, on Linux. Raises OSError."""
    os.sched_setaffinity(0, processors)
