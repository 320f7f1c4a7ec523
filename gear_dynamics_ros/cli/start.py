"""The console scripts. Each imports its command only when called, so that Ctrl-C then is one line too."""

from __future__ import annotations

import signal
import sys
from importlib import import_module

from gear_dynamics_ros.system.command import SIGNALLED, open_streams


def gearbox() -> int:
    """Run ``gearbox``; returns the exit code, as all here do."""
    return _run_main("gearbox")


def drive() -> int:
    """Run ``drive``."""
    return _run_main("drive")


def simulate() -> int:
    """Run ``simulate``."""
    return _run_main("simulate")


def replay() -> int:
    """Run ``replay``."""
    return _run_main("replay")


def analyze() -> int:
    """Run ``analyze``."""
    return _run_main("analyze")


def sweep() -> int:
    """Run ``sweep``."""
    return _run_main("sweep", "sweeping")


def identify() -> int:
    """Run ``identify``."""
    return _run_main("identify")


def reproduce() -> int:
    """Run ``reproduce``."""
    return _run_main("reproduce")


def _run_main(name: str, module: str = "") -> int:
    open_streams()
    try:
        return int(getattr(import_module(f"gear_dynamics_ros.cli.{module or name}"), f"{name}_main")())
    except KeyboardInterrupt:
        print(f"{name}: interrupted by SIGINT", file=sys.stderr)
        return SIGNALLED + signal.SIGINT
