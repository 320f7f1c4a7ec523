"""Draws short windows of a run, sample by sample, on a timeline on which they play slowly."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.viewer.canvas import Canvas, Times
from gear_dynamics_ros.viewer.curve_plots import CurvePlots
from gear_dynamics_ros.viewer.entities import SLOW_TIMELINE
from gear_dynamics_ros.viewer.journal_orbits import BearingOrbits
from gear_dynamics_ros.viewer.phase_portrait import PhasePortrait
from gear_dynamics_ros.viewer.scales import MICROMETRES
from gear_dynamics_ros.viewer.scene import Frames, GearScene
from gear_dynamics_ros.viewer.slow_motion import SlowWindow

MOST_FRAMES: Final = 250  # of a window
PATH_SAMPLES: Final = 300  # of an orbit or phase portrait before each frame
PAUSE: Final = 1.0  # s on the slow timeline between two windows
MOMENTS: Final = {"drive": 1, "apart": 0, "back": -1}  # stills: name, meshing state
NOT_SEEN: Final = "not in the slow motion"

Values = NDArray[np.float64]


class SlowScene:
    """Draws windows behind each other on the slow timeline, and a still of each meshing state."""

    def __init__(
        self,
        canvas: Canvas,
        scene: GearScene,
        orbits: BearingOrbits,
        portrait: PhasePortrait,
        curves: CurvePlots,
    ) -> None:
        self._canvas = canvas
        self._scene = scene
        self._orbits = orbits
        self._portrait = portrait
        self._curves = curves
        self._offset_ns = 0

    def draw_fixed(self) -> None:
        """Draw what stands in the place of a still that a run does not have."""
        for name in MOMENTS:
            self._scene.draw_moment_title(name, NOT_SEEN, palette.GREY)

    def draw(self, window: SlowWindow, interval_ns: int) -> None:
        """Draw ``window`` behind the last one; ``interval_ns`` is that of its samples."""
        count = len(window.rows)
        stride = math.ceil(count / MOST_FRAMES)
        shown = np.arange(0, count, stride)
        slow_ns = interval_ns * window.factor
        times = Times(SLOW_TIMELINE, self._offset_ns + np.rint(np.arange(count) * slow_ns).astype(np.int64))
        frame_times = Times(SLOW_TIMELINE, times.ns[shown])
        angle = window.rows[:, COLUMN["driving_angle"]]
        revolutions = np.cumsum(np.diff(angle, prepend=angle[0]) < -math.pi).astype(float)
        note = f" (slowed {window.factor:g} times)"
        self._scene.draw(Frames(window.rows[shown], revolutions[shown], frame_times, note))
        paths = [window.rows[max(0, end - PATH_SAMPLES) : end + 1] for end in shown.tolist()]
        self._orbits.draw(paths, frame_times)
        self._portrait.draw(paths, frame_times)
        self._curves.draw_every(times, window.rows)
        self._offset_ns = int(times.ns[-1]) + round(PAUSE * 1e9)
        for name, state in MOMENTS.items():
            self._draw_moment(name, state, window.rows)

    def _draw_moment(self, name: str, state: int, rows: Values) -> None:
        """The sample of ``state`` in ``rows`` that shows it best."""
        found = np.flatnonzero(rows[:, COLUMN["meshing_state"]] == state)
        if not len(found):
            return
        dte = rows[found, COLUMN["dte"]]
        best = found[np.argmin(np.abs(dte))] if state == 0 else found[np.argmax(np.abs(dte))]
        row = rows[best]
        half = row[COLUMN["half_backlash"]] * MICROMETRES
        shift = row[COLUMN["dte"]] * MICROMETRES
        gap = f"gap {half - shift:.1f} µm" if state == 0 else f"force {row[COLUMN['mesh_force']]:.0f} N"
        self._scene.draw_moment(name, f"{row[COLUMN['time']]:.6f} s\n{gap}", row)
