"""Warnings of recordings that are not whole."""

from __future__ import annotations

import sys

from gear_dynamics_ros.recording import Recording
from gear_dynamics_ros.reporting.recording_text import fault_lines


def warn_of_faults(program: str, bag: Recording) -> None:
    """Print a line on stderr for everything that is missing in ``bag`` or not as the recorder left it."""
    for line in fault_lines(bag):
        print(f"{program}: warning: {bag.path}: {line}", file=sys.stderr)
