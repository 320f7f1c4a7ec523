"""The plain C program of plain/gearbox.c, compiled and called: the yardstick of the kernel's speed.

It is timed beside the engine, in the same run, and what both compute is compared. Times are the processor's,
not the clock's: other programs on the same core weigh less.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, COLUMN
from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import Excitations, excitation_table, kernel_constants
from gear_dynamics_ros.physics.kernel.waves import ORDER
from gear_dynamics_ros.simulation.engine import Engine

PROGRAM = Path(__file__).resolve().parent / "plain" / "gearbox.c"
FLAGS = ("-std=c11", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno")

WARM_CHUNKS = 100
TIMED_CHUNKS = 50
REPEATS = 15
LOOPS = 500_000
COMPARED_SAMPLES = 101

Floats = NDArray[np.float64]

_FIELDS: dict[str, type[ctypes.c_int64] | type[ctypes.c_double] | type[ctypes.Array[ctypes.c_double]]] = {
    "kelvin": ctypes.c_int64,
    "film": ctypes.c_int64,
    "exact_geometry": ctypes.c_int64,
    "contact_damping": ctypes.c_int64,
    "nominal_phase": ctypes.c_int64,
    "brake": ctypes.c_int64,
    "governed": ctypes.c_int64,
    "hunting": ctypes.c_int64,
    "steps_per_sample": ctypes.c_int64,
    "centre_distance": ctypes.c_double,
    "base_radius": ctypes.c_double * 2,
    "per_radii": ctypes.c_double,
    "tan2_alpha0": ctypes.c_double,
    "involute_alpha0": ctypes.c_double,
    "involute_series": ctypes.c_double * 9,
    "half_backlash": ctypes.c_double,
    "stiffness": ctypes.c_double,
    "damping": ctypes.c_double,
    "error_mean": ctypes.c_double,
    "per_mass": ctypes.c_double * 2,
    "per_inertia": ctypes.c_double * 2,
    "per_mesh_mass": ctypes.c_double,
    "teeth1": ctypes.c_double,
    "clearance": ctypes.c_double * 2,
    "kelvin_stiffness": ctypes.c_double * 2,
    "kelvin_damping": ctypes.c_double * 2,
    "hertz": ctypes.c_double * 2,
    "damping_factor": ctypes.c_double * 2,
    "per_oil_clearance": ctypes.c_double * 2,
    "film_factor": ctypes.c_double * 2,
    "minimum_impact_speed": ctypes.c_double,
    "eccentricity_limit2": ctypes.c_double,
    "load_viscous": ctypes.c_double,
    "governor_proportional": ctypes.c_double,
    "governor_integral": ctypes.c_double,
    "governor_limit": ctypes.c_double,
    "speed_limit": ctypes.c_double,
    "step": ctypes.c_double,
}


class Constants(ctypes.Structure):
    """``struct constants`` of the program."""

    _fields_ = list(_FIELDS.items())


class Counters(ctypes.Structure):
    """``struct counters`` of the program."""

    _fields_ = [(name, ctypes.c_int64) for name in ("steps", "events", "capped", "impacts", "flank_changes")]


class Comparison(NamedTuple):
    """What both computed: largest difference of DTE, m; events of program and engine."""

    dte: float
    events: int
    engine_events: int


def command() -> str:
    """How the program is compiled."""
    return shlex.join([*_compiler(), *FLAGS])


def _compiler() -> list[str]:
    return shlex.split(os.environ.get("CC", "gcc"))


@cache
def library(flags: tuple[str, ...] = FLAGS) -> ctypes.CDLL:
    """The compiled program. Raises GearboxError in one line without a C compiler or if it fails."""
    compiler = _compiler()
    if shutil.which(compiler[0]) is None:
        raise GearboxError(f"no C compiler: {compiler[0]} is not installed (CC names another)")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "gearbox.so"
        call = [*compiler, *flags, "-shared", "-fPIC", str(PROGRAM), "-o", str(target), "-lm"]
        done = subprocess.run(call, capture_output=True, text=True)
        if done.returncode != 0:
            reason = done.stderr.strip().splitlines()[:1] or ["no reason given"]
            raise GearboxError(f"{shlex.join(call)} failed: {reason[0]}")
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
        table = excitation_table(parameters)
        constants = _constants(parameters, table)
        count = np.count_nonzero(table.waves[ORDER])
        orders = table.waves[ORDER, :count].copy()
        amplitudes = np.ascontiguousarray(table.amplitudes[:count].swapaxes(0, 1))
        self._handle = self._library.gearbox_new(constants, len(orders), _data(orders), _data(amplitudes))
        if self._handle is None:
            raise GearboxError("the C program is out of memory")
        operation = parameters.operation
        speed = operation.speed if operation.initial == "touching" else 0.0
        speed2 = speed * constants.base_radius[0] / constants.base_radius[1]
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

    def _loop_ns(self, loop: Callable[[int | None, int], float], loops: int) -> float:
        times = []
        for _ in range(REPEATS):
            began = time.thread_time_ns()
            loop(self._handle, loops)
            times.append((time.thread_time_ns() - began) / loops)
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
    """Time per step of program and engine, ns, and their ratio: medians of alternate turns."""
    program, engine = PlainC(parameters), Engine(parameters)
    samples = parameters.solver.samples_per_chunk
    steps = TIMED_CHUNKS * samples * parameters.solver.steps_per_sample

    def advance_both(chunks: int) -> tuple[float, float]:
        began = time.thread_time_ns()
        for _ in range(chunks):
            program.advance(samples)
        middle = time.thread_time_ns()
        for _ in range(chunks):
            engine.advance(samples)
        return (middle - began) / steps, (time.thread_time_ns() - middle) / steps

    advance_both(WARM_CHUNKS)
    turns = np.array([advance_both(TIMED_CHUNKS) for _ in range(REPEATS)])
    of_program, of_engine = np.median(turns, axis=0)
    return float(of_program), float(of_engine), float(np.median(turns[:, 1] / turns[:, 0]))


def _constants(parameters: Parameters, table: Excitations) -> Constants:
    """What kernel_constants holds, field by field: its layout is the kernel's own affair."""
    record = kernel_constants(parameters, table)[0]
    constants = Constants()
    for name in _FIELDS:
        values = record[name]
        if name == "involute_series":
            # The kernel's series of four functions stand side by side; the first begins with a zero.
            values = values[4::4]
        setattr(constants, name, tuple(values.tolist()) if values.ndim else values.item())
    return constants


def _data(array: Floats) -> int:
    return int(array.ctypes.data)
