"""``replay recover BAG``: make a whole recording of a damaged one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.recording.recover import default_target, recover
from gear_dynamics_ros.reporting.recovery_text import recovery_lines


def add_recover(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser("recover", help="make a whole recording of what is readable in a damaged one")
    parser.add_argument("bag", metavar="BAG", help="damaged recording, only read: a folder or an .mcap file")
    parser.add_argument("--output", metavar="DIR", help="new folder (default: BAG with _recovered)")
    parser.set_defaults(command=_recover)


def _recover(arguments: argparse.Namespace) -> int:
    source = Path(arguments.bag)
    target = default_target(source) if arguments.output is None else Path(arguments.output)
    with Progress("recovered", 100) as progress:
        report = recover(source, target, lambda share: progress(int(100 * share)))
    print("\n".join(recovery_lines(report)))
    return 0
