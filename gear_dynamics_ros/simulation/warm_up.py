"""Compiles and loads the kernel before a run needs it, and says so."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.physics.kernel.compiling import LOG
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.orbit import SAMPLES_PER_PERIOD, Orbit
from gear_dynamics_ros.simulation.run import Run


def warm_up(say: Callable[[str], object], warn: Callable[[str], object]) -> None:
    """Compile and load everything that a run uses, so that no chunk of a later run is delayed by it.

    ``say`` is told if the kernel is compiled, ``warn`` if the compiled kernel can't be read or kept.
    """
    with _told(say, warn):
        # What is compiled depends on types alone, never on values: one sample of any gearbox will do.
        interval = Parameters.from_flat({}).solver.sample_interval
        parameters = Parameters.from_flat({"solver.chunk": interval})
        run = Run(Engine(parameters), Encoder(parameters, 0))
        run.step()
        run.change(change_values(parameters, {"operation.on_timeout": "release"}))


def warm_up_orbit(say: Callable[[str], object], warn: Callable[[str], object]) -> None:
    """As ``warm_up``, for orbits."""
    with _told(say, warn):
        orbit = Orbit(Parameters.from_flat({}), SAMPLES_PER_PERIOD)
        orbit.advance(1)
        orbit.retarget(orbit.parameters)


class _KernelLog(logging.Handler):
    """Passes on what the kernel's compiler logs."""

    def __init__(self, say: Callable[[str], object], warn: Callable[[str], object]) -> None:
        super().__init__()
        self._say, self._warn = say, warn
        self.compiled = False

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            self._warn(record.getMessage())
        else:
            self.compiled = True
            self._say(record.getMessage())


@contextmanager
def _told(say: Callable[[str], object], warn: Callable[[str], object]) -> Iterator[None]:
    began = time.perf_counter()
    with _kernel_log(say, warn) as log:
        yield
    if log.compiled:
        say(f"compiled in {time.perf_counter() - began:.0f} s")


@contextmanager
def _kernel_log(say: Callable[[str], object], warn: Callable[[str], object]) -> Iterator[_KernelLog]:
    handler, level = _KernelLog(say, warn), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield handler
    finally:
        LOG.setLevel(level)
        LOG.removeHandler(handler)
