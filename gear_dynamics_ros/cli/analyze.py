"""``analyze BAG --output DIR``: figures and numbers of a recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis.summary import WINDOW_LENGTH
from gear_dynamics_ros.cli.faults import warn_of_faults
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.reporting.analysis_report import analyze_recording, left_out, write_analysis
from gear_dynamics_ros.reporting.windows import MOST_WINDOWS
from gear_dynamics_ros.system.command import run_command


def analyze_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``analyze``; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="analyze",
        description="A report (HTML, one file), its figures (PNG and SVG), a summary (JSON) and the bearing "
        "impacts (CSV) of a recording. Some figures show the whole run, the others a window: by default one "
        f"of {WINDOW_LENGTH:g} s for each set of commands that stayed in force, at most {MOST_WINDOWS}.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder or .mcap file")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument(
        "--from", dest="start", type=float, metavar="S", help="start of the window, simulated time in s"
    )
    parser.add_argument(
        "--to", dest="end", type=float, metavar="S", help="end of the window (excluded), simulated time in s"
    )
    return run_command(_analyze, parser, argv)


def _analyze(arguments: argparse.Namespace) -> int:
    output = arguments.output
    if output.exists() and not output.is_dir():
        raise UsageError(f"--output {output} is a file: name a folder")
    bag = recording.open(arguments.bag)
    warn_of_faults("analyze", bag)
    with Progress("reading", bag.end_sample - bag.first_sample) as progress:
        analysis = analyze_recording(bag, arguments.start, arguments.end, progress)
    with Progress("drawing", 100) as progress:
        written = write_analysis(analysis, output, lambda drawn, total: progress(100 * drawn // total))
    for path in written:
        print(path)
    for name, reason in left_out(analysis).items():
        print(f"analyze: no {name}: {reason}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(analyze_main())
