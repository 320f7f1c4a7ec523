"""``replay diff A B``: compare two recordings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis.comparison import ANGLES
from gear_dynamics_ros.cli.faults import warn_of_faults
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.replay.pairing import BY_START, BY_TIME, pair
from gear_dynamics_ros.system.command import FAILURE


def add_diff(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser(
        "diff",
        help="compare two recordings channel by channel",
        description="Compare the samples that two recordings have in common, channel by channel. Exit code "
        "0: they have the same samples and channels with the same bits; 1: they differ, or one has more; 2: "
        "they can't be compared. All NaN count as equal; 0.0 and -0.0 differ in their bits but not in value; "
        f"the difference of {' and '.join(ANGLES)} is the shorter way around.",
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
        help="compare samples of the same simulated time (default), or of the same distance from the start",
    )
    parser.add_argument("--from", dest="start", type=float, metavar="S", help="start at this time of A, s")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="end before this time of A, s")
    parser.set_defaults(command=_diff)


def _diff(arguments: argparse.Namespace) -> int:
    from gear_dynamics_ros.replay.diff import compare_recordings
    from gear_dynamics_ros.replay.diff_files import write_difference
    from gear_dynamics_ros.replay.diff_text import difference_lines

    output = arguments.output
    if output is not None and output.exists() and not output.is_dir():
        raise UsageError(f"--output {output} is a file: name a folder")
    both = recording.open(arguments.a), recording.open(arguments.b)
    common = pair(*both, arguments.align, arguments.start, arguments.end)
    with Progress("compared", common.end - common.first) as progress:
        difference = compare_recordings(common, progress)
    for bag in both:
        warn_of_faults("replay", bag)
    for line in difference_lines(difference):
        print(line)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        for path in write_difference(difference, output, arguments.align):
            print(path)
    return 0 if difference.same() else FAILURE
