"""The engine: state and commands in, chunks of samples out; no clock, no ROS, no file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics import derived, kernel
from gear_dynamics_ros.signals import CHANNELS, Chunk, Commands, Counters, Status

CHECKPOINT_FORMAT = 1


def kernel_hash() -> str:
    """SHA-256 of the kernel's source, as hexadecimal text."""
    return hashlib.sha256(Path(kernel.__file__).read_bytes()).hexdigest()


class Engine:
    """One gearbox: advances in chunks; the same bits at any chunk length."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self._constants = derived.constants(parameters)
        self._excitations = derived.excitations(parameters)
        self._interval_ns = parameters.solver.sample_interval_ns
        self.sample = 0
        self.reset()

    def reset(self) -> None:
        """Back to the start state and the commands of the parameters; time goes on."""
        operation = self.parameters.operation
        self.commands = Commands(operation.drive_torque, operation.load_torque, operation.speed)
        self.status = Status.RUNNING
        self._y = np.zeros(kernel.STATE_SIZE)
        self._flags = np.zeros(kernel.FLAGS_SIZE, dtype=np.int64)
        if operation.initial == "touching":
            self._y[kernel.OMEGA1] = operation.speed
            self._y[kernel.OMEGA2] = (
                operation.speed * self._constants.base_radius1 / self._constants.base_radius2
            )
        self._y[kernel.DRIVE_TORQUE] = operation.drive_torque
        self._y[kernel.GOVERNOR] = operation.drive_torque
        self._y[kernel.IMPACT_SPEED : kernel.IMPACT_SPEED + 2] = self._constants.minimum_impact_speed
        kernel.touch(self._constants, self._kernel_commands(), *self._excitations, self._y, self._flags)

    def command(self, commands: Commands) -> None:
        """Put ``commands`` in force from the next sample on."""
        self.commands = commands
        if not self._constants.governed:
            self._y[kernel.DRIVE_TORQUE] = commands.drive_torque

    def advance(self, samples: int | None = None) -> Chunk:
        """The next ``samples`` samples (default: a chunk); fewer if the run ends in them.

        Raises GearboxError if the run has ended already.
        """
        if self.status is not Status.RUNNING:
            raise GearboxError(f"the run has ended ({self._reason()}); reset it to go on")
        count = self.parameters.solver.samples_per_chunk if samples is None else samples
        rows = np.empty((count, len(CHANNELS)))
        angles = np.empty((count, 2))
        first = self.sample
        written, status = kernel.run(
            self._constants,
            self._kernel_commands(),
            *self._excitations,
            self._y,
            self._flags,
            first,
            self._interval_ns,
            rows,
            angles,
        )
        self.sample = first + written
        self.status = Status(status)
        return Chunk(
            first_sample=first,
            interval_ns=self._interval_ns,
            samples=rows[:written],
            angles=angles[:written],
            commands=self.commands,
            counters=Counters(*(int(self._flags[i]) for i in _COUNTED)),
            status=self.status,
            message=self._reason(),
        )

    def checkpoint(self) -> dict[str, Any]:
        """Everything that decides the future, as JSON keeps it exactly."""
        return {
            "format": CHECKPOINT_FORMAT,
            "sample": self.sample,
            "status": int(self.status),
            "commands": self.commands._asdict(),
            "state": self._y.tolist(),
            "flags": self._flags.tolist(),
        }

    def restore(self, checkpoint: dict[str, Any]) -> None:
        """Go on from ``checkpoint``. Raises GearboxError, changing nothing, if it can't be one."""
        try:
            form = checkpoint["format"]
            y = np.array(checkpoint["state"], dtype=np.float64)
            flags = np.array(checkpoint["flags"], dtype=np.int64)
            commands = Commands(**checkpoint["commands"])
            sample, status = int(checkpoint["sample"]), Status(checkpoint["status"])
        except (KeyError, TypeError, ValueError) as error:
            raise GearboxError(f"the checkpoint lacks or spoils an entry: {error!r}") from error
        if form != CHECKPOINT_FORMAT or y.shape != self._y.shape or flags.shape != self._flags.shape:
            raise GearboxError(
                f"the checkpoint has format {form}, this version reads {CHECKPOINT_FORMAT}: "
                "use the version that wrote it"
            )
        self._y, self._flags, self.commands = y, flags, commands
        self.sample, self.status = sample, status

    def _kernel_commands(self) -> tuple[float, float]:
        return (self.commands.speed, self.commands.load_torque)

    def _reason(self) -> str:
        if self.status is Status.OVER_SPEED:
            fastest = max(abs(self._y[kernel.OMEGA1]), abs(self._y[kernel.OMEGA2]))
            limit = self.parameters.operation.speed_limit
            return f"over-speed: {fastest:.6g} rad/s exceeds operation.speed_limit = {limit:g} rad/s"
        if self.status is Status.NON_FINITE:
            return (
                f"the state is no longer finite at t = {self.sample * self._interval_ns * 1e-9:.9g} s: "
                f"lower solver.step = {self.parameters.solver.step:g} s or check the parameters"
            )
        if self.status is Status.CENTRES_PRESSED:
            return (
                "the centres are pressed together: no backlash is left (b1 <= 0) and both flanks would touch"
            )
        return ""


_COUNTED = (kernel.STEPS, kernel.EVENTS, kernel.CAPPED, kernel.IMPACTS, kernel.FLANK_CHANGES)
