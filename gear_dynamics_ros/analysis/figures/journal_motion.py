"""Journals in their bearings: orbits, and contact force over penetration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.contact_loops import loss_per_period
from gear_dynamics_ros.analysis.figures.style import GEAR_COLOURS, KILO, MICRO, styled
from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import Parameters

MIN_HALF_SIDE: Final = 1.5  # of a close view of an orbit, um
ORBIT_SAMPLES: Final = 20_000  # drawn of orbits
LOOP_SAMPLES: Final = 5_000  # drawn of force over penetration


@styled
def orbits_figure(samples: Samples, parameters: Parameters) -> Figure:
    """Path of each journal's centre in its clearance circle, and in the oil clearance where a film acts.

    Needs the displacements of both gears.
    """
    figure = Figure(figsize=(10.0, 10.4), layout="constrained")
    axes = figure.subplots(2, 2)
    shown = samples.last(ORBIT_SAMPLES)
    sizes = {"driving": parameters.bearings.driving, "driven": parameters.bearings.driven}
    for (bearing, close), gear in zip(axes.T, GEARS, strict=True):
        path = MICRO * np.column_stack([shown[f"{gear}_x"], shown[f"{gear}_y"]])
        circles = [ClearanceCircle(MICRO * sizes[gear].clearance, palette.ORANGE, "-", "bearing clearance")]
        if parameters.model == "improved":
            circles.append(
                ClearanceCircle(MICRO * sizes[gear].oil_clearance, palette.GREEN, "--", "oil clearance")
            )
        half = 1.08 * max(*(circle.radius for circle in circles), float(np.abs(path).max()))
        _draw_orbit(bearing, path, circles, (0.0, 0.0), half)
        _draw_orbit(close, path, circles, *_close_view(path))
        bearing.set_title(
            f"Journal of the {gear} gear, last {len(shown) * shown.interval:.3g} s of the window"
        )
        close.set_title("The same, enlarged")
        bearing.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=2)
    return figure


class ClearanceCircle(NamedTuple):
    """A circle about the bearing's centre, radius in um."""

    radius: float
    colour: str
    line: str
    name: str

    def patch(self) -> Circle:
        """The circle to draw."""
        label = f"{self.name}, {self.radius:g} µm"
        return Circle(
            (0.0, 0.0),
            self.radius,
            fill=False,
            edgecolor=self.colour,
            linewidth=1.3,
            linestyle=self.line,
            zorder=3.0,
            label=label,
        )


def _draw_orbit(
    axis: Axes,
    path: NDArray[np.float64],
    circles: Sequence[ClearanceCircle],
    centre: tuple[float, float],
    half: float,
) -> None:
    """Draw the path (n, 2) in a square view of half side ``half`` about ``centre``, all in um."""
    for circle in circles:
        axis.add_patch(circle.patch())
    axis.plot(
        path[:, 0],
        path[:, 1],
        color=palette.BLUE,
        linewidth=0.6,
        alpha=0.8,
        label="journal centre",
        rasterized=True,
    )
    axis.set(
        xlim=(centre[0] - half, centre[0] + half),
        ylim=(centre[1] - half, centre[1] + half),
        aspect="equal",
        xlabel="x (µm)",
        ylabel="y (µm)",
    )


def _close_view(path: NDArray[np.float64]) -> tuple[tuple[float, float], float]:
    """Centre and half side of a square around the path with some margin, um."""
    low, high = path.min(axis=0), path.max(axis=0)
    x, y = (float(value) for value in (low + high) / 2.0)
    return (x, y), max(MIN_HALF_SIDE, 0.65 * float((high - low).max()))


@styled
def bearing_force_figure(samples: Samples) -> Figure:
    """Contact force over penetration of each bearing: the area of a loop is the energy dissipated.

    Needs penetration and contact force of both gears.
    """
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    shown = samples.last(LOOP_SAMPLES)
    for axis, gear in zip(axes, GEARS, strict=True):
        penetration = shown[f"{gear}_penetration"]
        touching = np.where(penetration >= 0.0, MICRO * penetration, np.nan)
        axis.plot(
            touching,
            KILO * shown.contact_force(gear),
            color=GEAR_COLOURS[gear],
            linewidth=0.6,
            alpha=0.8,
            rasterized=True,
        )
        _mark_greatest(axis, samples, gear)
        if np.isnan(touching).all():
            axis.text(0.5, 0.5, "no contact", transform=axis.transAxes, ha="center", color="#666666")
        axis.set_xlabel("penetration (µm)")
        axis.set_title(_loop_title(shown, samples, gear))
    axes[0].set_ylabel("bearing contact force (kN)")
    return figure


def _mark_greatest(axis: Axes, samples: Samples, gear: str) -> None:
    """Mark the greatest contact force of all ``samples``, which the loops drawn may not reach."""
    force = samples.contact_force(gear)
    peak = int(force.argmax())
    if force[peak] > 0.0:
        axis.plot(
            MICRO * samples[f"{gear}_penetration"][peak],
            KILO * force[peak],
            marker="D",
            markersize=5.0,
            color="black",
            fillstyle="none",
            linestyle="none",
            label=f"greatest of the window, {KILO * force[peak]:.3g} kN",
        )
        axis.legend(loc="upper left")


def _loop_title(shown: Samples, samples: Samples, gear: str) -> str:
    title = f"Bearing of the {gear} gear, last {len(shown) * shown.interval:.3g} s of the window"
    area = loss_per_period(samples, gear)
    if area is None:
        return title
    return f"{title}\nEnergy lost, area of the loops: {1e3 * area:.3g} mJ per mesh period"
