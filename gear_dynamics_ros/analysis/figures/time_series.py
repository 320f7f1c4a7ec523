"""The last mesh periods of a window, sample by sample."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import KILO, MICRO, styled
from gear_dynamics_ros.analysis.summary import observed_mesh_frequency
from gear_dynamics_ros.channels import GEARS, contact_channels, film_channels
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii

SERIES_PERIODS: Final = 12  # mesh periods shown
SERIES_MIN_SAMPLES: Final = 60
SERIES_SAMPLES: Final = 500  # where the mesh frequency isn't known
DOTTED_SAMPLES: Final = 400  # up to this number every sample gets a dot


@styled
def time_series_figure(samples: Samples, parameters: Parameters) -> Figure:
    """The last mesh periods of a window, sample by sample: DTE and flanks, mesh force, bearing forces.

    What wasn't recorded is left out.
    """
    shown = last_periods(samples)
    milliseconds = 1e3 * (shown.time - shown.time[0])
    dots = sample_dots(shown)
    figure = Figure(figsize=(10.0, 7.6), layout="constrained")
    motion, force, *bearings = figure.subplots(4, 1, sharex=True)
    if shown.has("dte"):
        motion.plot(milliseconds, MICRO * shown["dte"], color=palette.BLUE, label="DTE", **dots)
    if shown.has("half_backlash"):
        half = MICRO * shown["half_backlash"]
        motion.plot(
            milliseconds, half, color=palette.GREY, linewidth=0.9, linestyle="--", label="drive flank"
        )
        if shown.has("dte") and MICRO * shown["dte"].min() < 0.0:
            motion.plot(
                milliseconds, -half, color=palette.GREY, linewidth=0.9, linestyle=":", label="back flank"
            )
    if shown.has("mesh_force"):
        force.plot(milliseconds, KILO * shown["mesh_force"], color=palette.BLUE, label="mesh force", **dots)
        _mark_static_force(force, samples, parameters)
    motion.set_ylabel("DTE (µm)")
    force.set_ylabel("mesh force (kN)")
    for axis, gear in zip(bearings, GEARS, strict=True):
        if shown.has(*contact_channels(gear)):
            axis.plot(
                milliseconds, KILO * shown.contact_force(gear), color=palette.BLUE, label="contact", **dots
            )
        if parameters.model == "improved" and shown.has(*film_channels(gear)):
            axis.plot(
                milliseconds,
                KILO * shown.film_force(gear),
                color=palette.ORANGE,
                linestyle="--",
                label="oil film",
                **dots,
            )
        axis.set_ylabel(f"{gear} bearing\nforce (kN)")
    for axis in (motion, force, *bearings):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.4)
    bearings[-1].set_xlabel(f"time after {shown.time[0]:.6f} s (ms)")
    motion.set_title(periods_title(shown))
    motion.margins(x=0.01)
    figure.align_ylabels()
    return figure


def _mark_static_force(axis: Axes, samples: Samples, parameters: Parameters) -> None:
    """Mark the mesh force that carries the mean load, and what multiple of it the window reaches."""
    if not samples.has("load_torque"):
        return
    static = float(np.abs(samples["load_torque"]).mean()) / base_radii(parameters)[1]
    if static > 0.0:
        factor = float(samples["mesh_force"].max()) / static
        label = f"static force\n(load factor LDMF\nof the window {factor:.2f})"
        axis.axhline(KILO * static, color=palette.GREY, linewidth=1.0, linestyle="--", label=label)


def sample_dots(shown: Samples) -> dict[str, Any]:
    """Style of a curve of ``shown``: each sample a dot, if they are few."""
    return {"marker": "." if len(shown) <= DOTTED_SAMPLES else "", "markersize": 3.0}


def last_periods(samples: Samples) -> Samples:
    """The last SERIES_PERIODS mesh periods of ``samples``."""
    mesh = observed_mesh_frequency(samples)
    if mesh is None:
        return samples.last(SERIES_SAMPLES)
    return samples.last(max(SERIES_MIN_SAMPLES, round(SERIES_PERIODS / (abs(mesh) * samples.interval))))


def periods_title(shown: Samples) -> str:
    """Title of a figure of the ``last_periods`` of a window."""
    mesh = observed_mesh_frequency(shown)
    if mesh is None:
        return f"Last {len(shown)} samples of the window"
    periods = abs(mesh) * len(shown) * shown.interval
    return f"Last {periods:.0f} mesh periods of the window (mesh frequency {KILO * abs(mesh):.3f} kHz)"


@styled
def pressure_angle_figure(samples: Samples, parameters: Parameters) -> Figure:
    """Working pressure angle of the last mesh periods, and the angle of the line of centres if recorded.

    Needs the channel pressure_angle.
    """
    shown = last_periods(samples)
    milliseconds = 1e3 * (shown.time - shown.time[0])
    names = [name for name in ("pressure_angle", "position_angle") if samples.has(name)]
    figure = Figure(figsize=(10.0, 1.0 + 2.1 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    nominal = {"pressure_angle": parameters.gears.pressure_angle, "position_angle": 0.0}
    labels = {
        "pressure_angle": "pressure angle\n(°)",
        "position_angle": "angle of the line\nof centres (°)",
    }
    for axis, name in zip(axes, names, strict=True):
        window = np.degrees(samples[name])
        axis.axhspan(
            window.min(),
            window.max(),
            color=palette.SKY,
            alpha=0.25,
            linewidth=0,
            label="range in the window",
        )
        axis.plot(
            milliseconds, np.degrees(shown[name]), color=palette.BLUE, label="dynamic", **sample_dots(shown)
        )
        axis.axhline(
            np.degrees(nominal[name]), color=palette.GREY, linewidth=1.0, linestyle="--", label="nominal"
        )
        axis.set_ylabel(labels[name])
        axis.ticklabel_format(useOffset=False)
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.4)
    axes[0].set_title(periods_title(shown))
    axes[0].margins(x=0.01)
    axes[-1].set_xlabel(f"time after {shown.time[0]:.6f} s (ms)")
    figure.align_ylabels(axes)
    return figure
