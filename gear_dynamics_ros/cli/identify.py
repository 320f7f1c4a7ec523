"""``identify``: fit parameters to target numbers or to a recording."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gear_dynamics_ros.cli.options import add_settings
from gear_dynamics_ros.cli.progress import ProgressLine, stderr_lines
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.identification.journal import FitJournal, require_unused
from gear_dynamics_ros.identification.unknowns import read_unknowns
from gear_dynamics_ros.parameters import Parameters, load_parameters, read_settings, updated
from gear_dynamics_ros.system.command import SIGNALLED, run_command
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.system.share import share_file
from gear_dynamics_ros.system.threads import processor_count

if TYPE_CHECKING:
    from gear_dynamics_ros.identification.objective import Problem
    from gear_dynamics_ros.identification.search import Standing


# What the recorded run wrote, a run with the fitted parameters must not write over.
NO_OUTPUTS: Final = {"recording.path": "", "checkpoint.path": "", "rerun.mode": "none", "rerun.path": ""}


def identify_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``identify``; returns the exit code.

    0 if the fit is complete, 1 if it failed, 2 on bad usage, 128 + n if signal n interrupted it.
    """
    parser = argparse.ArgumentParser(
        prog="identify",
        description="Fit parameters to target numbers or to a recording: fitted parameter file, standard "
        "errors, residuals, and which parameters the data can't tell apart. All values in SI units.",
    )
    parser.add_argument(
        "--params-file",
        type=Path,
        metavar="F",
        help="ROS parameter file with all that is not varied (default: the parameters of the recording, or "
        "the package's config/gearbox.yaml)",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="a parameter to fit, and its bounds; may be repeated. A * in NAME, or several names with "
        "commas, tie parameters to one value; NAME[0] is the first number of a list",
    )
    data = parser.add_mutually_exclusive_group(required=True)
    data.add_argument(
        "--targets", type=Path, metavar="TABLE", help="YAML file of quantities and their values"
    )
    data.add_argument("--recording", type=Path, metavar="BAG", help="rosbag2 folder or .mcap file")
    parser.add_argument("--channels", metavar="NAME,...", help="channels of the recording to fit")
    parser.add_argument(
        "--from", dest="start", type=float, metavar="S", help="start of the window of the recording, s"
    )
    parser.add_argument(
        "--to",
        dest="end",
        type=float,
        metavar="S",
        help="end of the window (excluded), s; default: 40 periods of the mesh after its start",
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="new folder for the results"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the interrupted fit in DIR")
    parser.add_argument(
        "--generations",
        type=_whole,
        default=60,
        metavar="N",
        help="most generations of the search within the bounds; 0: refine the start values alone "
        "(default: 60)",
    )
    parser.add_argument(
        "--population",
        type=_positive,
        default=15,
        metavar="N",
        help="trials a generation, for each parameter (default: 15)",
    )
    parser.add_argument("--seed", type=_whole, default=0, metavar="N", help="of the search (default: 0)")
    parser.add_argument("--workers", type=_positive, metavar="N", help="threads (default: one a processor)")
    add_settings(parser)
    return run_command(_identify, parser, argv)


def _identify(arguments: argparse.Namespace) -> int:
    _require_matching(arguments)
    if not arguments.resume:
        require_unused(arguments.output)
    problem, data = _from_recording(arguments) if arguments.recording else _from_targets(arguments)
    # Imported here: loading the kernel takes time, which help and refused options need not wait for.
    from gear_dynamics_ros.identification.fit import request_of, run_fit
    from gear_dynamics_ros.identification.report import fit_text, write_fit
    from gear_dynamics_ros.identification.search import SearchSettings

    settings = SearchSettings(arguments.generations, arguments.population, arguments.seed)
    begin = FitJournal.reopen if arguments.resume else FitJournal.create
    journal = begin(arguments.output, request_of(problem, settings))
    workers = arguments.workers or processor_count()
    with noted_signals() as received, ProgressLine() as line:

        def stopped() -> str:
            return signal.Signals(received[0]).name if received else ""

        shown = _FitProgress()
        fit = run_fit(
            problem,
            settings,
            journal,
            workers,
            lambda standing: line.show(lambda: shown.text(standing)),
            stopped,
        )
        written = write_fit(fit, arguments.output, data)
    if fit.stopped:
        print(
            f"identify: interrupted by {fit.stopped}; {arguments.output} holds the best of "
            f"{fit.evaluated} trials: go on with --resume",
            file=sys.stderr,
        )
        return SIGNALLED + received[0]
    print(fit_text(fit, data))
    for path in written:
        print(path)
    return 0


def _require_matching(arguments: argparse.Namespace) -> None:
    if arguments.recording:
        if arguments.channels is None:
            raise UsageError(
                "--recording needs --channels: name those to fit, such as --channels dte,driving_x"
            )
        return
    for option, value in (
        ("--channels", arguments.channels),
        ("--from", arguments.start),
        ("--to", arguments.end),
    ):
        if value is not None:
            raise UsageError(f"{option} is for --recording: leave it out with --targets")


def _from_recording(arguments: argparse.Namespace) -> tuple[Problem, str]:
    from gear_dynamics_ros import recording
    from gear_dynamics_ros.cli.faults import warn_of_faults

    bag = recording.open(arguments.recording)
    parameters = _parameters(arguments, bag.parameters)
    unknowns = read_unknowns(arguments.vary, parameters)
    from gear_dynamics_ros.identification.objective import Problem
    from gear_dynamics_ros.identification.recorded_motion import (
        MotionObjective,
        parameters_as_recorded,
        read_motion,
        require_not_recorded,
    )
    from gear_dynamics_ros.simulation.warm_up import warm_up

    require_not_recorded(unknowns)
    _warn(parameters)
    warm_up(*stderr_lines("identify"))
    motion = read_motion(bag, arguments.channels.split(","), arguments.start, arguments.end)
    warn_of_faults("identify", bag)
    base = parameters_as_recorded(parameters, motion)
    objective = MotionObjective(motion, base)
    first, interval = motion.measured.first, motion.measured.interval
    data = (
        f"recording {arguments.recording}, channels {arguments.channels}, {first * interval:.9g} s to "
        f"{(first + len(motion.measured)) * interval:.9g} s"
    )
    return Problem(base, unknowns, objective), data


def _from_targets(arguments: argparse.Namespace) -> tuple[Problem, str]:
    parameters = _parameters(arguments, None)
    unknowns = read_unknowns(arguments.vary, parameters)
    from gear_dynamics_ros.identification.target_table import TargetObjective, read_targets

    table = read_targets(arguments.targets)
    from gear_dynamics_ros.identification.motion_quantities import QUANTITIES, measure_of
    from gear_dynamics_ros.identification.objective import Problem
    from gear_dynamics_ros.simulation.warm_up import warm_up_orbit

    _warn(parameters)
    warm_up_orbit(*stderr_lines("identify"))
    objective = TargetObjective(table, measure_of(table.watch), QUANTITIES)
    objective.require_fitting(parameters, unknowns)
    return Problem(parameters, unknowns, objective), f"table {arguments.targets}"


def _parameters(arguments: argparse.Namespace, recorded: Parameters | None) -> Parameters:
    if arguments.params_file is None and recorded is not None:
        return updated(recorded, {**NO_OUTPUTS, **read_settings(arguments.set)})
    return load_parameters(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)


def _warn(parameters: Parameters) -> None:
    from gear_dynamics_ros.physics.advice import parameter_warnings

    for line in parameter_warnings(parameters):
        print(f"identify: warning: {line}", file=sys.stderr)


class _FitProgress:
    """How far the fit has come, and how long it may take."""

    def __init__(self) -> None:
        self._stage, self._began, self._first = "", 0.0, 0

    def text(self, standing: Standing) -> str:
        """One line."""
        if standing.stage != self._stage:
            self._stage, self._began, self._first = standing.stage, time.monotonic(), standing.done
        line = (
            f"{standing.stage} {standing.done} of at most {standing.most}, {standing.evaluated} trials, "
            f"{standing.failed} failed"
        )
        if math.isfinite(standing.cost):
            line += f", least sum of squares {2.0 * standing.cost:.4g}"
        if standing.done > self._first:
            pace = (time.monotonic() - self._began) / (standing.done - self._first)
            line += f", at most {math.ceil(pace * (standing.most - standing.done))} s left"
        return line


def _whole(text: str) -> int:
    return _bounded(text, 0)


def _positive(text: str) -> int:
    return _bounded(text, 1)


def _bounded(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if number < least:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number >= {least}")
    return number


if __name__ == "__main__":
    sys.exit(identify_main())
