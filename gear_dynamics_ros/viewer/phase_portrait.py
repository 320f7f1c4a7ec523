"""DTE over its rate, normalised, with Poincaré points: one for each mesh period, at mesh phase 0."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.sections import poincare_points
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.viewer.blueprint import PORTRAIT_HALF
from gear_dynamics_ros.viewer.canvas import Canvas, Times
from gear_dynamics_ros.viewer.entities import PHASE_PORTRAIT
from gear_dynamics_ros.viewer.scales import MICROMETRES

POINTS_KEPT: Final = 400

Values = NDArray[np.float64]


class PhasePortrait:
    """Draws the phase portrait in half backlashes and in their product with the torsional frequency."""

    def __init__(self, canvas: Canvas, parameters: Parameters) -> None:
        gears, r = parameters.gears, base_radii(parameters)
        compliance = r[0] ** 2 / gears.driving.inertia + r[1] ** 2 / gears.driven.inertia
        self._canvas = canvas
        self.dte_scale = 0.5 * gears.backlash  # m
        self.rate_scale = self.dte_scale * float(np.sqrt(parameters.mesh.stiffness * compliance))  # m/s
        self._section = np.empty(0, dtype=np.complex128)

    def draw_fixed(self) -> None:
        """Draw axes and styles."""
        across, up = 0.92 * PORTRAIT_HALF.real, 0.92 * PORTRAIT_HALF.imag
        axes = [np.array([-across, across]) + 0.0j, 1j * np.array([-up, up])]
        flanks = [side + 1j * np.array([-up, up]) for side in (-1.0, 1.0)]
        entity = PHASE_PORTRAIT
        self._canvas.fix_lines(f"{entity}/axes", axes + flanks, [palette.DIM] * 2 + [palette.YELLOW] * 2, 1.2)
        self._canvas.fix_labels(
            f"{entity}/labels",
            {
                f"back flank -{self.dte_scale * MICROMETRES:g} µm": complex(-1.0, up),
                f"drive flank {self.dte_scale * MICROMETRES:g} µm": complex(1.0, up),
                "DTE / half backlash →": complex(-0.66 * across, -0.16),
                f"DTE rate / {self.rate_scale:.3g} m/s ↑": complex(0.0, -0.86 * up),
            },
            palette.GREY,
        )
        self._canvas.style_lines(f"{entity}/path", [palette.SKY], 1.2)
        self._canvas.style_points(f"{entity}/now", palette.YELLOW, 9.0)
        self._canvas.style_points(f"{entity}/poincare", palette.ORANGE, 5.0)

    def add(self, rows: Values) -> None:
        """Take in contiguous samples (n, 28): their Poincaré points show in the next picture."""
        wraps = np.flatnonzero(np.abs(np.diff(rows[:, COLUMN["mesh_phase"]])) > np.pi)
        if not len(wraps):
            return
        # Two samples on either side of the first point that is kept.
        begin = max(0, int(wraps[-POINTS_KEPT:][0]) - 2)
        rows = rows[begin:]
        points = poincare_points(rows[:, COLUMN["mesh_phase"]], rows[:, [COLUMN["dte"], COLUMN["dte_rate"]]])
        self._section = np.concatenate([self._section, self._normalised(points)])[-POINTS_KEPT:]

    def draw(self, paths: list[Values], times: Times) -> None:
        """Draw pictures that end at ``times``; each of ``paths`` has samples (n, 28), n > 0, up to one."""
        columns = [COLUMN["dte"], COLUMN["dte_rate"]]
        lines = [self._normalised(rows[:, columns]) for rows in paths]
        self._canvas.lines(f"{PHASE_PORTRAIT}/path", times, lines)
        self._canvas.points(f"{PHASE_PORTRAIT}/now", times, [line[-1:] for line in lines])

    def draw_section(self, time: Times) -> None:
        """Draw the last POINTS_KEPT Poincaré points at one ``time``."""
        self._canvas.points(f"{PHASE_PORTRAIT}/poincare", time, [self._section])

    def _normalised(self, values: Values) -> NDArray[np.complex128]:
        return np.asarray(values[:, 0] / self.dte_scale + 1j * values[:, 1] / self.rate_scale)
