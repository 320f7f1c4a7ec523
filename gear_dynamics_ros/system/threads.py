"""What the system knows of threads: their names, and how punctually it wakes them."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path


def name_thread() -> None:
    """Show this thread under its Python name in top, perf and /proc: its first 15 characters, on Linux."""
    thread = threading.current_thread()
    with contextlib.suppress(OSError):
        Path(f"/proc/self/task/{thread.native_id}/comm").write_text(thread.name[:15], encoding="utf-8")


def wake_punctually() -> None:
    """Let timed waits of this thread, and of those it starts from now on, end when they should, on Linux.

    The system otherwise adds up to 50 us to each, to wake the processor less often.
    """
    with contextlib.suppress(OSError):
        Path(f"/proc/{threading.get_native_id()}/timerslack_ns").write_text("1", encoding="utf-8")
