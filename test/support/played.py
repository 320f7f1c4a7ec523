"""Recordings made at once, for tests that play them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gear_dynamics_ros import recording
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.messages import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.writer import Recorder
from gear_dynamics_ros.recordings import RecorderSink
from gear_dynamics_ros.run import Run
from gear_dynamics_ros.signals import Commands

Act = Callable[[Run, int], Commands | None]


def record(path: Path, parameters: Parameters, chunks: int, act: Act, begin: int = 0) -> recording.Recording:
    """A run of ``chunks`` chunks, recorded from chunk ``begin`` on.

    ``act`` is called before each chunk: it may do things to the run, and returns commands for the chunk.
    """
    run = Run(Engine(parameters), Encoder(parameters, 0))
    for chunk in range(begin):
        run.step(act(run, chunk))
    # What is done before the first recorded chunk is the past of a recording that is begun later.
    early = act(run, begin) if begin else None
    run.attach(RecorderSink(Recorder(path, parameters, run.checkpoint(), 0), run.engine))
    for chunk in range(begin, chunks):
        run.step(early if begin and chunk == begin else act(run, chunk))
    run.finish("done")
    run.close()
    return recording.open(path)
