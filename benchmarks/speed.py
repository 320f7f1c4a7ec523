"""Speed of the engine: what a step costs by step, sample interval and chunk, with recording; error beside it.

Compilation is excluded, transients are not timed. What a table compares takes turns in one run; its figures
are medians over the turns, of the processor's time.
"""

from __future__ import annotations

import csv
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, load_parameters
from gear_dynamics_ros.physics.constants import excitation_table, kernel_constants
from gear_dynamics_ros.physics.kernel.dynamics import motion_after, right_hand_side
from gear_dynamics_ros.physics.kernel.entry import evaluate_state
from gear_dynamics_ros.physics.kernel.lanes import pointer, store
from gear_dynamics_ros.physics.kernel.records import END, HERE, motion_at
from gear_dynamics_ros.physics.kernel.waves import COSINE, SINE, SURFACE, excite_at, rotate_waves, sum_waves
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.simulation.engine import Engine

SOURCE = Path(__file__).resolve().parent.parent
CASES = SOURCE / "test" / "cases"
FILES = ("paper", "gearbox")
STEPS = ("2e-6", "1e-6", "5e-7", "2.5e-7")  # s
SAMPLE_INTERVALS = ("1e-5", "1e-3")  # s
CHUNKS = ("5e-4", "2e-3", "2e-2")  # s
SAMPLING_AIMED_AT = 0.15

WARM = 0.2  # s of simulated time, as the next
TURN = 0.1
TURNS = 9
RECORDED_TURN = 0.5
RECORDED_TURNS = 5
LOOPS = 500_000
REFEREE_SAMPLES = 101


class Costs(NamedTuple):
    """Of one part of the kernel, ns."""

    right_hand_side: float
    excitations: float
    excitations_on: float  # half a step on from those before


def parameters_of(name: str, *overrides: str, model: str = "improved") -> Parameters:
    """Those of config/``name``.yaml."""
    return replace(load_parameters(SOURCE / "config" / f"{name}.yaml", list(overrides)), model=model)


def turns(engines: Mapping[str, Engine]) -> NDArray[np.float64]:
    """Processor time per simulated time of each engine in each turn, (TURNS, engines)."""
    for engine in engines.values():
        run(engine, WARM)
    return np.array([[run(engine, TURN) / TURN for engine in engines.values()] for _ in range(TURNS)])


def run(engine: Engine, simulated: float) -> float:
    """Processor time of as many chunks as make up ``simulated``; all in s."""
    began = time.thread_time_ns()
    for _ in range(round(simulated / engine.parameters.solver.chunk)):
        engine.advance()
    return (time.thread_time_ns() - began) * 1e-9


def settings(option: str, values: Sequence[str], *others: str) -> dict[str, NDArray[np.float64]]:
    """``turns`` of the refined model and the paper's with each value of a solver's option."""
    return {
        name: turns(
            {value: Engine(parameters_of(name, *others, f"solver.{option}={value}")) for value in values}
        )
        for name in FILES
    }


def steps() -> list[str]:
    """Speed at several steps."""
    lines = [
        "| step, us | " + " | ".join(f"{name}.yaml, ns per step | times real time" for name in FILES) + " |"
    ]
    lines.append("|---" * (1 + 2 * len(FILES)) + "|")
    found = {name: np.median(costs, axis=0) for name, costs in settings("step", STEPS).items()}
    for k, step in enumerate(STEPS):
        cells = (f"{found[name][k] * float(step) * 1e9:.0f} | {1.0 / found[name][k]:.2f}" for name in FILES)
        lines.append(f"| {float(step) * 1e6:g} | {' | '.join(cells)} |")
    return lines


def sampling() -> list[str]:
    """Cost of sampling all channels at 100 kHz."""
    lines = [
        "| parameters | times real time at 10 us | at 1 ms | cost of sampling | goal |",
        "|---|---|---|---|---|",
    ]
    for name, costs in settings("sample_interval", SAMPLE_INTERVALS).items():
        often, rarely = np.median(costs, axis=0)
        share = float(np.median(costs[:, 0] / costs[:, 1])) - 1.0
        verdict = (
            "met" if share < SAMPLING_AIMED_AT else f"missed by {100 * (share - SAMPLING_AIMED_AT):.1f} %"
        )
        lines.append(
            f"| {name}.yaml | {1 / often:.2f} | {1 / rarely:.2f} | {100 * share:.1f} % "
            f"| below {100 * SAMPLING_AIMED_AT:.0f} %, {verdict} |"
        )
    return lines


def chunks() -> list[str]:
    """Speed in chunks of several lengths."""
    heads = " | ".join(f"{float(chunk) * 1e3:g} ms" for chunk in CHUNKS)
    lines = [f"| times real time in chunks of | {heads} |", "|---" * (1 + len(CHUNKS)) + "|"]
    for name, costs in settings("chunk", CHUNKS).items():
        cells = " | ".join(f"{1 / cost:.2f}" for cost in np.median(costs, axis=0))
        lines.append(f"| {name}.yaml | {cells} |")
    return lines


def recording(models: Sequence[str]) -> list[str]:
    """Speed with every message made, written and the file finished, by the clock on the wall."""
    lines = ["| parameters | model | times real time | with recording |", "|---|---|---|---|"]
    for name in FILES:
        for model in models:
            parameters = parameters_of(name, model=model)
            pairs = [(seconds(parameters), seconds_recording(parameters)) for _ in range(RECORDED_TURNS)]
            alone, recorded = (RECORDED_TURN / float(median) for median in np.median(pairs, axis=0))
            lines.append(f"| {name}.yaml | {model} | {alone:.2f} | {recorded:.2f} |")
    return lines


def seconds(parameters: Parameters) -> float:
    """Wall time of RECORDED_TURN without recording."""
    engine = Engine(parameters)
    run(engine, WARM)
    began = time.perf_counter()
    run(engine, RECORDED_TURN)
    return time.perf_counter() - began


def seconds_recording(parameters: Parameters) -> float:
    """Wall time of RECORDED_TURN with it."""
    engine = Engine(parameters)
    run(engine, WARM)
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "bag", engine.checkpoint(), 0)
        encoder = Encoder(parameters, 0)
        began = time.perf_counter()
        for _ in range(round(RECORDED_TURN / parameters.solver.chunk)):
            recorder.write(encoder.chunk(engine.advance()))
        recorder.close()
        return time.perf_counter() - began


def referee() -> list[str]:
    """Error of DTE beside the tests' independent solver."""
    lines = ["| case | step | error of DTE over the first millisecond |", "|---|---|---|"]
    for case in ("traditional_6000", "refined_9000"):
        for divisor in (1, 8):
            lines.append(f"| {case} | 1/{divisor} us | {referee_error(case, divisor) * 1e9:.2g} nm |")
    return lines


def referee_error(case: str, divisor: int) -> float:
    """Largest deviation of DTE, m, from an independent solver's run at a fraction of the usual step."""
    parameters = load_parameters(CASES / f"{case}.yaml", [f"solver.step={1e-6 / divisor!r}"])
    with (CASES / f"{case}.csv").open(encoding="utf-8") as file:
        reference = np.array([float(entry["dte"]) for entry in csv.DictReader(file)])[:REFEREE_SAMPLES]
    dte = Engine(parameters).advance(REFEREE_SAMPLES)["dte"]
    return float(np.abs(dte - reference).max())


def costs(parameters: Parameters) -> Costs:
    """Of the kernel's parts, called one after the other, each on what the one before left."""
    engine = Engine(parameters)
    run(engine, WARM)
    table = excitation_table(parameters)
    constants = kernel_constants(parameters, table)
    points, state = engine._points, engine._state
    evaluate_state(constants, state, points, *table)
    evaluations, excitations, excitations_on = _loops()
    return Costs(
        _loop_ns(lambda count: evaluations(constants, state, points, count)),
        _loop_ns(lambda count: excitations(constants, state, points, *table, count)),
        _loop_ns(lambda count: excitations_on(constants, points, *table, count)),
    )


def _loop_ns(loop: Callable[[int], float]) -> float:
    loop(1)
    times = []
    for _ in range(TURNS):
        began = time.thread_time_ns()
        loop(LOOPS)
        times.append((time.thread_time_ns() - began) / LOOPS)
    return statistics.median(times)


@cache
def _loops() -> tuple[Any, Any, Any]:
    """Compiled loops over the kernel's parts; the results keep them from being dropped."""
    compiled = njit(fastmath={"contract"}, error_model="numpy")

    @compiled
    def evaluations(all_constants: Any, all_state: Any, points: Any, count: int) -> float:
        constants, state, here = all_constants[0], all_state[0], points[HERE]
        motion, total = motion_at(here), 0.0
        for n in range(count):
            h = -1e-9 if n & 1 else 1e-9
            rates, teeth, _, _, _ = right_hand_side(constants, state, motion, here.excitation, 0.0)
            motion = motion_after(constants, motion, h, motion, rates)
            total += teeth.force
        return total + motion.u

    @compiled
    def excitations(
        all_constants: Any, all_state: Any, points: Any, wave_rows: Any, amplitude_rows: Any, count: int
    ) -> float:
        constants, state, end = all_constants[0], all_state[0], points[END]
        waves, amplitudes = pointer(wave_rows), pointer(amplitude_rows)
        for n in range(count):
            part_turn = (n & 1023) / 1024.0 + 1e-3 * end.excitation[SURFACE]
            excite_at(constants, state, waves, amplitudes, part_turn, pointer(end.excitation))
        return end.excitation[SURFACE]

    @compiled
    def excitations_on(
        all_constants: Any, points: Any, wave_rows: Any, amplitude_rows: Any, count: int
    ) -> float:
        constants, end = all_constants[0], points[END]
        waves, amplitudes = pointer(wave_rows), pointer(amplitude_rows)
        for _ in range(count):
            rotate_waves(constants, waves)
            total = sum_waves(constants, waves, amplitudes, COSINE, SINE)
            store(end.excitation, 0, total)
        return end.excitation[SURFACE]

    return evaluations, excitations, excitations_on
