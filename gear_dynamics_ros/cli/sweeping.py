"""``sweep``: many runs over ranges of parameters, into one labelled dataset with figures."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gear_dynamics_ros.cli.options import add_settings, require_workers
from gear_dynamics_ros.cli.progress import ProgressLine, stderr_lines
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.system.command import run_command
from gear_dynamics_ros.system.share import share_file

if TYPE_CHECKING:
    from gear_dynamics_ros.sweeps.store import SweepFolder

WARNED_POINTS = 5


def sweep_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``sweep``; returns the exit code.

    0 if every point was computed, those whose run ended among them; 1 if something can't be kept or the
    scheduler does not answer, 2 on bad usage, 128 + n if signal n interrupted it.
    """
    parser = argparse.ArgumentParser(
        prog="sweep",
        description="Run the gearbox over ranges of parameters and starts, and gather what each run does "
        "after its transient: Poincaré section, spectrum, meshing shares, forces, periodicity and chaos.",
        epilog="A range is NAME=START:STOP:COUNT or NAME=VALUE,VALUE,..., both ends included, with a unit "
        "behind the last number if it is not the parameter's own: rpm, deg, mm, um. NAME may hold * for "
        "several parameters, as bearings.*.restitution, or be start.dte or start.dte_rate.",
    )
    parser.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    parser.add_argument(
        "--over",
        action="append",
        required=True,
        metavar="NAME=RANGE",
        help="what to sweep; give it again for a grid",
    )
    parser.add_argument("--models", metavar="A,B,C", help="models to sweep (default: that of the parameters)")
    parser.add_argument(
        "--transient",
        type=int,
        default=3000,
        metavar="N",
        help="mesh periods to drop at each point (default: %(default)s)",
    )
    parser.add_argument(
        "--keep", type=int, default=1000, metavar="N", help="mesh periods to keep (default: %(default)s)"
    )
    parser.add_argument(
        "--steps", type=int, default=100, metavar="N", help="steps per mesh period (default: %(default)s)"
    )
    parser.add_argument(
        "--direction",
        choices=("independent", "up", "down", "both"),
        default="independent",
        help="along the first range: each point from the start state, or from the state of its neighbour "
        "(default: %(default)s)",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the results")
    parser.add_argument("--resume", action="store_true", help="finish an interrupted sweep in --output")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--workers", type=int, metavar="N", help="threads (default: one a processor)")
    place.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, as tcp://127.0.0.1:8786")
    add_settings(parser)
    return run_command(_sweep, parser, argv)


def _sweep(arguments: argparse.Namespace) -> int:
    require_workers(arguments.workers)
    parameters = load_parameters(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)
    # Imported here: loading the kernel takes time, which help and refused options need not wait for.
    from gear_dynamics_ros.simulation.warm_up import warm_up_orbit
    from gear_dynamics_ros.sweeps.axis import parse_axis
    from gear_dynamics_ros.sweeps.execution import run_in_folder
    from gear_dynamics_ros.sweeps.plan import SweepPlan
    from gear_dynamics_ros.sweeps.point import Measurement
    from gear_dynamics_ros.sweeps.store import SweepFolder

    plan = SweepPlan(
        parameters,
        tuple(map(parse_axis, arguments.over)),
        tuple(arguments.models.split(",")) if arguments.models else (parameters.model,),
        Measurement(arguments.transient, arguments.keep, arguments.steps),
        arguments.direction,
    )
    open_folder = SweepFolder.resume if arguments.resume else SweepFolder.begin
    folder = open_folder(arguments.output, plan)
    warm_up_orbit(*stderr_lines("sweep"))
    try:
        with ProgressLine() as line:
            run_in_folder(folder, _progress(line, plan.size), arguments.workers, arguments.scheduler)
    except KeyboardInterrupt:
        done = _finish(folder)
        print(
            f"sweep: '{folder.path}' holds {done} of {plan.size} points; --resume computes the others",
            file=sys.stderr,
        )
        raise
    _finish(folder)
    return 0


def _progress(line: ProgressLine, total: int) -> Callable[[int], None]:
    began, before = time.monotonic(), -1

    def show(done: int) -> None:
        nonlocal before
        if before < 0:
            before = done
        fresh = done - before
        left = (time.monotonic() - began) / fresh * (total - done) if fresh else None
        rest = "" if left is None else f", {left:.0f} s left"
        line.show(lambda: f"swept {done} of {total} points{rest}")

    return show


def _finish(folder: SweepFolder) -> int:
    """Write the dataset and the figures, tell what they hold; returns the number of points done."""
    from gear_dynamics_ros.sweeps.pictures import draw_figures
    from gear_dynamics_ros.sweeps.point import DONE
    from gear_dynamics_ros.sweeps.store import NOT_COMPUTED

    dataset = folder.dataset()
    path = folder.write_dataset(dataset)
    pictures = draw_figures(dataset, folder.path)
    states = [str(state) for state in dataset["status"].values.ravel()]
    done = len(states) - states.count(NOT_COMPUTED)
    ended = [state for state in states if state not in (DONE, NOT_COMPUTED)]
    for state in sorted(set(ended), key=ended.index)[:WARNED_POINTS]:
        print(f"sweep: warning: {ended.count(state)} of the points gave nothing: {state}", file=sys.stderr)
    print(f"{path}: {done} of {len(states)} points, {len(ended)} of which ended early")
    print(f"{len(pictures)} figures in {folder.path}")
    return done


if __name__ == "__main__":
    sys.exit(sweep_main())
