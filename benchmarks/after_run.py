"""Time and memory of what is done with a recording after the run: python benchmarks/after_run.py."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).resolve().parent.parent
PARAMETERS = SOURCE / "config" / "gearbox.yaml"
DURATIONS = (10.0, 60.0)  # s of simulated time
MEBIBYTE = 2**20

Lines = list[str]


class Cost(NamedTuple):
    """What one command took."""

    wall: float  # s
    processor: float  # s
    memory: int  # most that was resident, bytes


def tables() -> Lines:
    """Each tool on a recording of each duration."""
    lines = [
        "| recording | on disk, MB | command | time, s | processor time, s | most memory, MiB | result, MB |",
        "|---" * 7 + "|",
    ]
    for duration in DURATIONS:
        with tempfile.TemporaryDirectory() as folder:
            lines += _rows(duration, Path(folder))
    return lines


def _rows(duration: float, place: Path) -> Lines:
    bag, figures, stream = place / "bag", place / "figures", place / "bag.rrd"
    settings = ("--params-file", str(PARAMETERS), "--duration", f"{duration:g}")
    measured("simulate", *settings, "--output", str(bag))
    rows = []
    for words, made in (
        (("analyze", str(bag), "--output", str(figures)), figures),
        (("replay", "view", str(bag), "--output", str(stream)), stream),
    ):
        cost = measured(*words)
        name = " ".join(word for word in words[:2] if not word.startswith("/"))
        rows.append(
            f"| {duration:g} s | {size(bag) / 1e6:.0f} | `{name}` | {cost.wall:.1f} | {cost.processor:.1f} "
            f"| {cost.memory / MEBIBYTE:.0f} | {size(made) / 1e6:.1f} |"
        )
    return rows


def measured(name: str, *words: str) -> Cost:
    """Run one of the package's commands, which must succeed."""
    began = time.perf_counter()
    process = subprocess.Popen(
        [Path(sysconfig.get_path("scripts")) / name, *words], stdout=subprocess.DEVNULL, stderr=sys.stderr
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{name} {' '.join(words)} exited with {process.returncode}")
    return Cost(time.perf_counter() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def size(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


if __name__ == "__main__":
    print("\n".join(tables()))
