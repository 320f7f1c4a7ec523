"""How much memory this process can still get, and whether it stays resident."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

_MEMINFO = Path("/proc/meminfo")
_CONTROL_GROUP = Path("/sys/fs/cgroup")
# MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT: pages once they are used, not the gigabytes that are reserved.
_LOCK_WHAT_IS_USED = 1 | 2 | 4


def lock_memory() -> None:
    """Keep all memory that this process uses, now and later, from being swapped out, on Linux.

    Raises OSError.
    """
    if ctypes.CDLL(None, use_errno=True).mlockall(_LOCK_WHAT_IS_USED):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def available_memory() -> int:
    """Bytes of memory that the system and the control group (a container) have left, on Linux.

    Where neither says how much, a number that is never reached.
    """
    return min(_of_the_system(), _of_the_group())


def _of_the_system() -> int:
    for line in _lines(_MEMINFO):
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return int(value.split()[0]) * 1024
    return sys.maxsize


def _of_the_group() -> int:
    limit, used = (_lines(_CONTROL_GROUP / f"memory.{name}") for name in ("max", "current"))
    if limit and used and limit[0].isdecimal():
        return max(int(limit[0]) - int(used[0]), 0)
    return sys.maxsize


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
