"""Recordings of runs of the engine, made at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import PACE
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.messages.cdr import message_class, serialize
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, change_to, change_values
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import FLOAT64, FLOAT_COMMANDS

Act = Callable[[Run, int], Commands | None]
SHORT = {"solver.chunk": 3e-4}
SHORT_CHUNK = 30  # samples of it


class Recorded:
    """A run and its recorder."""

    def __init__(self, path: Path, parameters: Parameters, epoch_ns: int = 0) -> None:
        self.parameters = parameters
        self.engine = Engine(parameters)
        self.encoder = Encoder(parameters, epoch_ns)
        self.recorder = Recorder(path, self.engine.checkpoint(), epoch_ns)
        self.sink = RecorderSink(self.recorder, self.engine)
        self.run = Run(self.engine, self.encoder, [self.sink])

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.run.step()

    def close(self) -> None:
        """End the recording, which must not have failed."""
        self.run.close()
        assert self.recorder.error is None


def record(
    path: Path, parameters: Parameters, chunks: int, act: Act = lambda run, chunk: None, begin: int = 0
) -> recording.Recording:
    """A run of ``chunks`` chunks, recorded from chunk ``begin`` on.

    ``act`` is called before each chunk: it may do things to the run, and returns commands for the chunk.
    """
    run = Run(Engine(parameters), Encoder(parameters, 0))
    for chunk in range(begin):
        run.step(act(run, chunk))
    # What is done before the first recorded chunk is the past of a recording that is begun later.
    early = act(run, begin) if begin else None
    recorder = Recorder(path, run.checkpoint(), 0)
    run.attach(RecorderSink(recorder, run.engine))
    for chunk in range(begin, chunks):
        run.step(early if begin and chunk == begin else act(run, chunk))
    run.finish("as asked")
    run.close()
    assert recorder.error is None
    return recording.open(path)


def following(deeds: Sequence[Any]) -> Act:
    """What is done before each chunk: commands, or a mapping of parameters to change, or None."""

    def act(run: Run, chunk: int) -> Commands | None:
        deed = deeds[chunk]
        if isinstance(deed, dict):
            run.change(change_values(run.engine.parameters, deed))
        return deed if isinstance(deed, Commands) else None

    return act


def received(commands: Commands | None) -> list[tuple[str, bytes]]:
    """The messages that bring these commands."""
    if commands is None:
        return []
    message = message_class(FLOAT64)
    values = {key: getattr(commands, name) for key, name in FLOAT_COMMANDS.items()}
    return [(key, serialize(FLOAT64, message(data=value))) for key, value in values.items()]


def perform(path: Path, deeds: Sequence[Any], parameters: Parameters) -> Path:
    """Recording of a run in which ``deeds`` were done between its chunks, and one chunk more.

    Commands and mappings of parameters stand for themselves; "restore" goes back to what "save" kept, "tell"
    emits messages that no sample depends on.
    """
    made = Recorded(path, parameters)
    run, engine = made.run, made.engine
    saved = (engine.parameters, run.checkpoint())
    commands = None
    for deed in deeds:
        if isinstance(deed, Commands):
            commands = deed
        elif isinstance(deed, dict):
            run.change(change_values(engine.parameters, deed))
        elif deed == "reset":
            run.reset()
        elif deed == "save":
            saved = (engine.parameters, run.checkpoint())
        elif deed == "restore":
            run.change(change_to(engine.parameters, saved[0]))
            run.resume(saved[1], "as saved")
        elif deed == "split":
            made.sink.split()
        elif deed == "tell":
            now_ns = engine.sample * parameters.solver.sample_interval_ns
            run.write_records(
                [
                    made.encoder.model_info(now_ns, '{"told": 1}'),
                    made.encoder.pacing(now_ns, range(len(PACE))),
                ]
            )
        elif deed == "step":
            run.step(commands, received(commands))
            commands = None
    run.step(commands, received(commands))
    made.close()
    return path
