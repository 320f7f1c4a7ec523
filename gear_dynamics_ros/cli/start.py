"""The console scripts: each loads its command where Ctrl-C is heeded already, for loading takes a second."""

from __future__ import annotations

import sys
from importlib import import_module

from gear_dynamics_ros.cli.common import INTERRUPTED


def gearbox() -> int:
    """Run ``gearbox``; returns the exit code, as all here do."""
    return _start("gearbox")


def drive() -> int:
    """Run ``drive``."""
    return _start("drive")


def simulate() -> int:
    """Run ``simulate``."""
    return _start("simulate")


def replay() -> int:
    """Run ``replay``."""
    return _start("replay")


def analyze() -> int:
    """Run ``analyze``."""
    return _start("analyze")


def _start(name: str) -> int:
    try:
        return int(import_module(f"gear_dynamics_ros.cli.{name}").main())
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return INTERRUPTED
