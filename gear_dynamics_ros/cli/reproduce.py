"""``reproduce --output DIR``: the results of the source paper, each beside ours."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.cli.options import require_workers
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.system.command import run_command
from gear_dynamics_ros.system.share import share_file


def reproduce_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``reproduce``; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="reproduce",
        description="Numbers and claims of the source paper's section 3 beside ours, and its figures 2 and 5 "
        "to 9: paper.md, paper.json and PNG files.",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--quick", action="store_true", help="a coarse grid of speeds and short runs")
    parser.add_argument("--workers", type=int, metavar="N", help="threads (default: one a processor)")
    return run_command(_reproduce, parser, argv)


def _reproduce(arguments: argparse.Namespace) -> int:
    output = arguments.output
    require_workers(arguments.workers)
    if output.exists() and not output.is_dir():
        raise UsageError(f"--output {output} is a file: name a folder")
    # Imported here: loading the kernel takes time, which help and refused options need not wait for.
    from gear_dynamics_ros.paper.cases import FULL, QUICK
    from gear_dynamics_ros.paper.parameter_sets import PARAMETER_FILE
    from gear_dynamics_ros.paper.reproduction import Reproduction, write_report
    from gear_dynamics_ros.system.threads import processor_count

    parameters = load_parameters(share_file(PARAMETER_FILE))
    effort = QUICK if arguments.quick else FULL
    work = Reproduction(parameters, effort, arguments.workers or processor_count())
    count = itertools.count(1)
    with Progress("running", work.runs) as progress:
        report = work.report(lambda: progress(next(count)))
    with Progress("drawing", 100) as progress:
        written = write_report(report, output, lambda done, total: progress(100 * done // total))
    for path in written:
        print(path)
    totals = report.one_set.totals
    print(
        f"{totals.agreeing} of {totals.comparable} comparable numbers within 10 %, "
        f"{totals.true} of {totals.claims} claims hold"
    )
    return 0


if __name__ == "__main__":
    sys.exit(reproduce_main())
