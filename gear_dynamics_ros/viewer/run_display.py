"""Draws a run, block by block: the same pictures live, in a file, and from a recording.

Curves have the least and the greatest sample of every POINT_INTERVAL, which keeps all peaks. The gears are
drawn FRAMES_PER_SECOND times per simulated second, as under a strobe light; orbits and phase portrait every
PICTURE_INTERVAL with the last PICTURE_SPAN. Where the teeth lose contact, a short window is drawn again,
sample by sample, on a slow timeline. ``viewer.thinning.Density`` bounds the growth of a long run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.events import RESET, RESTORE, TIMEOUT, OperatorEvent
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer import blueprint, explanation
from gear_dynamics_ros.viewer.canvas import Canvas, Times
from gear_dynamics_ros.viewer.curve_plots import CurvePlots
from gear_dynamics_ros.viewer.entities import ABOUT_RUN, ABOUT_VIEW, EVENTS, RUN_TIMELINE
from gear_dynamics_ros.viewer.journal_orbits import BearingOrbits
from gear_dynamics_ros.viewer.order_spectrum import OrderSpectrum
from gear_dynamics_ros.viewer.phase_portrait import PhasePortrait
from gear_dynamics_ros.viewer.run_block import RunBlock
from gear_dynamics_ros.viewer.run_summary import RunSummary
from gear_dynamics_ros.viewer.scales import drawing_scales
from gear_dynamics_ros.viewer.scene import Frames, GearScene
from gear_dynamics_ros.viewer.slow_motion import SlowMotionChooser
from gear_dynamics_ros.viewer.slow_scene import SlowScene
from gear_dynamics_ros.viewer.thinning import Density, strobe_indices

POINT_INTERVAL: Final = 4.0e-3  # s of simulated time
FRAMES_PER_SECOND: Final = 10.0
STROBE_REACH: Final = 0.01  # s before a frame in which its sample is searched
STROBE_SPEED: Final = 0.25  # teeth per simulated second that seem to pass
PICTURE_INTERVAL: Final = 0.1  # s
PICTURE_SPAN: Final = 0.005  # s
SPECTRUM_INTERVAL: Final = 0.5  # s
SLOW_INTERVAL: Final = 2.0  # s between points of energies, and of commands that stay
ALARMS: Final = frozenset({TIMEOUT, RESET, RESTORE})  # events that need attention
RUN_IN_PROGRESS: Final = "# The run\n\nIts figures appear here when it has ended."
TURN: Final = 2.0 * math.pi

Values = NDArray[np.float64]


class RunDisplay:
    """Draws one run into one Rerun stream; for one thread. ``canvas.send`` sends what was drawn."""

    def __init__(self, stream: rr.RecordingStream, parameters: Parameters, density: Density) -> None:
        scales = drawing_scales(parameters)
        self.canvas = Canvas(stream)
        self._parameters = parameters
        self._density = density
        self._interval = parameters.solver.sample_interval
        self._interval_ns = parameters.solver.sample_interval_ns
        self._scene = GearScene(self.canvas, parameters, scales)
        self._orbits = BearingOrbits(self.canvas, parameters)
        self._portrait = PhasePortrait(self.canvas, parameters)
        self._orders = OrderSpectrum(self.canvas)
        self._curves = CurvePlots(self.canvas, self._interval_ns)
        self._summary = RunSummary(self._interval)
        self._about = explanation.Explanation(parameters, scales)
        self._chooser = SlowMotionChooser(parameters.gears.driving.teeth, self._interval)
        self._slow = SlowScene(self.canvas, self._scene, self._orbits, self._portrait, self._curves)
        self._teeth = (parameters.gears.driving.teeth, parameters.gears.driven.teeth)
        self._first: int | None = None  # the first sample drawn
        self._energies: Sequence[tuple[int, Values]] = ()  # the last ones
        self._end: int | None = None  # the sample behind the last drawn
        self._revolutions = 0.0
        self._last_angle = 0.0

    def views(self) -> blueprint.Views:
        """What the layouts show."""
        return blueprint.Views(
            scene=self._scene.bounds,
            close_up=self._scene.close_up_bounds,
            still=self._scene.still_bounds,
            clearances=self._orbits.clearances,
            film_clearances=self._orbits.film_clearances if self._orbits.film else {},
            spectrum=self._orders.bounds,
        )

    def draw_fixed(self) -> None:
        """Draw what stays for the whole run: shapes, names and colours of curves, explanations."""
        for part in (self._scene, self._slow, self._orbits, self._portrait, self._orders, self._curves):
            part.draw_fixed()
        self._write(ABOUT_VIEW, self._about.text())
        self._write(ABOUT_RUN, RUN_IN_PROGRESS)

    def draw(self, block: RunBlock) -> None:
        """Draw a block of the run; blocks come in order, samples between them may be missing."""
        if self._first is None:
            self._first = block.first_sample
        revolutions = self._count_revolutions(block.rows)
        factor = self._density.spacing((block.first_sample - self._first) * self._interval)
        end = self._end = block.first_sample + len(block.rows)
        self._curves.draw(block.first_sample, block.rows, factor * self._samples(POINT_INTERVAL))
        self._curves.draw_commands(block.commands)
        if len(self._due(block, SLOW_INTERVAL, factor)):
            self._curves.extend_commands(end - 1)
            self._curves.draw_energies(block.energies)
        self._energies = block.energies[-1:]
        self._curves.draw_impacts(block.impacts, factor * POINT_INTERVAL)
        self._summary.add(block.first_sample, block.rows)
        self._summary.add_commands(block.commands)
        self._summary.add_impacts(block.impacts)
        self._draw_frames(block, revolutions, factor)
        self._portrait.add(block.rows)
        self._draw_pictures(block, factor)
        if len(self._due(block, SPECTRUM_INTERVAL, factor)):
            self._orders.draw(block.rows, self._times([end - 1]))
        for window in self._chooser.add(block.first_sample, block.rows):
            self._slow.draw(window, self._interval_ns)

    def log_event(self, event: OperatorEvent) -> None:
        """Write an operator event to the log."""
        if event.kind in (RESET, RESTORE):
            self._curves.restart_energies()
        level = "WARN" if event.kind in ALARMS else "INFO"
        time = Times(RUN_TIMELINE, np.array([round(event.time * 1e9)], dtype=np.int64))
        text = event_text(event)
        self._summary.add_event(event, text)
        self.canvas.log_lines(EVENTS, time, [text], [level])

    def draw_pace(self, time: float, real_time_factor: float) -> None:
        """Draw one report of the pacing at the simulated ``time``, s."""
        self._curves.draw_pace(time, real_time_factor)

    def finish(self) -> None:
        """Draw what only the end of a run decides."""
        if self._end is not None:
            self._curves.extend_commands(self._end - 1)
            self._curves.draw_energies(self._energies)
        window = self._chooser.last()
        if window is not None:
            self._slow.draw(window, self._interval_ns)
        self._write(ABOUT_RUN, self._summary.text())

    def _write(self, entity: str, text: str) -> None:
        self.canvas.fix(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _draw_frames(self, block: RunBlock, revolutions: Values, factor: int) -> None:
        ends = self._due(block, 1.0 / FRAMES_PER_SECOND, factor)
        if not len(ends):
            return
        phase = block.rows[:, COLUMN["mesh_phase"]]
        targets = (
            TURN * STROBE_SPEED * self._interval * np.asarray(block.first_sample + ends, dtype=np.float64)
        )
        chosen = strobe_indices(phase, ends, targets, self._samples(STROBE_REACH))
        times = self._times(block.first_sample + chosen)
        self._scene.draw(Frames(block.rows[chosen], revolutions[chosen], times))

    def _draw_pictures(self, block: RunBlock, factor: int) -> None:
        ends = self._due(block, PICTURE_INTERVAL, factor)
        if not len(ends):
            return
        span = self._samples(PICTURE_SPAN)
        paths = [block.rows[max(0, end - span) : end] for end in ends.tolist()]
        times = self._times(block.first_sample + ends - 1)
        self._orbits.draw(paths, times)
        self._portrait.draw(paths, times)
        self._portrait.draw_section(Times(times.timeline, times.ns[-1:]))

    def _due(self, block: RunBlock, spacing: float, factor: int) -> NDArray[np.intp]:
        """Ends (behind the last sample) in ``block`` at whole multiples of ``spacing`` s times ``factor``."""
        step = factor * self._samples(spacing)
        begin = step - block.first_sample % step
        ends = np.arange(begin, len(block.rows) + 1, step, dtype=np.intp)
        # The first sample too, so that a viewer at the start of the run shows something.
        return np.concatenate([[1], ends]) if block.first_sample == self._first else ends

    def _samples(self, span: float) -> int:
        return max(1, round(span / self._interval))

    def _times(self, samples: NDArray[np.intp] | list[int]) -> Times:
        return Times(RUN_TIMELINE, np.asarray(samples, dtype=np.int64) * self._interval_ns)

    def _count_revolutions(self, rows: Values) -> Values:
        """Whole revolutions of the driving gear before each of ``rows`` (n, 28) since the first, (n,).

        Counted modulo the teeth of the driven gear: after as many, the same teeth meet.
        """
        angle = rows[:, COLUMN["driving_angle"]]
        steps = np.diff(angle, prepend=self._last_angle)
        turns = self._revolutions + np.cumsum((steps < -math.pi).astype(float) - (steps > math.pi))
        self._revolutions, self._last_angle = float(turns[-1]) % self._teeth[1], float(angle[-1])
        return np.asarray(turns)


def event_text(event: OperatorEvent) -> str:
    """One line about an operator event."""
    changes = ", ".join(f"{name} = {value}" for name, value in {**event.parameters, **event.commands}.items())
    details = "; ".join(part for part in (event.message, changes) if part)
    return f"{event.time:.6f} s: {event.kind}{': ' if details else ''}{details}"
