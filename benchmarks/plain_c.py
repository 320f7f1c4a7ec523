"""The plain C program of plain/gearbox.c, compiled and called: the yardstick of the kernel's speed.

Run as a program it times it beside the engine, in the same run, and compares what both compute.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shlex
import shutil
import statistics
import subprocess
import tempfile
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters, load
from gear_dynamics_ros.physics import derived
from gear_dynamics_ros.signals import CHANNELS, COLUMN, Status

SOURCE = Path(__file__).resolve().parent
PROGRAM = SOURCE / "plain" / "gearbox.c"
FLAGS = ("-std=c11", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno")

SERIES_TERMS = 10
WARM_CHUNKS = 100
TIMED_CHUNKS = 25
REPEATS = 9
MODELS = ("traditional", "compared", "improved")
LOOPS = 1_000_000
COMPARED_SAMPLES = 101

Floats = NDArray[np.float64]

_INTEGERS = (
    "kelvin film exact_geometry contact_damping nominal_phase brake governed hunting steps_per_sample"
).split()
_NUMBERS = (
    "centre_distance base_radius1 base_radius2 per_radii2 tan2_alpha0 involute_alpha0 involute_series "
    "half_backlash stiffness damping error_mean per_mass1 per_mass2 per_inertia1 per_inertia2 teeth1 "
    "clearance kelvin_stiffness kelvin_damping hertz damping_factor per_oil_clearance film_factor "
    "minimum_impact_speed eccentricity_limit2 load_viscous governor_proportional governor_integral "
    "governor_limit speed_limit step"
).split()
_LENGTHS = {"involute_series": SERIES_TERMS} | dict.fromkeys(
    (
        "clearance",
        "kelvin_stiffness",
        "kelvin_damping",
        "hertz",
        "damping_factor",
        "per_oil_clearance",
        "film_factor",
    ),
    2,
)


def _number(name: str) -> type[ctypes.c_double] | type[ctypes.Array[ctypes.c_double]]:
    return ctypes.c_double * _LENGTHS[name] if name in _LENGTHS else ctypes.c_double


class Constants(ctypes.Structure):
    """``struct constants`` of the program."""

    _fields_ = [(name, ctypes.c_int64) for name in _INTEGERS] + [(name, _number(name)) for name in _NUMBERS]


class Counters(ctypes.Structure):
    """``struct counters`` of the program."""

    _fields_ = [
        (name, ctypes.c_int64) for name in ("steps", "events", "capped", "impacts", "flank_changes")
    ]


class Comparison(NamedTuple):
    """What both computed: largest difference of DTE, m; events of program and engine."""

    dte: float
    events: int
    engine_events: int


@cache
def library(flags: tuple[str, ...] = FLAGS) -> ctypes.CDLL:
    """The compiled program. Raises GearboxError in one line without a C compiler or if it fails."""
    compiler = shlex.split(os.environ.get("CC", "gcc"))
    if shutil.which(compiler[0]) is None:
        raise GearboxError(f"no C compiler: {compiler[0]} is not installed (CC names another)")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "gearbox.so"
        command = [*compiler, *flags, "-shared", "-fPIC", str(PROGRAM), "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            reason = done.stderr.strip().splitlines()[:1] or ["no reason given"]
            raise GearboxError(f"{shlex.join(command)} failed: {reason[0]}")
        loaded = ctypes.CDLL(str(target))
    pointer, size, number = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
    loaded.gearbox_new.argtypes = [ctypes.POINTER(Constants), size, pointer, pointer]
    loaded.gearbox_new.restype = pointer
    loaded.gearbox_free.argtypes = [pointer]
    loaded.gearbox_free.restype = None
    loaded.gearbox_start.argtypes = [pointer, *[number] * 5]
    loaded.gearbox_start.restype = None
    loaded.gearbox_advance.argtypes = [pointer, size, size, size, pointer, pointer, ctypes.POINTER(size)]
    loaded.gearbox_counters.argtypes = [pointer]
    loaded.gearbox_counters.restype = Counters
    for loop in (loaded.gearbox_evaluations, loaded.gearbox_excitations):
        loop.argtypes = [pointer, size]
        loop.restype = number
    return loaded


class PlainC:
    """One gearbox of the C program, at the start state and commands of ``parameters``."""

    def __init__(self, parameters: Parameters, flags: tuple[str, ...] = FLAGS) -> None:
        self._handle: int | None = None
        self._library = library(flags)
        self._interval_ns = parameters.solver.sample_interval_ns
        self._sample = 0
        record = derived.constants(parameters)
        constants = Constants()
        for name in _INTEGERS:
            setattr(constants, name, int(record[name]))
        for name in _NUMBERS:
            values = record[name]
            setattr(constants, name, tuple(values.tolist()) if name in _LENGTHS else float(values))
        table = derived.excitations(parameters)
        orders = np.ascontiguousarray(table.orders)
        amplitudes = np.ascontiguousarray(table.amplitudes)
        self._handle = self._library.gearbox_new(constants, len(orders), _data(orders), _data(amplitudes))
        if self._handle is None:
            raise GearboxError("the C program is out of memory")
        operation = parameters.operation
        speed = operation.speed if operation.initial == "touching" else 0.0
        speed2 = speed * constants.base_radius1 / constants.base_radius2
        self._library.gearbox_start(
            self._handle, operation.speed, operation.drive_torque, operation.load_torque, speed, speed2
        )

    def __del__(self) -> None:
        if self._handle is not None:
            self._library.gearbox_free(self._handle)

    def advance(self, samples: int) -> Floats:
        """The next ``samples`` samples, a row of CHANNELS each. Raises GearboxError if the run ends."""
        rows = np.empty((samples, len(CHANNELS)))
        angles = np.empty((samples, 2))
        written = ctypes.c_size_t()
        status = self._library.gearbox_advance(
            self._handle, self._sample, self._interval_ns, samples, _data(rows), _data(angles), written
        )
        self._sample += written.value
        if status != Status.RUNNING:
            raise GearboxError(f"the C program's run ended at sample {self._sample}: {Status(status).name}")
        return rows

    @property
    def counters(self) -> Counters:
        """Steps, events and what was capped since the start."""
        counted: Counters = self._library.gearbox_counters(self._handle)
        return counted

    def evaluation_ns(self, loops: int = LOOPS) -> float:
        """Time of one right-hand side at the present state, contacts frozen and excitations given; ns."""
        return self._loop_ns(self._library.gearbox_evaluations, loops)

    def excitation_ns(self, loops: int = LOOPS) -> float:
        """Time of one sum of all periodic excitations; ns."""
        return self._loop_ns(self._library.gearbox_excitations, loops)

    def _loop_ns(self, loop: ctypes._FuncPointer, loops: int) -> float:  # type: ignore[name-defined]
        times = []
        for _ in range(REPEATS):
            began = time.perf_counter_ns()
            loop(self._handle, loops)
            times.append((time.perf_counter_ns() - began) / loops)
        return statistics.median(times)


def compare(parameters: Parameters, samples: int = COMPARED_SAMPLES) -> Comparison:
    """Program and engine over the first ``samples`` samples."""
    program, engine = PlainC(parameters), Engine(parameters)
    dte = program.advance(samples)[:, COLUMN["dte"]]
    chunk = engine.advance(samples)
    return Comparison(
        float(np.abs(dte - chunk["dte"]).max()), int(program.counters.events), chunk.counters.events
    )


def step_ns(parameters: Parameters) -> tuple[float, float, float]:
    """Time per step of program and engine, ns, and their ratio: medians of turns taken one after the other."""
    program, engine = PlainC(parameters), Engine(parameters)
    solver = parameters.solver
    samples = solver.samples_per_chunk
    for _ in range(WARM_CHUNKS):
        program.advance(samples)
        engine.advance(samples)
    steps = TIMED_CHUNKS * samples * solver.steps_per_sample
    ours, theirs = [], []
    for _ in range(REPEATS):
        began = time.perf_counter_ns()
        for _ in range(TIMED_CHUNKS):
            program.advance(samples)
        middle = time.perf_counter_ns()
        for _ in range(TIMED_CHUNKS):
            engine.advance(samples)
        theirs.append((middle - began) / steps)
        ours.append((time.perf_counter_ns() - middle) / steps)
    ratios = [ours_ns / theirs_ns for ours_ns, theirs_ns in zip(ours, theirs, strict=True)]
    return statistics.median(theirs), statistics.median(ours), statistics.median(ratios)


def main() -> None:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("| parameters | model | C, ns per step | engine | ratio | C, ns per evaluation | per excitation sum "
          "| DTE differs by, m | events, C and engine |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in ("paper", "gearbox"):
        for model in MODELS:
            parameters = replace(load(SOURCE.parent / "config" / f"{name}.yaml"), model=model)
            print(row(name, parameters), flush=True)


def row(name: str, parameters: Parameters) -> str:
    """One line of the table."""
    theirs, ours, ratio = step_ns(parameters)
    same = compare(parameters)
    program = PlainC(parameters)
    program.advance(WARM_CHUNKS * parameters.solver.samples_per_chunk)
    return (
        f"| {name}.yaml | {parameters.model} | {theirs:.0f} | {ours:.0f} | {ratio:.2f} "
        f"| {program.evaluation_ns():.1f} | {program.excitation_ns():.1f} "
        f"| {same.dte:.1e} | {same.events}, {same.engine_events} |"
    )


def _data(array: Floats) -> int:
    return int(array.ctypes.data)


if __name__ == "__main__":
    main()
