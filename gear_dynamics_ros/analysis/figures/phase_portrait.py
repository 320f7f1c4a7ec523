"""Phase portrait with Poincaré section."""

from __future__ import annotations

from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import MICRO, styled
from gear_dynamics_ros.analysis.summary import poincare_section
from gear_dynamics_ros.chunk import Samples

PORTRAIT_SAMPLES: Final = 20_000  # drawn of the motion


@styled
def phase_portrait_figure(samples: Samples) -> Figure:
    """DTE rate over DTE, with the points where the mesh phase wraps. Needs the channels dte and dte_rate."""
    figure = Figure(figsize=(7.4, 5.4), layout="constrained")
    axis = figure.subplots()
    shown = samples.last(PORTRAIT_SAMPLES)
    axis.plot(
        MICRO * shown["dte"],
        shown["dte_rate"],
        color=palette.SKY,
        linewidth=0.35,
        alpha=0.6,
        label="motion",
        rasterized=True,
    )
    if samples.has("mesh_phase"):
        points = poincare_section(samples)
        axis.plot(
            MICRO * points[:, 0],
            points[:, 1],
            "o",
            color=palette.ORANGE,
            markersize=2.6,
            markeredgecolor="black",
            markeredgewidth=0.3,
            rasterized=True,
            label=f"mesh phase 0 ({len(points)} points)",
        )
    if samples.has("half_backlash"):
        _mark_flanks(axis, samples)
    axis.set_xlabel("DTE (µm)")
    axis.set_ylabel("rate of DTE (m/s)")
    axis.set_title(
        f"Phase portrait of the last {len(shown) * samples.interval:.3g} s of the window, "
        f"Poincaré section of {len(samples) * samples.interval:.3g} s"
    )
    legend = axis.legend(loc="upper right", frameon=True, framealpha=0.85)
    for handle in legend.get_lines():
        handle.set_linewidth(1.2)
        handle.set_alpha(1.0)
        handle.set_markersize(4.5)
    return figure


def _mark_flanks(axis: Axes, samples: Samples) -> None:
    """Mark the mean positions of the flanks that the motion comes near."""
    half = float(samples["half_backlash"].mean())
    lowest, highest = float(samples["dte"].min()), float(samples["dte"].max())
    for place, name in ((half, "drive flank"), (-half, "back flank")):
        if lowest - 0.2 * half <= place <= highest + 0.2 * half:
            axis.axvline(MICRO * place, color=palette.GREY, linewidth=0.9, linestyle="--")
            axis.annotate(
                f"{name} (mean)",
                (MICRO * place, 0.02),
                xycoords=("data", "axes fraction"),
                xytext=(4, 0),
                textcoords="offset points",
                rotation=90,
                va="bottom",
                color="#666666",
                fontsize=8,
            )
