"""The engine: computes chunks of samples from state and commands; no clock, no ROS, no file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import (
    CHANNELS,
    COLUMN,
    ENERGIES,
    IMPACTS,
)
from gear_dynamics_ros.chunk import (
    Chunk,
    Commands,
    Counters,
    Status,
)
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import (
    OperationParameters,
    ParameterChange,
    Parameters,
    specifications,
)
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.physics.constants import (
    aligned_zeros,
    excitation_table,
    hunting_turns,
    kernel_constants,
)
from gear_dynamics_ros.physics.kernel import entry
from gear_dynamics_ros.physics.kernel.records import CALL, POINT, STATE
from gear_dynamics_ros.physics.kernel.substeps import IMPACTS_PER_STEP
from gear_dynamics_ros.simulation.checkpoint import Checkpoint, require_running
from gear_dynamics_ros.simulation.start_state import end_reason, start_commands, start_state

IMPACTS_A_CALL = 256


class Engine:
    """One gearbox, advanced chunk by chunk. The bits do not depend on the length of the chunks."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self._excitations = excitation_table(parameters)
        self._constants = kernel_constants(parameters, self._excitations)
        self._interval_ns = parameters.solver.sample_interval_ns
        last_column = max(COLUMN[name] for name in parameters.waveform_channels)
        self._columns = len(CHANNELS) if last_column < len(CHANNELS) else len(COLUMN)
        impacts_per_sample = IMPACTS_PER_STEP * parameters.solver.steps_per_sample
        self._impacts = np.empty((impacts_per_sample + IMPACTS_A_CALL, len(IMPACTS)))
        self.sample = 0
        self.reset()

    def reset(self) -> None:
        """Return to the start state and to the commands of the parameters; simulated time continues."""
        self.status = Status.RUNNING
        self._points, self._call = aligned_zeros((3,), POINT), aligned_zeros((1,), CALL)
        self._state = start_state(self.parameters, self._constants, self._points, self._excitations)
        self.commands = start_commands(self.parameters)

    def command(self, commands: Commands) -> None:
        """Put ``commands`` in force from the next sample on."""
        # -0.0 equals 0.0 and counts as no change, so it must not change any bits either.
        self.commands = commands = Commands(*(value + 0.0 for value in commands))
        self._state["speed"], self._state["load_torque"] = commands.speed, commands.load_torque
        if not self._constants["governed"]:
            self._state["drive_torque"] = commands.drive_torque

    def change(self, change: ParameterChange) -> None:
        """Put the parameters ``change.new`` in force from the next sample on.

        Drive torque, load torque and speed become commands where they differ from ``change.old``; the other
        commands stay in force. The drive torque does not jump when the governor is switched on or off.
        Raises GearboxError, and changes nothing, if ``change.old`` is no longer in force because something
        else changed the parameters meanwhile.
        """
        old, new = change.old, change.new
        if old is not self.parameters:
            raise GearboxError("the parameters were changed meanwhile by something else: set them again")
        excitations = excitation_table(new)
        constants = kernel_constants(new, excitations)
        stored = entry.evaluate_before_change(self._constants, self._state, self._points, *self._excitations)
        self.parameters, self._constants, self._excitations = new, constants, excitations
        self._hand_over(old.operation, new.operation)
        entry.adapt_to_change(
            constants, self._state, self._points, *excitations, self._call, self._impacts, stored
        )

    def _hand_over(self, old: OperationParameters, new: OperationParameters) -> None:
        torque = float(self._state["drive_torque"][0])
        commands = self.commands
        if (old.control, new.control) == ("speed", "torque"):
            commands = commands._replace(drive_torque=torque)
        given = {name: getattr(new, name) for name in Commands._fields}
        self.command(
            commands._replace(**{name: to for name, to in given.items() if to != getattr(old, name)})
        )
        if new.control == "speed" and (old.control, old.governor) != (new.control, new.governor):
            limit = new.governor.torque_limit
            error = self.commands.speed - float(self._state["omega"][0, 0])
            self._state["governor"] = min(max(torque, -limit), limit) - new.governor.proportional * error

    def advance(self, samples: int | None = None) -> Chunk:
        """Compute the next ``samples`` samples (default: one chunk); fewer if the run ends before.

        Raises GearboxError if the run had ended already.
        """
        if self.status is not Status.RUNNING:
            raise GearboxError(f"the run has ended ({self._reason()}); reset it to continue")
        count = self.parameters.solver.samples_per_chunk if samples is None else samples
        rows = np.empty((count, self._columns))
        angles = np.empty((count, 2))
        energies = np.empty((1, len(ENERGIES)))
        impacts = []
        first, written = self.sample, 0
        # A call returns early, after a whole sample, if its list of impacts could overflow in the next one.
        while True:
            done, status = entry.integrate(
                self._constants,
                self._state,
                self._points,
                *self._excitations,
                first + written,
                self._interval_ns,
                rows[written:],
                angles[written:],
                energies,
                self._call,
                self._impacts,
            )
            impacts.append(self._impacts[: self._call["listed"][0]].copy())
            written += done
            if written == count or status != Status.RUNNING:
                break
        self.sample = first + written
        self.status = Status(status)
        return Chunk(
            first_sample=first,
            interval_ns=self._interval_ns,
            samples=rows[:written],
            angles=angles[:written],
            energies=energies[0],
            impacts=np.concatenate(impacts),
            commands=self.commands,
            counters=self.counters,
            status=self.status,
            message=self._reason(),
        )

    @property
    def counters(self) -> Counters:
        """Totals since the start or the last reset."""
        return Counters(*self._state[_COUNTERS].item())

    @property
    def mesh_loss(self) -> float:
        """Energy lost in the mesh since the start or the last reset, J, as of the last call."""
        return float(self._state["mesh_loss"][0])

    def checkpoint(self) -> Checkpoint:
        """Everything that decides how the run continues, taken before the next sample."""
        return Checkpoint(
            sample=self.sample,
            status=self.status,
            commands=self.commands,
            state={name: self._state[name][0].tolist() for name in _STATE_NAMES},
            parameters=self.parameters,
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Set state and simulated time from ``checkpoint``; its parameters must be in force already.

        Raises GearboxError, and changes nothing, if the state of ``checkpoint`` is invalid.
        """
        self._state = _kernel_state(checkpoint)
        self.sample, self.status, self.commands = checkpoint.sample, checkpoint.status, checkpoint.commands

    def resume(self, checkpoint: Checkpoint) -> None:
        """Set the state alone from ``checkpoint``: simulated time continues, the parameters in force stay.

        The results are those after ``restore``, at other times. Raises GearboxError, and changes nothing, if
        the state of ``checkpoint`` is invalid or its run had ended.
        """
        require_resumable(checkpoint)
        state = _kernel_state(checkpoint)
        state["impact_time"] += (self.sample - checkpoint.sample) * self._interval_ns / 1e9
        self._state, self.status, self.commands = state, checkpoint.status, checkpoint.commands

    def _reason(self) -> str:
        time = self.sample * self._interval_ns * 1e-9
        return end_reason(self.status, self._state, self.parameters, time)


def require_resumable(checkpoint: Checkpoint) -> None:
    """Raise GearboxError where ``Engine.resume`` would."""
    require_running(checkpoint)
    _require_possible(checkpoint, _kernel_state(checkpoint))


_STATE_NAMES = STATE.names or ()
_COUNTERS = list(Counters._fields)
# What some entries of the state may be; the others may be any finite number.
_FLAGS = ("mesh_clamped", "contact", "clamped", "film_limited", "pressed")
_NOT_NEGATIVE = (
    "drive_time",
    "back_time",
    "contact_age",
    "peak_force2",
    "steps",
    "events",
    "capped",
    "impacts",
    "flank_changes",
)
_COMMANDED = ("speed", "load_torque")


def _kernel_state(checkpoint: Checkpoint) -> NDArray[Any]:
    """Array (1,) of STATE. Raises GearboxError if an entry is missing or has the wrong type or shape."""
    state = aligned_zeros((1,), STATE)
    try:
        for name in _STATE_NAMES:
            state[name] = _entry(name, checkpoint.state[name])
    except (KeyError, TypeError, ValueError) as error:
        raise GearboxError(f"an entry of the checkpoint is missing or invalid: {error!r}") from error
    return state


def _entry(name: str, value: Any) -> Any:
    """``value`` of the entry ``name`` of the state: a number or two. Raises TypeError or ValueError."""
    whole = STATE[name].base.kind == "i"
    count = sum(STATE[name].shape)
    numbers = value if count and isinstance(value, list) else [value]
    if len(numbers) != max(count, 1) or (count and numbers is not value):
        raise ValueError(f"{name} = {value!r:.40} must have {max(count, 1)} numbers")
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int if whole else int | float):
            raise TypeError(f"{name} = {number!r:.40} is not a {'whole ' if whole else ''}number")
        if isinstance(number, int) and not -(2**63) <= number < 2**63:
            raise ValueError(f"{name} = {number!r:.40} is too large")
    return value


def _require_possible(checkpoint: Checkpoint, state: NDArray[Any]) -> None:
    """Raise GearboxError if a run can't have had this ``state``, the commands or the index of the sample."""
    hunting = hunting_turns(checkpoint.parameters)
    allowed: dict[str, Callable[[NDArray[Any]], Any]] = {
        **dict.fromkeys(_FLAGS, lambda value: np.isin(value, (0, 1))),
        **dict.fromkeys(_NOT_NEGATIVE, lambda value: value >= 0),
        "flank": lambda value: np.isin(value, (-1, 0, 1)),
        "impact_speed": lambda value: value > 0.0,
        "nominal_turn": lambda value: (value >= 0.0) & (value <= 1.0),
        "whole_turns": lambda value: (value >= 0) & (value < hunting),
        **{name: partial(np.equal, getattr(checkpoint.commands, name)) for name in _COMMANDED},
    }
    for name in _STATE_NAMES:
        value = state[name][0]
        if not (np.isfinite(value).all() and np.all(allowed.get(name, np.isfinite)(value))):
            raise GearboxError(
                f"the checkpoint has {name} = {value.tolist()!r}, which no run has: it was changed, or is "
                "damaged: take another one"
            )
    for name, command in checkpoint.commands._asdict().items():
        row = specifications()[f"operation.{name}"]
        if not (row.minimum or 0.0) <= command <= (row.maximum or 0.0):  # false for NaN
            raise GearboxError(
                f"the checkpoint has the command {name} = {exact_text(command)}: it must be {row.limits} "
                f"{row.unit}: take another one"
            )
