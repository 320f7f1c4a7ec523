"""``replay info BAG``: what a recording contains."""

from __future__ import annotations

import argparse
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.reporting.recording_text import recording_lines


def add_info(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser("info", help="what a recording contains")
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    parser.set_defaults(command=_info)


def _info(arguments: argparse.Namespace) -> int:
    for line in recording_lines(recording.open(arguments.bag)):
        print(line)
    return 0
