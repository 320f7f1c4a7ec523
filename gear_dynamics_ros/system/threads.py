"""Settings of threads in the operating system: names, and precision of timed waits."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path


def name_thread() -> None:
    """Show the first 15 characters of the Python name of this thread in top, perf and /proc, on Linux."""
    thread = threading.current_thread()
    with contextlib.suppress(OSError):
        Path(f"/proc/self/task/{thread.native_id}/comm").write_text(thread.name[:15], encoding="utf-8")


def wake_punctually() -> None:
    """Make timed waits of this thread, and of those it starts later, end on time, on Linux.

    By default the system adds up to 50 us to each, to wake the processor less often.
    """
    with contextlib.suppress(OSError):
        Path(f"/proc/{threading.get_native_id()}/timerslack_ns").write_text("1", encoding="utf-8")
