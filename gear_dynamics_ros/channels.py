"""The table of channels: what each column of numbers is called, its unit and meaning.

SI units throughout; forces are those on the gear.
"""

from __future__ import annotations

from typing import Final, NamedTuple


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
CHANNEL_NAMES: tuple[str, ...] = tuple(channel.name for channel in CHANNELS)
COLUMN: dict[str, int] = {channel.name: i for i, channel in enumerate((*CHANNELS, *ENERGIES))}
GEARS: Final = ("driving", "driven")


def contact_channels(gear: str) -> tuple[str, str]:
    """Channels of the bearing contact force on one gear."""
    return f"{gear}_contact_force_x", f"{gear}_contact_force_y"


def film_channels(gear: str) -> tuple[str, str]:
    """Channels of the oil film force on one gear."""
    return f"{gear}_film_force_x", f"{gear}_film_force_y"
