"""Orbits of the journals in their bearings, µm: path, clearance and film circles, penetration."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.canvas import Canvas, Times, circle
from gear_dynamics_ros.viewer.entities import orbit_entity
from gear_dynamics_ros.viewer.gear_pair import plane_vector
from gear_dynamics_ros.viewer.scales import MICROMETRES

VIEW_MARGIN: Final = 1.35  # of the circle that fills a view

Values = NDArray[np.float64]


class BearingOrbits:
    """Draws the orbit of each journal; lengths in µm, not magnified."""

    def __init__(self, canvas: Canvas, parameters: Parameters) -> None:
        self._canvas = canvas
        bearings = {gear: getattr(parameters.bearings, gear) for gear in GEARS}
        self.clearances = {gear: bearings[gear].clearance * MICROMETRES for gear in GEARS}
        self.film_clearances = {gear: bearings[gear].oil_clearance * MICROMETRES for gear in GEARS}
        self.film = parameters.model == "improved"

    def draw_fixed(self) -> None:
        """Draw circles and styles."""
        for gear in GEARS:
            entity = orbit_entity(gear)
            self._draw_circles(gear)
            self._canvas.style_lines(f"{entity}/path", [palette.SKY], 1.4)
            self._canvas.style_points(f"{entity}/now", palette.YELLOW, 9.0)
            self._canvas.style_lines(f"{entity}/penetration", [palette.ORANGE], 7.0)
            self._canvas.style_labels(f"{entity}/status")

    def draw(self, paths: list[Values], times: Times) -> None:
        """Draw pictures that end at ``times``; each of ``paths`` has samples (n, 28), n > 0, up to one."""
        for gear in GEARS:
            entity, clearance = orbit_entity(gear), self.clearances[gear]
            lines = [MICROMETRES * plane_vector(rows, gear) for rows in paths]
            now = np.array([line[-1] for line in lines])
            self._canvas.lines(f"{entity}/path", times, lines)
            self._canvas.points(f"{entity}/now", times, now[:, None])
            penetration = np.abs(now) - clearance
            outward = now / np.maximum(np.abs(now), 1e-12)
            begin = np.where(penetration > 0.0, clearance * outward, now)
            self._canvas.lines(f"{entity}/penetration", times, np.stack([begin, now], axis=1))
            texts = [f"penetration {p:.2f} µm" if p > 0.0 else f"gap {-p:.2f} µm" for p in penetration]
            colours = [palette.ORANGE if p > 0.0 else palette.YELLOW for p in penetration]
            place = np.full(len(now), -1.17j * clearance)
            self._canvas.labels(f"{entity}/status", times, place, texts, colours)

    def _draw_circles(self, gear: str) -> None:
        entity, clearance, film = orbit_entity(gear), self.clearances[gear], self.film_clearances[gear]
        cross = [clearance * np.array([-1.0, 1.0]) * turn for turn in (1.0, 1.0j)]
        self._canvas.fix_lines(
            f"{entity}/clearance",
            [circle(clearance), *cross],
            [palette.ORANGE, palette.DIM, palette.DIM],
            1.6,
        )
        text = {f"bearing clearance {clearance:g} µm": 1.28j * clearance}
        self._canvas.fix_labels(f"{entity}/clearance_name", text, palette.ORANGE)
        if self.film:
            self._canvas.fix_lines(f"{entity}/film", [circle(film)], [palette.GREEN], 1.6)
            text = {f"film clearance {film:g} µm": 1.14j * film}
            self._canvas.fix_labels(f"{entity}/film_name", text, palette.GREEN)
