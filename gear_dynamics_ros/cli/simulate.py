"""simulate: run the gearbox without ROS, as fast as possible, into the same recording as the node's."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.cli.common import Progress, guarded
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, load
from gear_dynamics_ros.recording.writer import Recorder
from gear_dynamics_ros.resources import share_file
from gear_dynamics_ros.run import Run
from gear_dynamics_ros.signals import Chunk, Status

EPOCH_NS = 0  # simulated time is all the time there is


class RecorderSink:
    """A recorder in a run without a node: what it can't write ends the run."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def write(self, _: Chunk | None, records: Sequence[Record]) -> None:
        """Record the messages. Raises GearboxError once recording has failed."""
        if self._recorder.error is not None:
            raise GearboxError(self._recorder.error)
        self._recorder.write(records)

    def close(self) -> None:
        """Finish the recording. Raises GearboxError if that failed."""
        self._recorder.close()
        if self._recorder.error is not None:
            raise GearboxError(self._recorder.error)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="simulate", description=__doc__)
    parser.add_argument(
        "--params-file", type=Path, help="ROS parameter file (default: the package's config/gearbox.yaml)"
    )
    parser.add_argument("--duration", type=float, required=True, metavar="S", help="simulated time in s")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="recording to make")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="override a parameter; may be repeated"
    )
    return guarded(simulate, parser, argv)


def simulate(arguments: argparse.Namespace) -> int:
    """Simulate and record; exit code 1 if the run ended before its time."""
    parameters = load(arguments.params_file or share_file("config/gearbox.yaml"), arguments.set)
    chunks = whole_chunks(arguments.duration, parameters)
    engine = Engine(parameters)
    recorder = Recorder(arguments.output, parameters, engine.checkpoint(), EPOCH_NS)
    run = Run(engine, Encoder(parameters, EPOCH_NS), [RecorderSink(recorder)])
    try:
        first = run.step()
        began = time.perf_counter()
        last = first
        with Progress("simulated", chunks) as progress:
            for done in range(2, chunks + 1):
                if last.status is not Status.RUNNING:
                    break
                last = run.step()
                progress(done)
        if last.status is Status.RUNNING:
            run.note("end", "duration reached")
    finally:
        run.close()
    elapsed = time.perf_counter() - began
    simulated = (engine.sample - len(first)) * parameters.solver.sample_interval_ns / 1e9
    print(
        f"{arguments.output}: {engine.sample} samples, {engine.sample * parameters.solver.sample_interval_ns / 1e9:g} s"
        f" at {simulated / elapsed:.2f} times real time, recording included"
    )
    if last.status is not Status.RUNNING:
        raise GearboxError(last.message)
    return 0


def whole_chunks(duration: float, parameters: Parameters) -> int:
    """Number of chunks in ``duration`` s. Raises UsageError unless it is a whole, positive number."""
    chunk = parameters.solver.chunk
    count = round(duration / chunk) if 0.0 < duration < float("inf") else 0
    if count < 1 or abs(count * chunk - duration) > 1e-9 * duration:
        raise UsageError(
            f"--duration = {duration:g} s is no whole number of chunks: give a positive multiple of "
            f"solver.chunk = {chunk:g} s, or set another solver.chunk"
        )
    return count


if __name__ == "__main__":
    sys.exit(main())
