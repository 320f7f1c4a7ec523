"""The curves over time: entity, label, colour, and how their values follow from samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.channels import CHANNELS, COLUMN, ENERGIES, GEARS
from gear_dynamics_ros.viewer.entities import (
    COMMAND,
    ENERGY,
    IMPACT,
    REAL_TIME_FACTOR,
    channel_entity,
)

Values = NDArray[np.float64]

# Units in the viewer of the channels' units, and what to multiply by.
DISPLAY_UNITS: Final = {"m": ("µm", 1.0e6), "rad": ("°", 180.0 / np.pi)}
CHANNEL_UNITS: Final = {channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)}
# As ``analysis.statistics`` names the magnitude of contact and film force together.
FORCE_KINDS: Final = ("contact_force", "film_force", "bearing_force")
FORCE_COLOURS: Final = {
    "driving": dict(zip(FORCE_KINDS, (palette.ORANGE, palette.GREEN, palette.SKY), strict=True)),
    "driven": dict(zip(FORCE_KINDS, (palette.ORANGE, palette.GREEN, palette.YELLOW), strict=True)),
}
ENERGY_RESIDUAL: Final = f"{ENERGY}/residual"


class CurveStyle(NamedTuple):
    """How one curve is drawn."""

    entity: str
    label: str
    colour: str
    width: float = 1.2


class SampleCurve(NamedTuple):
    """A curve of samples: its style, and what computes its values (n,) from samples (n, 28)."""

    style: CurveStyle
    values: Callable[[Values], Values]


def shown_unit(channel: str) -> tuple[str, float]:
    """Unit in which a channel is shown, and the factor to it from the channel's own."""
    unit = CHANNEL_UNITS[channel]
    return DISPLAY_UNITS.get(unit, (unit, 1.0))


def label_of(name: str, unit: str) -> str:
    """Name and unit of a curve in legends."""
    return f"{name} ({unit})" if unit else name


def channel_curve(channel: str, colour: str, width: float = 1.2) -> SampleCurve:
    """The curve of one channel in its display unit."""
    unit, factor = shown_unit(channel)
    column = COLUMN[channel]
    style = CurveStyle(channel_entity(channel), label_of(channel, unit), colour, width)
    return SampleCurve(style, lambda rows: rows[:, column] * factor)


def force_curve(gear: str, kind: str) -> SampleCurve:
    """The curve of the magnitude of a force on a bearing; ``kind`` is one of FORCE_KINDS."""
    parts = ("contact_force", "film_force") if kind == "bearing_force" else (kind,)
    columns = [[COLUMN[f"{gear}_{part}_{axis}"] for part in parts] for axis in ("x", "y")]
    name = f"{gear}_{kind}"
    style = CurveStyle(channel_entity(name), label_of(name, "N"), FORCE_COLOURS[gear][kind])
    return SampleCurve(style, lambda rows: _magnitude(rows, columns))


def sample_curves() -> list[SampleCurve]:
    """All curves of samples."""
    unit, factor = shown_unit("half_backlash")
    half = COLUMN["half_backlash"]
    below = CurveStyle(
        channel_entity("minus_half_backlash"), label_of("-half_backlash", unit), palette.ORANGE, 1.5
    )
    return [
        channel_curve("dte", palette.SKY),
        channel_curve("half_backlash", palette.YELLOW, 1.5),
        SampleCurve(below, lambda rows: rows[:, half] * -factor),
        channel_curve("mesh_force", palette.PURPLE),
        channel_curve("pressure_angle", palette.GREEN),
        channel_curve("driving_speed", palette.SKY),
        channel_curve("driven_speed", palette.ORANGE),
        channel_curve("drive_torque", palette.SKY),
        channel_curve("load_torque", palette.ORANGE),
        *(force_curve(gear, kind) for gear in GEARS for kind in FORCE_KINDS),
        channel_curve("driving_penetration", palette.SKY),
        channel_curve("driven_penetration", palette.ORANGE),
    ]


COMMAND_STYLES: Final = {  # by field of Commands, in their order
    "drive_torque": CurveStyle(f"{COMMAND}/drive_torque", "drive_torque commanded (N m)", palette.BLUE, 2.5),
    "load_torque": CurveStyle(f"{COMMAND}/load_torque", "load_torque commanded (N m)", palette.YELLOW, 2.5),
    "speed": CurveStyle(f"{COMMAND}/speed", "speed commanded (rad/s)", palette.YELLOW, 2.5),
}
IMPACT_STYLES: Final = {
    gear: CurveStyle(f"{IMPACT}/{gear}", f"{gear} bearing, impact_speed (m/s)", colour)
    for gear, colour in zip(GEARS, (palette.SKY, palette.ORANGE), strict=True)
}
PACE_STYLE: Final = CurveStyle(REAL_TIME_FACTOR, "real_time_factor", palette.GREEN, 2.0)
ENERGY_STYLES: Final = {
    energy.name: CurveStyle(f"{ENERGY}/{energy.name}", label_of(energy.name, energy.unit), colour, 1.5)
    for energy, colour in zip(
        ENERGIES,
        (
            palette.SKY,
            palette.BLUE,
            palette.ORANGE,
            palette.YELLOW,
            palette.PURPLE,
            palette.GREEN,
            "#66C2A5",
            palette.GREY,
            "#D9D9D9",
        ),
        strict=True,
    )
}
RESIDUAL_STYLE: Final = CurveStyle(ENERGY_RESIDUAL, "residual: stored + lost - work (J)", "#FFFFFF", 2.0)


def _magnitude(rows: Values, columns: list[list[int]]) -> Values:
    x, y = (rows[:, first] if not rest else rows[:, first] + rows[:, rest[0]] for first, *rest in columns)
    # np.hypot, which can't overflow, takes several times as long.
    return np.asarray(np.sqrt(x * x + y * y))
