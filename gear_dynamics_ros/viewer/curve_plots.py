"""Draws the curves over time, thinned so that every peak stays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.ledger import RESIDUAL_SIGNS
from gear_dynamics_ros.channels import COLUMN, ENERGIES, GEARS, IMPACTS
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.viewer import curves
from gear_dynamics_ros.viewer.canvas import Canvas, Times, rgb_values
from gear_dynamics_ros.viewer.curves import CurveStyle
from gear_dynamics_ros.viewer.entities import MESHING, RUN_TIMELINE
from gear_dynamics_ros.viewer.scene import STATE_COLOURS
from gear_dynamics_ros.viewer.thinning import extreme_indices

STATE_BLOCKS: Final = 5  # blocks of a curve with one meshing state
STATE_NAMES: Final = {1: "drive", 0: "apart", -1: "back"}
IMPACT_COLUMN: Final = {entry.name: i for i, entry in enumerate(IMPACTS)}

Values = NDArray[np.float64]


class CurvePlots:
    """Draws curves of samples, commands, impacts, energies and the real-time factor."""

    def __init__(self, canvas: Canvas, interval_ns: int) -> None:
        self._canvas = canvas
        self._interval_ns = interval_ns
        self._curves = curves.sample_curves()
        self._commands: Commands | None = None
        self._state: str | None = None
        self._first_energies: Values | None = None

    def draw_fixed(self) -> None:
        """Names, colours and widths of all curves."""
        for curve in self._curves:
            self._style(curve.style)
        for style in (
            *curves.ENERGY_STYLES.values(),
            curves.RESIDUAL_STYLE,
            curves.PACE_STYLE,
        ):
            self._style(style)
        for style in curves.COMMAND_STYLES.values():
            self._style(style)
            self._canvas.fix(style.entity, rr.SeriesLines.from_fields(interpolation_mode="StepAfter"))
        for style in curves.IMPACT_STYLES.values():
            points = rr.SeriesPoints(
                colors=rgb_values(style.colour), names=style.label, markers="diamond", marker_sizes=3.0
            )
            self._canvas.fix(style.entity, points)
        states = rr.StateConfiguration(
            values=list(STATE_NAMES.values()),
            colors=[rgb_values(STATE_COLOURS[state]) for state in STATE_NAMES],
        )
        self._canvas.fix(MESHING, states)

    def draw(self, first_sample: int, rows: Values, width: int) -> None:
        """Draw the least and the greatest of every ``width`` of the contiguous samples (n, 28)."""
        times = (first_sample + np.arange(len(rows))) * self._interval_ns
        for curve in self._curves:
            values = curve.values(rows)
            kept = extreme_indices(values, width, first_sample)
            self._canvas.scalars(curve.style.entity, Times(RUN_TIMELINE, times[kept]), values[kept])
        self._draw_states(first_sample, rows, STATE_BLOCKS * width)

    def draw_every(self, times: Times, rows: Values) -> None:
        """Draw all samples (n, 28), n > 0, at ``times``, which need not be those of the run; then a gap."""
        ended = Times(times.timeline, np.append(times.ns, times.ns[-1] + 1))
        for curve in self._curves:
            self._canvas.scalars(curve.style.entity, ended, np.append(curve.values(rows), np.nan))
        states = rows[:, COLUMN["meshing_state"]]
        began = np.concatenate([[0], np.flatnonzero(np.diff(states) != 0.0) + 1])
        names = [STATE_NAMES.get(state, "apart") for state in states[began].tolist()]
        self._canvas.states(MESHING, Times(times.timeline, times.ns[began]), names)

    def draw_commands(self, commands: Sequence[tuple[int, Commands]]) -> None:
        """Draw ``commands``, each in force from its sample on, where they change."""
        for sample, command in commands:
            if command != self._commands:
                self._commands = command
                self.extend_commands(sample)

    def extend_commands(self, sample: int) -> None:
        """Draw the commands in force up to ``sample``."""
        if self._commands is not None:
            for style, value in zip(curves.COMMAND_STYLES.values(), self._commands, strict=True):
                self._canvas.scalars(style.entity, self._at([sample]), np.array([value]))

    def draw_impacts(self, impacts: Values, spacing: float) -> None:
        """Draw the closing speed of ``impacts`` (k, 6) of IMPACTS: the fastest of each ``spacing`` s."""
        for number, gear in enumerate(GEARS):
            rows = impacts[impacts[:, IMPACT_COLUMN["bearing"]] == number]
            kept = fastest_impacts(rows, spacing)
            times = np.rint(kept[:, IMPACT_COLUMN["begin"]] * 1e9).astype(np.int64)
            speeds = kept[:, IMPACT_COLUMN["impact_speed"]]
            self._canvas.scalars(curves.IMPACT_STYLES[gear].entity, Times(RUN_TIMELINE, times), speeds)

    def draw_energies(self, energies: Sequence[tuple[int, Values]]) -> None:
        """Draw the changes of ENERGIES (9,), each after its sample, since the first, and their residual."""
        for sample, values in energies:
            if self._first_energies is None:
                self._first_energies = values.copy()
            changes = values - self._first_energies
            for energy, change in zip(ENERGIES, changes, strict=True):
                style = curves.ENERGY_STYLES[energy.name]
                self._canvas.scalars(style.entity, self._at([sample]), np.array([change]))
            residual = RESIDUAL_SIGNS @ changes
            self._canvas.scalars(curves.ENERGY_RESIDUAL, self._at([sample]), np.array([residual]))

    def draw_pace(self, time: float, real_time_factor: float) -> None:
        """Draw one report of the pacing at the simulated ``time``, s."""
        times = Times(RUN_TIMELINE, np.array([round(time * 1e9)], dtype=np.int64))
        self._canvas.scalars(curves.PACE_STYLE.entity, times, np.array([real_time_factor]))

    def restart_energies(self) -> None:
        """The energies begin again at zero: balance them from the next on."""
        self._first_energies = None

    def _draw_states(self, first_sample: int, rows: Values, width: int) -> None:
        """Of every ``width`` samples: back if a back flank struck, else apart if contact was lost."""
        states = rows[:, COLUMN["meshing_state"]]
        begins = [0, *range(width - first_sample % width, len(states), width)]
        for begin, end in zip(begins, [*begins[1:], len(states)], strict=True):
            name = STATE_NAMES.get(states[begin:end].min(), "apart")
            if name != self._state:
                self._state = name
                self._canvas.states(MESHING, self._at([first_sample + begin]), [name])

    def _style(self, style: CurveStyle) -> None:
        lines = rr.SeriesLines(
            colors=rgb_values(style.colour),
            names=style.label,
            widths=style.width,
            aggregation_policy="MinMax",
        )
        self._canvas.fix(style.entity, lines)

    def _at(self, samples: Sequence[int]) -> Times:
        return Times(RUN_TIMELINE, np.array(samples, dtype=np.int64) * self._interval_ns)


def fastest_impacts(rows: Values, spacing: float) -> Values:
    """Of ``rows`` (k, 6) of IMPACTS, the one with the greatest impact speed in each ``spacing`` s."""
    if not len(rows):
        return rows
    rows = rows[np.argsort(rows[:, IMPACT_COLUMN["begin"]], kind="stable")]
    slots = np.floor(rows[:, IMPACT_COLUMN["begin"]] / spacing)
    order = np.lexsort((-rows[:, IMPACT_COLUMN["impact_speed"]], slots))
    first = np.concatenate([[True], np.diff(slots[order]) != 0.0])
    return np.asarray(rows[np.sort(order[first])])
