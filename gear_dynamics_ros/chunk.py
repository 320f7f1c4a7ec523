"""The contract between the engine and everything that consumes it: channels, commands, chunks.

SI units throughout; forces are those on the gear; simulated time is an integer of nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Channel(NamedTuple):
    """One column of the waveform."""

    name: str
    unit: str
    meaning: str


CHANNELS: tuple[Channel, ...] = (
    Channel("time", "s", "simulated time"),
    Channel("dte", "m", "dynamic transmission error q, static error subtracted"),
    Channel("dte_rate", "m/s", "full derivative of q"),
    Channel("mesh_force", "N", "F_p along the line of action, negative on the back flank"),
    Channel("pressure_angle", "rad", "working pressure angle alpha"),
    Channel("position_angle", "rad", "angle beta of the line of centres"),
    Channel("half_backlash", "m", "b_1: half the backlash left by centre shift and surfaces"),
    Channel("meshing_state", "", "1 drive flank, 0 apart, -1 back flank"),
    Channel("driving_x", "m", "displacement of the driving gear's centre along x"),
    Channel("driving_y", "m", "displacement of the driving gear's centre along y"),
    Channel("driven_x", "m", "displacement of the driven gear's centre along x"),
    Channel("driven_y", "m", "displacement of the driven gear's centre along y"),
    Channel("driving_contact_force_x", "N", "bearing contact force on the driving gear"),
    Channel("driving_contact_force_y", "N", "bearing contact force on the driving gear"),
    Channel("driven_contact_force_x", "N", "bearing contact force on the driven gear"),
    Channel("driven_contact_force_y", "N", "bearing contact force on the driven gear"),
    Channel("driving_film_force_x", "N", "oil film force on the driving gear"),
    Channel("driving_film_force_y", "N", "oil film force on the driving gear"),
    Channel("driven_film_force_x", "N", "oil film force on the driven gear"),
    Channel("driven_film_force_y", "N", "oil film force on the driven gear"),
    Channel("driving_penetration", "m", "bearing penetration, negative = gap left"),
    Channel("driven_penetration", "m", "bearing penetration, negative = gap left"),
    Channel("driving_speed", "rad/s", "omega_1, positive in normal running"),
    Channel("driven_speed", "rad/s", "omega_2, positive in normal running"),
    Channel("drive_torque", "N m", "torque T_M applied to the driving shaft"),
    Channel("load_torque", "N m", "torque T_L applied to the driven shaft, positive resists"),
    Channel("driving_angle", "rad", "theta_1 within one revolution, 0 to 2 pi"),
    Channel("mesh_phase", "rad", "mesh phase phi within one tooth, 0 to 2 pi"),
)
# On request, after the others: works and losses since the start or the last reset, and what is stored now.
ENERGIES: tuple[Channel, ...] = (
    Channel("shaft_work", "J", "work of the drive torque less that of the load torque"),
    Channel(
        "excitation_work",
        "J",
        "work of stiffness, static error and surfaces moving with the phase, or changed by a parameter",
    ),
    Channel("mesh_loss", "J", "dissipated by the teeth's damping"),
    Channel("driving_contact_loss", "J", "dissipated by the bearing contact"),
    Channel("driven_contact_loss", "J", "dissipated by the bearing contact"),
    Channel("driving_film_work", "J", "put into the shaft by the oil film, negative where it damps"),
    Channel("driven_film_work", "J", "put into the shaft by the oil film, negative where it damps"),
    Channel("kinetic_energy", "J", "of both gears, their rotation included"),
    Channel("elastic_energy", "J", "in teeth and bearing contacts"),
)
# One row a bearing contact that ended.
IMPACTS: tuple[Channel, ...] = (
    Channel("begin", "s", "simulated time at which the gap closed"),
    Channel("end", "s", "simulated time at which it opened again"),
    Channel("bearing", "", "0 driving, 1 driven"),
    Channel("impact_speed", "m/s", "closing speed when it closed"),
    Channel("rebound_speed", "m/s", "opening speed when it opened"),
    Channel("peak_force", "N", "greatest contact force between"),
)
# One row a report of the pacing.
PACE: tuple[Channel, ...] = (
    Channel("time", "s", "simulated time"),
    Channel("real_time_factor", "", "reached since the last report"),
    Channel("real_time_factor_wanted", "", "pacing.real_time_factor; 0 is as fast as possible"),
    Channel("overruns", "", "chunks that were not done when the next was due, of all time"),
    Channel("worst_lateness", "s", "latest begin of a chunk after it was due, since the last report"),
    Channel("slipped", "s", "wall time by which deadlines were put off, of all time"),
)
# Kinds of events.
START = "start"
RESET = "reset"
PAUSE = "pause"
RESUME = "resume"
CHANGE = "parameters"
RESTORE = "restore"
END = "end"
# All kinds of events.
EVENTS = frozenset({START, RESET, PAUSE, RESUME, CHANGE, RESTORE, END})
CHANNEL_NAMES: tuple[str, ...] = tuple(channel.name for channel in CHANNELS)
COLUMN: dict[str, int] = {channel.name: i for i, channel in enumerate((*CHANNELS, *ENERGIES))}


class Status(IntEnum):
    """How an engine call ended; all but RUNNING end the run."""

    RUNNING = 0
    OVER_SPEED = 1
    NON_FINITE = 2
    CENTRES_PRESSED = 3


class Commands(NamedTuple):
    """Commands in force."""

    drive_torque: float  # N m, T_M under control: torque
    load_torque: float  # N m, T_L > 0 resists
    speed: float  # rad/s, set-point of the governor or nominal speed


class Counters(NamedTuple):
    """Totals since the start of the run."""

    steps: int
    events: int  # contact and clamp events located
    capped: int  # root searches or steps that met their limit of iterations or events
    impacts: int  # bearing contacts begun
    flank_changes: int  # mesh contacts begun or ended


@dataclass(frozen=True, slots=True)
class Chunk:
    """The samples of one engine call, [t0, t0 + T).

    ``samples`` has shape (n, 28), one column a CHANNELS entry, or (n, 37) with ENERGIES after them where the
    parameters ask for one; C-contiguous and never written to again. ``energies`` (9,) are ENERGIES after the
    last sample's steps; ``impacts`` (k, 6) has a row of IMPACTS for each bearing contact that ended.
    ``angles`` has shape (n, 2): shaft angles of driving and driven gear in rad, accumulated over all
    revolutions since the start or the last reset. ``status`` other than RUNNING means the run ended at the
    last sample; ``message`` then says why.
    """

    first_sample: int
    interval_ns: int
    samples: NDArray[np.float64]
    angles: NDArray[np.float64]
    energies: NDArray[np.float64]
    impacts: NDArray[np.float64]
    commands: Commands
    counters: Counters
    status: Status
    message: str

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, channel: str) -> NDArray[np.float64]:
        """Column of one channel, shape (n,)."""
        return self.samples[:, COLUMN[channel]]

    @property
    def start_ns(self) -> int:
        """Simulated time of the first sample."""
        return self.first_sample * self.interval_ns

    @property
    def last_ns(self) -> int:
        """Simulated time of the last sample."""
        return (self.first_sample + len(self) - 1) * self.interval_ns
