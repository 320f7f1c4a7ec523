"""Re-simulate a recording from its start state with all that was done, and compare every sample's bits."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import __version__
from gear_dynamics_ros.engine import Engine, kernel_hash
from gear_dynamics_ros.parameters import updated
from gear_dynamics_ros.recording.reader import Event, Recording
from gear_dynamics_ros.run import CHANGE, RESET, RESTORE
from gear_dynamics_ros.signals import COLUMN, Commands


class Difference(NamedTuple):
    """The first value that came out otherwise; ``simulated`` is None where the run ended before."""

    sample: int
    channel: str
    recorded: float
    simulated: float | None


class Verification(NamedTuple):
    """What a re-simulation found."""

    samples: int  # compared
    simulated: float  # s
    elapsed: float  # s of wall time, compilation included
    difference: Difference | None


def verify(recording: Recording, progress: Callable[[int], None] | None = None) -> Verification:
    """Run the model again from the recording's start state.

    Its commands, changes of parameters, restored checkpoints and resets act at their samples.

    ``progress`` is called with the number of samples compared so far.
    """
    began = time.perf_counter()
    engine = Engine(recording.parameters)
    engine.restore(recording.start)
    actions = _actions(recording)
    columns = [COLUMN[name] for name in recording.channel_names]
    compared = 0
    difference = None
    for first, recorded in recording.chunks():
        _act(engine, actions, first)
        chunk = (
            engine.advance(len(recorded)).samples if engine.sample == first and not engine.status else None
        )
        simulated = None if chunk is None else chunk[:, columns]
        difference = _first_difference(first, recorded, simulated, recording.channel_names)
        if difference is not None:
            break
        compared += len(recorded)
        if progress is not None:
            progress(compared)
    simulated_time = compared * recording.sample_interval_ns / 1e9
    return Verification(compared, simulated_time, time.perf_counter() - began, difference)


def origins(recording: Recording) -> list[str]:
    """What of the program differs between the recording and this installation, one line each."""
    pairs = (
        ("version", recording.version, __version__),
        ("kernel hash", recording.kernel_hash, kernel_hash()),
    )
    return [f"{name}: recorded by {theirs}, this is {ours}" for name, theirs, ours in pairs if theirs != ours]


def _actions(recording: Recording) -> deque[tuple[int, Event | Commands]]:
    """Events in their order and commands, by sample; commands come after the events of their sample."""
    start = int(recording.start["sample"])
    actions: list[tuple[int, Event | Commands]] = [(event.sample, event) for event in recording.events]
    actions.extend(recording.commands)
    # What a part repeats from the one before it is in its start state already.
    return deque(sorted((action for action in actions if action[0] >= start), key=lambda action: action[0]))


def _act(engine: Engine, actions: deque[tuple[int, Event | Commands]], sample: int) -> None:
    while actions and actions[0][0] <= sample:
        _, action = actions.popleft()
        if isinstance(action, Commands):
            engine.command(action)
        else:
            _repeat(engine, action)


def _repeat(engine: Engine, event: Event) -> None:
    if event.kind == RESET:
        engine.reset()
    elif event.kind == CHANGE:
        engine.change(updated(engine.parameters, event.parameters))
    elif event.kind == RESTORE:
        engine.resume(event.checkpoint)


def _first_difference(
    first: int,
    recorded: NDArray[np.float64],
    simulated: NDArray[np.float64] | None,
    channels: tuple[str, ...],
) -> Difference | None:
    if simulated is None:
        return Difference(first, channels[0], float(recorded[0, 0]), None)
    common = min(len(recorded), len(simulated))
    bits = np.ascontiguousarray(recorded[:common]).view(np.int64)
    unlike = bits != np.ascontiguousarray(simulated[:common]).view(np.int64)
    if unlike.any():
        row, column = divmod(int(unlike.argmax()), unlike.shape[1])
        return Difference(
            first + row, channels[column], float(recorded[row, column]), float(simulated[row, column])
        )
    if common < len(recorded):
        return Difference(first + common, channels[0], float(recorded[common, 0]), None)
    return None
