"""A gearbox advanced by whole periods of the mesh at constant commands, for sections and statistics."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, GEARS
from gear_dynamics_ros.chunk import Counters, Status
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import aligned_zeros, excitation_table, kernel_constants
from gear_dynamics_ros.physics.kernel import entry, periods
from gear_dynamics_ros.physics.kernel.records import CALL, HERE, POINT
from gear_dynamics_ros.physics.kernel.substeps import IMPACTS_PER_STEP
from gear_dynamics_ros.simulation.start_state import end_reason, start_state

STEPS_PER_PERIOD: Final = 100
SAMPLES_PER_PERIOD: Final = 20
# What is taken at every step, with its unit, in the order of the kernel's extremes.
EXTREMES: Final = {
    "dte": "m",
    "mesh_force": "N",
    **{f"{gear}_penetration": "m" for gear in GEARS},
    **{f"{gear}_contact_force": "N" for gear in GEARS},
    **{f"{gear}_bearing_force": "N" for gear in GEARS},
}


class Extreme(NamedTuple):
    """Least, greatest and mean value of one quantity over all steps, in its own unit."""

    minimum: float
    maximum: float
    mean: float


class OrbitRecord(NamedTuple):
    """What some periods of an orbit gave; SI units."""

    samples: NDArray[np.float64]  # (n, 28), columns CHANNELS, SAMPLES_PER_PERIOD a period
    section: NDArray[np.float64]  # (m, 2), DTE and its rate at mesh phase 0
    phase_error: float  # rad, bound of how far the points of the section lie from mesh phase 0
    extremes: dict[str, Extreme]  # by the names of EXTREMES
    drive_time: float  # s on the drive flank
    back_time: float  # s on the back flank
    time: float  # s in all
    counters: Counters  # of these periods


class Orbit:
    """One gearbox that advances by periods of the mesh at the commanded speed.

    Physics and located events are those of ``Engine``; the step is a fraction of the period. The bits do not
    depend on how many periods are advanced at once.
    """

    def __init__(self, parameters: Parameters, steps_per_period: int = STEPS_PER_PERIOD) -> None:
        """Raises UsageError unless the speed is not 0 and each sample has a whole number of steps."""
        self.status = Status.RUNNING
        self._steps_per_period = steps_per_period
        self._set(parameters)
        self._points, self._call = aligned_zeros((3,), POINT), aligned_zeros((1,), CALL)
        self._impacts = np.empty((IMPACTS_PER_STEP, 6))
        self._first_sample = 0
        self.state = start_state(parameters, self._constants, self._points, self._excitations)

    def _set(self, parameters: Parameters) -> None:
        steps = self._steps_per_period
        if steps < SAMPLES_PER_PERIOD or steps % SAMPLES_PER_PERIOD:
            raise UsageError(
                f"{steps} steps per period of the mesh: give a positive multiple of {SAMPLES_PER_PERIOD}"
            )
        self.parameters = parameters
        self._excitations = excitation_table(parameters)
        self._constants = kernel_constants(parameters, self._excitations)
        self.period = mesh_period(parameters)
        self._constants["step"] = self.period / steps
        self._constants["steps_per_sample"] = steps // SAMPLES_PER_PERIOD

    def copy(self) -> Self:
        """An independent orbit in the same state."""
        twin = type(self)(self.parameters, self._steps_per_period)
        twin.state[:] = self.state
        twin.status, twin._first_sample = self.status, self._first_sample
        return twin

    def displace(self, dte: float | None, dte_rate: float | None) -> None:
        """Set the dynamic transmission error in m and its rate in m/s, where given, by turning both gears.

        The flank in contact follows from the gap.
        """
        here = self._evaluated()
        if dte is not None:
            self.state["u"] += dte - float(here["q"])
            half = float(here["half_backlash"])
            self.state["flank"] = 1.0 if dte > half else -1.0 if dte < -half else 0.0
            here = self._evaluated()
        if dte_rate is not None:
            change = dte_rate - float(here["q_rate"])
            self.state["omega"] += 0.5 * change / self._constants["base_radius"][0] * np.array([1.0, -1.0])

    def _evaluated(self) -> Any:
        entry.evaluate_state(self._constants, self.state, self._points, *self._excitations)
        return self._points[HERE]

    def retarget(self, parameters: Parameters) -> None:
        """Continue under ``parameters``; the vibration is carried over, the shafts turn at the new speed."""
        before = self.parameters.operation
        stored = entry.evaluate_before_change(self._constants, self.state, self._points, *self._excitations)
        self._set(parameters)
        operation = parameters.operation
        r1, r2 = self._constants["base_radius"][0]
        self.state["omega"] += (operation.speed - before.speed) * np.array([1.0, r1 / r2])
        self.state["speed"], self.state["load_torque"] = operation.speed, operation.load_torque
        if operation.control == "torque":
            self.state["drive_torque"] = operation.drive_torque
        entry.adapt_to_change(
            self._constants, self.state, self._points, *self._excitations, self._call, self._impacts, stored
        )

    def advance(self, count: int) -> OrbitRecord:
        """The next ``count`` periods; fewer if the run ends, which ``status`` and ``reason`` then tell."""
        before = self.state.copy()
        samples = np.empty((count * SAMPLES_PER_PERIOD, len(CHANNELS)))
        angles = np.empty((len(samples), 2))
        sections = np.empty((2 * count + 2, periods.SECTION_COLUMNS))
        extremes = np.zeros((periods.EXTREME_COUNT, 3))
        extremes[:, periods.MINIMUM], extremes[:, periods.MAXIMUM] = math.inf, -math.inf
        written, found, status = periods.integrate_periods(
            self._constants,
            self.state,
            self._points,
            *self._excitations,
            self._first_sample,
            SAMPLES_PER_PERIOD,
            samples,
            angles,
            sections,
            extremes,
            self._call,
            self._impacts,
        )
        self._first_sample += written
        self.status = Status(status)
        counters = [int(self.state[name][0] - before[name][0]) for name in Counters._fields]
        steps = max(counters[0], 1)
        return OrbitRecord(
            samples=samples[:written],
            section=sections[:found, :2],
            phase_error=float(np.abs(sections[:found, 2]).max(initial=0.0)),
            extremes={
                name: Extreme(float(low), float(high), float(total) / steps)
                for name, (low, high, total) in zip(EXTREMES, extremes, strict=True)
            },
            drive_time=float(self.state["drive_time"][0] - before["drive_time"][0]),
            back_time=float(self.state["back_time"][0] - before["back_time"][0]),
            time=counters[0] * float(self._constants["step"][0]),
            counters=Counters(*counters),
        )

    @property
    def reason(self) -> str:
        """Why the run has ended; empty while it runs."""
        time = self._first_sample * self.period / SAMPLES_PER_PERIOD
        return end_reason(self.status, self.state, self.parameters, time)


def mesh_period(parameters: Parameters) -> float:
    """Period of the mesh at the commanded speed, s. Raises UsageError if that is 0."""
    speed = abs(parameters.operation.speed)
    if speed == 0.0:
        raise UsageError("operation.speed = 0 rad/s: a gearbox that stands still has no mesh period")
    return 2.0 * math.pi / (speed * parameters.gears.driving.teeth)
