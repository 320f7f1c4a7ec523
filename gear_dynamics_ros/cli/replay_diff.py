"""``replay diff A B``: how far two recordings are apart, where they part, and what was done otherwise."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis.comparison import ANGLES
from gear_dynamics_ros.cli.common import FAILURE, Progress
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.replay.pairing import BY_START, BY_TIME, pair


def add_diff(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser(
        "diff",
        help="compare two recordings channel by channel",
        description="Compare the samples that two recordings both have, channel by channel. Exit code 0: the "
        "same samples and channels, the same to the bit; 1: they differ, or one has more; 2: they can't be "
        "compared. One NaN is like another; 0.0 and -0.0 differ in their bits but not in value; the "
        f"difference of {' and '.join(ANGLES)} is the shorter way around.",
    )
    for name in "AB":
        parser.add_argument(name.lower(), metavar=name, help="recording: a folder or a single .mcap file")
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for diff.png and diff.json",
    )
    parser.add_argument(
        "--align",
        choices=(BY_TIME, BY_START),
        default=BY_TIME,
        help="compare at the same simulated time (default), or from the first sample of each on",
    )
    parser.add_argument("--from", dest="start", type=float, metavar="S", help="from this time of A on, s")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="to before this time of A, s")
    parser.set_defaults(command=diff)


def diff(arguments: argparse.Namespace) -> int:
    """Compare, print, draw; exit code 1 on a difference."""
    from gear_dynamics_ros.replay import diff  # loads the model, which other verbs need not wait for

    output = arguments.output
    if output is not None and output.exists() and not output.is_dir():
        raise UsageError(f"--output {output} is a file: name a folder")
    both = recording.open(arguments.a), recording.open(arguments.b)
    chosen = pair(*both, arguments.align, arguments.start, arguments.end)
    with Progress("compared", chosen.beyond - chosen.first) as progress:
        compared = diff.compare(chosen, progress)
    for name, bag in zip("AB", both, strict=True):
        if not bag.complete:
            print(f"replay: warning: {name} is broken off: {bag.path}", file=sys.stderr)
    for line in diff.report(compared):
        print(line)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        for path in diff.write(compared, output, arguments.align):
            print(path)
    return 0 if compared.same else FAILURE
