"""The whole run in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import GEAR_COLOURS, KILO, MICRO, styled
from gear_dynamics_ros.analysis.statistics import Envelope, bearing_force_name
from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.chunk import Samples

DRAWN_INTERVALS: Final = 500  # three pixels each
MAX_CHANGE_LINES: Final = 40  # changes marked by a line each; above that, by ticks


class OverviewCurve(NamedTuple):
    """One quantity in a panel of the overview."""

    name: str
    label: str
    colour: str


class OverviewPanel(NamedTuple):
    """One panel of the overview: ``scale`` turns SI units into those of ``axis_label``."""

    axis_label: str
    scale: float
    curves: tuple[OverviewCurve, ...]


OVERVIEW_PANELS: Final = (
    OverviewPanel(
        "speed\n(rad/s)",
        1.0,
        (
            OverviewCurve("driving_speed", "driving", palette.BLUE),
            OverviewCurve("driven_speed", "driven", palette.ORANGE),
        ),
    ),
    OverviewPanel(
        "torque\n(N m)",
        1.0,
        (
            OverviewCurve("drive_torque", "drive", palette.BLUE),
            OverviewCurve("load_torque", "load", palette.ORANGE),
        ),
    ),
    OverviewPanel("DTE\n(µm)", MICRO, (OverviewCurve("dte", "", palette.BLUE),)),
    OverviewPanel("mesh force\n(kN)", KILO, (OverviewCurve("mesh_force", "", palette.BLUE),)),
    OverviewPanel(
        "bearing force\n(kN)",
        KILO,
        tuple(OverviewCurve(bearing_force_name(gear), gear, GEAR_COLOURS[gear]) for gear in GEARS),
    ),
    OverviewPanel(
        "penetration\n(µm)",
        MICRO,
        tuple(OverviewCurve(f"{gear}_penetration", gear, GEAR_COLOURS[gear]) for gear in GEARS),
    ),
)


@styled
def overview_figure(
    envelope: Envelope, changes: Sequence[float], windows: Sequence[tuple[float, float]]
) -> Figure:
    """The whole run: minimum and maximum of each quantity over time.

    Marked are ``changes``, the times of commands and events in s, and ``windows``, the start and end in
    s of what the other figures show.
    """
    panels = shown_panels(envelope)
    figure = Figure(figsize=(10.0, 1.0 + 1.45 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    times, starts = _joined_times(envelope)
    for axis, panel in zip(axes, panels, strict=True):
        for number, curve in enumerate(panel.curves):
            lows, highs = envelope.bounds(curve.name)
            low, high = np.minimum.reduceat(lows, starts), np.maximum.reduceat(highs, starts)
            # Only the first is filled: two fills over each other would hide both.
            fill = {"facecolor": (curve.colour, 0.0 if number else 0.35)}
            axis.fill_between(
                times,
                panel.scale * low,
                panel.scale * high,
                **fill,
                edgecolor=curve.colour,
                linewidth=0.7,
                label=curve.label,
            )
        if len(changes) <= MAX_CHANGE_LINES or axis is axes[0]:
            mark_changes(axis, changes)
        for window in windows:
            axis.axvspan(*window, facecolor=(palette.GREEN, 0.13), edgecolor="black", linewidth=0.6)
        axis.set_ylabel(panel.axis_label)
        axis.margins(x=0.01)
        if len(panel.curves) > 1:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.2)
    axes[-1].set_xlabel("simulated time (s)")
    number_windows(axes[0], windows)
    axes[0].set_title(_overview_title(len(changes), len(windows)))
    figure.align_ylabels(axes)
    return figure


def _joined_times(envelope: Envelope) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Mean times of at most DRAWN_INTERVALS groups of neighbouring intervals, and where the groups start."""
    times = envelope.times()
    starts = np.arange(0, len(times), -(-len(times) // DRAWN_INTERVALS))
    counts = np.diff(np.append(starts, len(times)))
    return np.add.reduceat(times, starts) / counts, starts


def shown_panels(envelope: Envelope) -> list[OverviewPanel]:
    """OVERVIEW_PANELS with what was recorded."""
    present = set(envelope.names)
    kept = (
        panel._replace(curves=tuple(c for c in panel.curves if c.name in present))
        for panel in OVERVIEW_PANELS
    )
    return [panel for panel in kept if panel.curves]


def mark_changes(axis: Axes, changes: Sequence[float]) -> None:
    """Mark the times of commands and events in s, by lines or, if they are many, by ticks."""
    if len(changes) <= MAX_CHANGE_LINES:
        for time in changes:
            axis.axvline(time, color=palette.GREY, linewidth=0.8, linestyle=(0, (3, 3)))
    else:
        axis.plot(
            changes,
            np.ones(len(changes)),
            "|",
            color=palette.GREY,
            markersize=5,
            transform=axis.get_xaxis_transform(),
            clip_on=False,
            rasterized=True,
        )


def number_windows(axis: Axes, windows: Sequence[tuple[float, float]]) -> None:
    """Write their numbers, from 1, at the right end of the ``windows``, each a start and an end in s."""
    for number, (_, end) in enumerate(windows, start=1):
        if len(windows) > 1:
            axis.annotate(
                str(number),
                (end, 0.03),
                xycoords=axis.get_xaxis_transform(),
                xytext=(-2, 0),
                textcoords="offset points",
                ha="right",
                va="bottom",
                fontsize=8.5,
                fontweight="bold",
                bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            )


def ends_of(samples: Samples) -> tuple[float, float]:
    """Times of the first and of the last sample, s."""
    return float(samples.time[0]), float(samples.time[-1])


def _overview_title(changes: int, windows: int) -> str:
    marks = "grey: commands and events, " if changes else ""
    plural = "s" if windows > 1 else ""
    return f"Whole run ({marks}green: window{plural} of the other figures)"
