"""Options that several commands have."""

from __future__ import annotations

import argparse
from typing import Final

from gear_dynamics_ros.errors import UsageError

MOST_WORKERS: Final = 1024


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--set``, which overrides parameters."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="override a parameter; may be repeated",
    )


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--from`` and ``--to``, as ``start`` and ``end`` in s of simulated time."""
    parser.add_argument(
        "--from", dest="start", type=float, metavar="S", help="start at this simulated time, s"
    )
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="end before this simulated time, s")


def require_workers(count: int | None) -> None:
    """Raise UsageError if ``count`` of ``--workers`` is out of bounds; None: not given."""
    if count is not None and not 1 <= count <= MOST_WORKERS:
        raise UsageError(f"--workers = {count}: must be 1 to {MOST_WORKERS}")
