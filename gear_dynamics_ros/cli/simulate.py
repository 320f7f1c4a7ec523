"""``simulate``: run the gearbox without ROS into a recording."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.cli.options import add_settings
from gear_dynamics_ros.cli.progress import Progress, stderr_lines
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import Parameters, load_parameters, read_settings, updated
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint
from gear_dynamics_ros.system.command import SIGNALLED, run_command
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.system.share import share_file


def simulate_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``simulate``; returns the exit code.

    0 if the whole duration was simulated, 1 if the run ended before, 2 on bad usage, 128 + n if signal n
    interrupted it.
    """
    parser = argparse.ArgumentParser(
        prog="simulate",
        description="Run the gearbox without ROS, as fast as possible, and record it as the node does.",
    )
    start = parser.add_mutually_exclusive_group()
    start.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    start.add_argument(
        "--from-checkpoint",
        type=Path,
        metavar="FILE",
        help="start from the state and the parameters in a checkpoint file; time starts at 0",
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="simulated time in s (default: pacing.duration)"
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="recording to make")
    add_settings(parser)
    return run_command(_simulate, parser, argv)


def _simulate(arguments: argparse.Namespace) -> int:
    stored, parameters = _start(arguments)
    duration = _duration(arguments.duration, parameters)
    # Imported here: loading the kernel takes time, which help and refused options need not wait for.
    from gear_dynamics_ros.physics.advice import parameter_warnings
    from gear_dynamics_ros.recording.offline import engine_from_checkpoint, simulate_to_recording
    from gear_dynamics_ros.simulation.engine import Engine
    from gear_dynamics_ros.simulation.warm_up import warm_up

    for line in parameter_warnings(parameters):
        print(f"simulate: warning: {line}", file=sys.stderr)
    warm_up(*stderr_lines("simulate"))
    engine = Engine(parameters) if stored is None else engine_from_checkpoint(stored, parameters)
    samples = round(duration / parameters.solver.sample_interval)
    with noted_signals() as received, Progress("simulated", samples) as progress:
        outcome = simulate_to_recording(
            engine,
            arguments.output,
            duration,
            progress,
            lambda: signal.Signals(received[0]).name if received else "",
        )
    print(
        f"{arguments.output}: {outcome.samples} samples, {outcome.duration:g} s at "
        f"{outcome.real_time_factor:.2f} times real time, recording included"
    )
    if outcome.tripped:
        raise GearboxError(outcome.end)
    if received:
        print(
            f"simulate: interrupted by {outcome.end}; the recording is complete up to there", file=sys.stderr
        )
        return SIGNALLED + received[0]
    return 0


def _start(arguments: argparse.Namespace) -> tuple[StoredCheckpoint | None, Parameters]:
    """The checkpoint to start from, None for the start state, and the parameters to simulate with."""
    if arguments.from_checkpoint is None:
        return None, load_parameters(
            arguments.params_file or share_file("config/gearbox.yaml"), arguments.set
        )
    stored = checkpoint.load_checkpoint(arguments.from_checkpoint)
    parameters = updated(stored.checkpoint.parameters, read_settings(arguments.set))
    checkpoint.require_fitting(stored, parameters)
    return stored, parameters


def _duration(wanted: float | None, parameters: Parameters) -> float:
    duration = parameters.pacing.duration if wanted is None else wanted
    if not 0.0 < duration < math.inf:
        name = "pacing.duration" if wanted is None else "--duration"
        raise UsageError(f"{name} = {exact_text(duration)} s: must be positive and finite; give --duration S")
    return duration


if __name__ == "__main__":
    sys.exit(simulate_main())
