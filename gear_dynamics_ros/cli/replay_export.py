"""``replay export BAG --output FILE``: a recording's tables for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.faults import warn_of_faults
from gear_dynamics_ros.cli.options import add_span
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.recording.export import tables
from gear_dynamics_ros.recording.export.formats import FORMATS
from gear_dynamics_ros.recording.export.write import export_table


def add_export(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser(
        "export",
        help="write a table of a recording as Parquet, CSV or NumPy",
        description="Write a table of a recording to a new file; every number keeps its bits. The waveform "
        "has a row for each sample: its index and simulated time, then the channels.",
    )
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="new file")
    parser.add_argument("--format", choices=tuple(FORMATS), help="default: by the suffix of FILE")
    parser.add_argument(
        "--table", choices=tables.TABLE_NAMES, default=tables.WAVEFORM, help="default: waveform"
    )
    parser.add_argument(
        "--channels", metavar="NAME,...", help="columns of the waveform beside sample and time (default: all)"
    )
    add_span(parser)
    parser.set_defaults(command=_export)


def _export(arguments: argparse.Namespace) -> int:
    bag = recording.open(arguments.bag)
    first, end_sample = bag.clip(arguments.start, arguments.end)
    channels = None if arguments.channels is None else arguments.channels.split(",")
    with Progress("exported", end_sample - first) as progress:
        written = export_table(
            bag,
            arguments.output,
            arguments.table,
            format=arguments.format,
            channels=channels,
            start=arguments.start,
            end=arguments.end,
            progress=lambda reached: progress(max(reached - first, 0)),
        )
    warn_of_faults("replay", bag)
    size = f"{written.size / 1e6:.1f} MB" if written.size >= 1e6 else f"{written.size / 1e3:.1f} kB"
    print(f"{arguments.output}: {written.rows} rows of {written.columns} columns, {size}")
    return 0
