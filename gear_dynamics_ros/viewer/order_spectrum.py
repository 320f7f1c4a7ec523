"""Running amplitude spectrum of DTE over mesh orders: 1 is the mesh frequency."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.sections import lagrange_weights
from gear_dynamics_ros.analysis.spectra import amplitude_spectrum
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.viewer.canvas import Canvas, Times
from gear_dynamics_ros.viewer.entities import ORDERS
from gear_dynamics_ros.viewer.scales import MICROMETRES

HIGHEST_ORDER: Final = 6
POINTS_PER_PERIOD: Final = 4 * HIGHEST_ORDER
MOST_PERIODS: Final = 64
FEWEST_PERIODS: Final = 16
DECADES: Final = (-3, 2)  # powers of ten in µm that the view shows
WIDTH: Final = 1.2  # of an order, in decades

Values = NDArray[np.float64]


class OrderAmplitudes(NamedTuple):
    """Amplitudes in m over mesh orders, each (n,)."""

    order: Values
    amplitude: Values


def order_amplitudes(rows: Values) -> OrderAmplitudes | None:
    """Spectrum of DTE over the last mesh periods in samples (n, 28); None if these are too few.

    DTE is taken at equal steps of the mesh phase, so that lines stay sharp while the speed changes. Orders
    beyond half the samples of a mesh period are left out.
    """
    wraps = np.flatnonzero(np.abs(np.diff(rows[:, COLUMN["mesh_phase"]])) > np.pi)
    if len(wraps) > MOST_PERIODS + 1:
        rows = rows[wraps[-MOST_PERIODS - 2] :]
    turns = np.abs(np.unwrap(rows[:, COLUMN["mesh_phase"]])) / (2.0 * np.pi)
    steps = np.diff(turns)
    if len(rows) < 2 or not (steps > 0.0).all():
        return None
    periods = min(MOST_PERIODS, int(turns[-1] - turns[0]))
    if periods < FEWEST_PERIODS:
        return None
    grid = turns[-1] - periods + np.arange(periods * POINTS_PER_PERIOD) / POINTS_PER_PERIOD
    before = np.clip(np.searchsorted(turns, grid, side="right") - 1, 1, len(turns) - 3)
    weights = lagrange_weights((grid - turns[before]) / steps[before])
    values = rows[:, COLUMN["dte"]]
    dte = sum(
        (weight * values[before + offset] for offset, weight in zip((-1, 0, 1, 2), weights, strict=True)),
        start=np.zeros(len(grid)),
    )
    spectrum = amplitude_spectrum(dte, 1.0 / POINTS_PER_PERIOD)
    highest = min(HIGHEST_ORDER, 0.5 / float(steps[-len(steps) // 2 :].mean()))
    shown = spectrum.frequency <= highest
    return OrderAmplitudes(spectrum.frequency[shown], spectrum.amplitude[shown])


class OrderSpectrum:
    """Draws the spectrum: x is the order times WIDTH, y the power of ten of the amplitude in µm."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas

    @property
    def bounds(self) -> tuple[complex, complex]:
        """Lower left and upper right corner of the view."""
        return complex(-0.9, DECADES[0] - 1.0), complex(WIDTH * HIGHEST_ORDER + 0.3, DECADES[1] + 0.3)

    def draw_fixed(self) -> None:
        """Draw the grid and its labels."""
        low, high = DECADES
        right = WIDTH * HIGHEST_ORDER
        levels = [np.array([0.0, right]) + 1j * decade for decade in range(low, high + 1)]
        orders = [WIDTH * order + 1j * np.array([low, high]) for order in range(HIGHEST_ORDER + 1)]
        self._canvas.fix_lines(
            f"{ORDERS}/grid", levels + orders, [palette.DIM] * (len(levels) + len(orders)), 1.0
        )
        texts = {f"{10.0**decade:g} µm": complex(-0.5, decade) for decade in range(low, high + 1)}
        texts |= {f"{order}": complex(WIDTH * order, low - 0.2) for order in range(1, HIGHEST_ORDER + 1)}
        texts["amplitude of DTE over mesh order"] = complex(0.5 * right, low - 0.55)
        self._canvas.fix_labels(f"{ORDERS}/labels", texts, palette.GREY)
        self._canvas.style_lines(f"{ORDERS}/amplitude", [palette.SKY], 1.5)

    def draw(self, rows: Values, time: Times) -> None:
        """Draw the spectrum of the last mesh periods of ``rows`` (n, 28) at one ``time``."""
        found = order_amplitudes(rows)
        if found is None:
            return
        level = np.log10(np.maximum(found.amplitude * MICROMETRES, 10.0 ** DECADES[0]))
        self._canvas.lines(f"{ORDERS}/amplitude", time, [WIDTH * found.order + 1j * level])
