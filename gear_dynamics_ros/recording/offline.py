"""Simulates and records, without ROS and without a clock, as fast as possible."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, change_to
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.simulation.checkpoint import StoredCheckpoint, parameters_to_continue
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import Ending

EPOCH_NS: Final = 0  # without ROS time, stamps are simulated time


class SimulationOutcome(NamedTuple):
    """Result of a simulation."""

    samples: int
    duration: float  # simulated time, s
    real_time_factor: float  # with recording, but without the first chunk, which opens the files
    end: str  # why the run ended
    tripped: bool  # the model itself ended the run


class StrictRecorderSink(RecorderSink):
    """A recorder whose failure ends the run, because the recording is its only result."""

    def write(self, chunk: Chunk | None, records: Sequence[Record]) -> None:
        """Record the messages. Raises GearboxError once recording has failed."""
        self._require_recording()
        super().write(chunk, records)

    def close(self) -> None:
        """Finish the recording. Raises GearboxError if that failed."""
        super().close()
        self._require_recording()

    def _require_recording(self) -> None:
        if self.recorder.error is not None:
            raise GearboxError(self.recorder.error)


def engine_from_checkpoint(stored: StoredCheckpoint, parameters: Parameters) -> Engine:
    """Engine at simulated time 0 in the state of ``stored``, with ``parameters`` in force.

    Raises UsageError if ``parameters`` don't fit the state, GearboxError if the state is invalid.
    """
    engine = Engine(parameters_to_continue(stored, parameters))
    engine.resume(stored.checkpoint)
    engine.change(change_to(engine.parameters, parameters))
    return engine


def simulate_to_recording(
    engine: Engine,
    output: Path,
    duration: float,
    progress: Callable[[int], None],
    interruption: Callable[[], str],
) -> SimulationOutcome:
    """Run ``engine`` for ``duration`` s of simulated time and record it in the new folder ``output``.

    ``progress`` is called with the number of samples computed. The run ends early as soon as ``interruption``
    returns a text that is not empty, which is then the reason. Raises UsageError if ``output`` exists or
    can't be created, GearboxError if recording fails.
    """
    parameters = engine.parameters
    recorder = Recorder(output, engine.checkpoint(), EPOCH_NS)
    sink = StrictRecorderSink(recorder, engine)
    run = Run(engine, Encoder(parameters, EPOCH_NS), [sink], duration=duration)
    try:
        run.step()
        warm, began = engine.sample, time.perf_counter()
        while not (run.state.ended or interruption()):
            run.step()
            progress(engine.sample)
        if reason := interruption():
            run.finish(reason)
    finally:
        run.close()
    elapsed = time.perf_counter() - began
    interval = parameters.solver.sample_interval_ns / 1e9
    return SimulationOutcome(
        samples=engine.sample,
        duration=engine.sample * interval,
        real_time_factor=(engine.sample - warm) * interval / elapsed,
        end=run.state.reason,
        tripped=run.state.ending is Ending.TRIPPED,
    )
