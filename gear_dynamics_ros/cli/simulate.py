"""simulate: run the gearbox without ROS, as fast as possible, into the same recording as the node's."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.cli.common import SIGNALLED, Progress, add_settings, guarded
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, change_to, load, read_settings, updated
from gear_dynamics_ros.physics import step_check
from gear_dynamics_ros.realtime.engine_thread import warm_up
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.sink import RecorderSink
from gear_dynamics_ros.simulation import checkpoints
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import Ending
from gear_dynamics_ros.system.processes import noted_signals
from gear_dynamics_ros.system.share import share_file

EPOCH_NS = 0  # simulated time is all the time there is


class StrictRecorderSink(RecorderSink):
    """A recorder without which there is no point in going on: what it can't write ends the run."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Record the messages. Raises GearboxError once recording has failed."""
        self._check()
        super().write(chunk, records)

    def close(self) -> None:
        """Finish the recording. Raises GearboxError if that failed."""
        super().close()
        self._check()

    def _check(self) -> None:
        if self.recorder.error is not None:
            raise GearboxError(self.recorder.error)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="simulate", description=__doc__)
    origin = parser.add_mutually_exclusive_group()
    origin.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    origin.add_argument(
        "--from-checkpoint",
        type=Path,
        metavar="FILE",
        help="go on from the state and the parameters in a checkpoint file; time begins at 0",
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="simulated time in s (default: pacing.duration)"
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="recording to make")
    add_settings(parser)
    return guarded(simulate, parser, argv)


def simulate(arguments: argparse.Namespace) -> int:
    """Simulate and record; exit code 1 if the run ended before its time, 128 + n if signal n broke it off."""
    if arguments.from_checkpoint is None:
        saved = None
        parameters = load(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)
    else:
        saved = checkpoints.load(arguments.from_checkpoint)
        parameters = updated(saved.parameters, read_settings(arguments.set))
        checkpoints.require_fitting(saved, parameters)
    duration = checked_duration(arguments.duration, parameters)
    for line in step_check.warnings(parameters):
        print(f"simulate: warning: {line}", file=sys.stderr)
    warm_up(parameters, lambda line: print(f"simulate: {line}", file=sys.stderr))
    engine = Engine(parameters) if saved is None else resumed(saved, parameters)
    recorder = Recorder(arguments.output, parameters, engine.checkpoint(), EPOCH_NS)
    run = Run(
        engine, Encoder(parameters, EPOCH_NS), [StrictRecorderSink(recorder, engine)], duration=duration
    )
    interval = parameters.solver.sample_interval_ns / 1e9
    with noted_signals() as received:
        try:
            run.step()  # opens the files, which is not part of the pace told below
            warm, began = engine.sample, time.perf_counter()
            with Progress("simulated", round(duration / interval)) as progress:
                while not (run.state.ended or received):
                    run.step()
                    progress(engine.sample)
            if received:
                run.finish(signal.Signals(received[0]).name)
        finally:
            run.close()
    elapsed = time.perf_counter() - began
    pace = (engine.sample - warm) * interval / elapsed
    print(
        f"{arguments.output}: {engine.sample} samples, {engine.sample * interval:g} s at {pace:.2f} times "
        "real time, recording included"
    )
    if run.state.ending is Ending.TRIPPED:
        raise GearboxError(run.state.reason)
    if received:
        print(
            f"simulate: broken off by {run.state.reason}; the recording is complete up to there",
            file=sys.stderr,
        )
        return SIGNALLED + received[0]
    return 0


def resumed(saved: checkpoints.Saved, parameters: Parameters) -> Engine:
    """Engine in the state of ``saved`` at time 0, where ``parameters`` come into force.

    Raises UsageError if they don't fit the state, GearboxError if the state is spoilt.
    """
    engine = Engine(checkpoints.continued(saved, parameters))
    engine.resume(saved.checkpoint)
    engine.change(change_to(engine.parameters, parameters))
    return engine


def checked_duration(wanted: float | None, parameters: Parameters) -> float:
    """Simulated time in s: ``--duration`` or ``pacing.duration``. Raises UsageError unless positive."""
    duration = parameters.pacing.duration if wanted is None else wanted
    if not 0.0 < duration < math.inf:
        name = "pacing.duration" if wanted is None else "--duration"
        raise UsageError(f"{name} = {duration:g} s: must be positive and finite; give --duration S")
    return duration


if __name__ == "__main__":
    sys.exit(main())
