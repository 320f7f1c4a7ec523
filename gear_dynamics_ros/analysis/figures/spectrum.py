"""Amplitude spectrum with mesh orders."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import KILO, MICRO, styled, thinned
from gear_dynamics_ros.analysis.spectra import amplitude_spectrum
from gear_dynamics_ros.analysis.summary import observed_mesh_frequency
from gear_dynamics_ros.chunk import Samples

DYNAMIC_RANGE: Final = 1e5  # of the amplitude axis
ORDERS: Final = 5.5  # mesh orders on the frequency axis


@styled
def spectrum_figure(samples: Samples) -> Figure:
    """Amplitude spectrum of the DTE, with orders of the mesh frequency on top.

    Needs the channel dte; raises ValueError for fewer than spectra.MIN_SAMPLES samples.
    """
    found = amplitude_spectrum(samples["dte"], samples.interval)
    mesh = observed_mesh_frequency(samples)
    highest = float(found.frequency[-1])
    limit = min(highest, ORDERS * abs(mesh)) if mesh else highest
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axis = figure.subplots()
    shown = slice(1, int(np.searchsorted(found.frequency, limit)) + 1)
    amplitude = MICRO * found.amplitude[shown]
    top = float(amplitude.max()) or 1.0
    curve = thinned(KILO * found.frequency[shown], np.maximum(amplitude, top / DYNAMIC_RANGE / 10.0))
    axis.semilogy(*curve, color=palette.BLUE, linewidth=0.8)
    axis.set_ylim(top / DYNAMIC_RANGE, 2.0 * top)
    axis.set_xlim(0.0, KILO * limit)
    axis.set_xlabel("frequency (kHz)")
    axis.set_ylabel("amplitude of DTE (µm)")
    axis.grid(axis="x", visible=mesh is None)
    if mesh is not None:
        _mesh_orders(axis, KILO * abs(mesh), KILO * limit)
    axis.set_title(
        f"Spectrum of the DTE over {len(samples) * samples.interval:.3g} s "
        f"(flat-top window, bins of {found.resolution:.3g} Hz)"
    )
    return figure


def _mesh_orders(axis: Axes, mesh: float, limit: float) -> None:
    """Lines at whole orders, and their numbers on an axis above; ``mesh`` and ``limit`` in kHz."""
    for order in range(1, int(limit / mesh) + 1):
        axis.axvline(order * mesh, color=palette.ORANGE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
    above = axis.secondary_xaxis(
        "top", functions=(lambda f: np.asarray(f) / mesh, lambda order: np.asarray(order) * mesh)
    )
    above.set_xlabel(f"order of the mesh frequency ({mesh:.3f} kHz)", color=palette.ORANGE)
    above.tick_params(colors=palette.ORANGE)
