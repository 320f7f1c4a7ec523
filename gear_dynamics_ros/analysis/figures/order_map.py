"""Spectra of the DTE over speed with order lines and natural frequencies: a Campbell diagram."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.figures.style import KILO, MICRO, styled
from gear_dynamics_ros.analysis.run_up import SpeedSpectra
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.physics.modes import natural_frequencies

MAP_ORDERS: Final = 3.2  # mesh orders at the highest speed that the frequency axis shows
MAP_ROWS: Final = 400
MAP_RANGE: Final = 1e3  # of the amplitudes that colours tell apart
DRAWN_ORDERS: Final = (0.5, 1.0, 1.5, 2.0, 3.0)


@styled
def order_map_figure(spectra: SpeedSpectra, parameters: Parameters) -> Figure:
    """Amplitude of the DTE over speed and frequency, with mesh orders and the natural frequencies.

    Raises ValueError if ``spectra`` has no frame.
    """
    frequencies = spectra.frequencies()
    slowest, fastest = float(spectra.speed_edges[0]), float(spectra.speed_edges[-1])
    limit = min(MAP_ORDERS * spectra.mesh_per_speed * fastest, float(frequencies[-1]))
    shown = frequencies <= limit
    amplitudes = MICRO * _pooled(spectra.amplitudes()[:, shown], MAP_ROWS)
    figure = Figure(figsize=(10.0, 6.2), layout="constrained")
    axis = figure.subplots()
    top = float(amplitudes.max())
    image = axis.imshow(
        amplitudes.T,
        origin="lower",
        aspect="auto",
        extent=(slowest, fastest, 0.0, KILO * float(frequencies[shown][-1])),
        norm=LogNorm(top / MAP_RANGE, top, clip=True),
        cmap="cividis",
        interpolation="nearest",
    )
    axis.grid(visible=False)
    bar = figure.colorbar(image, ax=axis, pad=0.04, aspect=30)
    bar.set_label("amplitude of DTE (µm)")
    _draw_orders(axis, spectra, limit)
    _draw_natural_frequencies(axis, spectra, parameters, limit)
    axis.set_xlabel("speed of the driving gear (rad/s)")
    axis.set_ylabel("frequency (kHz)")
    kind = "run-up" if spectra.run_up.rises else "coast-down"
    span = spectra.run_up.span
    axis.set_title(
        f"Order map of the {kind} from {span.start:.3g} to {span.end:.3g} s "
        f"(Hann windows of {1e3 * spectra.frame * spectra.interval:.3g} ms)",
        pad=24.0,
    )
    return figure


def _pooled(amplitudes: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """``amplitudes`` (speeds, frequencies) with at most ``rows`` frequencies, each the greatest of some."""
    count = amplitudes.shape[1]
    if count <= rows:
        return amplitudes
    starts = np.linspace(0, count, rows, endpoint=False).astype(int)
    return np.asarray(np.maximum.reduceat(amplitudes, starts, axis=1), dtype=np.float64)


def _draw_orders(axis: Axes, spectra: SpeedSpectra, limit: float) -> None:
    """Rays of the mesh orders, labelled where they leave the map."""
    slowest, fastest = axis.get_xlim()
    for order in DRAWN_ORDERS:
        slope = order * spectra.mesh_per_speed
        if slope * slowest >= limit:
            continue
        end = min(fastest, limit / slope)
        axis.plot(
            [slowest, end],
            [KILO * slope * slowest, KILO * slope * end],
            color="white",
            linewidth=0.8,
            linestyle=(0, (6, 9)) if order == int(order) else (0, (1, 5)),
        )
        above = end < fastest
        axis.annotate(
            f"{order:g}",
            (end, KILO * slope * end),
            xytext=(0, 3) if above else (4, 0),
            textcoords="offset points",
            ha="center" if above else "left",
            va="bottom" if above else "center",
            annotation_clip=False,
        )
    axis.annotate(
        "mesh order",
        (1.0, 1.0),
        xycoords="axes fraction",
        xytext=(4, 4),
        textcoords="offset points",
        ha="left",
        va="bottom",
    )
    axis.set(xlim=(slowest, fastest), ylim=(0.0, KILO * limit))


def _draw_natural_frequencies(
    axis: Axes, spectra: SpeedSpectra, parameters: Parameters, limit: float
) -> None:
    """Level lines at the natural frequencies under the mean load."""
    load = spectra.mean_load()
    torque = abs(parameters.operation.load_torque) if load is None else load
    found = natural_frequencies(parameters, torque / base_radii(parameters)[1], parameters.mesh.stiffness)
    for number, frequency in enumerate(sorted({round(rate / (2.0 * math.pi)) for rate in found})):
        if 0.0 < frequency < limit:
            axis.axhline(
                KILO * frequency,
                color="black",
                linewidth=1.0,
                path_effects=[Stroke(linewidth=2.2, foreground="white"), Normal()],
                label="natural frequency, gears and bearings in contact\n"
                f"under {torque:.3g} N m, without damping and film"
                if number == 0
                else None,
            )
    axis.legend(loc="upper left", framealpha=0.9, frameon=True, fontsize=8, handlelength=2.5)
