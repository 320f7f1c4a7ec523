"""What a run was, in a few lines: commands, contact, forces, impacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN, GEARS, IMPACTS
from gear_dynamics_ros.chunk import Commands

LINES_KEPT: Final = 12  # of commands and events
IMPACT_COLUMN: Final = {entry.name: i for i, entry in enumerate(IMPACTS)}
MICROMETRES: Final = 1.0e6

Values = NDArray[np.float64]


class RunSummary:
    """Collects figures of a run, block by block."""

    def __init__(self, interval: float) -> None:
        """``interval`` between samples, s."""
        self._interval = interval
        self._first: int | None = None
        self._end = 0
        self._samples = 0
        self._states = {1: 0, 0: 0, -1: 0}
        self._peaks: dict[str, tuple[float, float]] = {}  # greatest magnitude and its time
        self._impacts = {gear: (0, 0.0) for gear in GEARS}  # number, fastest
        self._commands: Commands | None = None
        self._lines: list[str] = []
        self._more = 0

    def add(self, first_sample: int, rows: Values) -> None:
        """Take in contiguous samples (n, 28), n > 0."""
        self._first = first_sample if self._first is None else self._first
        self._end = first_sample + len(rows)
        self._samples += len(rows)
        states = rows[:, COLUMN["meshing_state"]]
        for state in self._states:
            self._states[state] += int(np.count_nonzero(states == state))
        for name in ("mesh_force", "dte"):
            values = np.abs(rows[:, COLUMN[name]])
            at = int(values.argmax())
            if values[at] > self._peaks.get(name, (-math.inf, 0.0))[0]:
                self._peaks[name] = float(values[at]), (first_sample + at) * self._interval

    def add_commands(self, commands: Sequence[tuple[int, Commands]]) -> None:
        """Take in commands, each in force from its sample on."""
        for sample, command in commands:
            if command != self._commands:
                self._commands = command
                self._note(f"{sample * self._interval:.3f} s: {command}")

    def add_event(self, text: str) -> None:
        """Take in the text of an operator event."""
        self._note(text)

    def add_impacts(self, impacts: Values) -> None:
        """Take in bearing contacts that ended, (k, 6) of IMPACTS."""
        for number, gear in enumerate(GEARS):
            speeds = impacts[impacts[:, IMPACT_COLUMN["bearing"]] == number, IMPACT_COLUMN["impact_speed"]]
            count, fastest = self._impacts[gear]
            self._impacts[gear] = count + len(speeds), float(max(fastest, speeds.max(initial=0.0)))

    def text(self) -> str:
        """Markdown."""
        if self._first is None:
            return "# The run\n\nIt has no samples yet."
        begin, end = self._first * self._interval, self._end * self._interval
        shares = {state: 100.0 * count / self._samples for state, count in self._states.items()}
        force, dte = self._peaks["mesh_force"], self._peaks["dte"]
        lines = [
            "# The run",
            "",
            f"From {begin:g} s to {end:g} s.",
            "",
            "| | |",
            "|---|---|",
            f"| drive flanks in contact | {shares[1]:.1f} % of the time |",
            f"| contact lost | {shares[0]:.1f} % |",
            f"| back flanks in contact | {shares[-1]:.1f} % |",
            f"| greatest mesh force | {force[0]:.0f} N at {force[1]:.4f} s |",
            f"| greatest DTE | {dte[0] * MICROMETRES:.1f} µm at {dte[1]:.4f} s |",
            *(
                f"| impacts, {gear} bearing | {count}, fastest {fastest:.3g} m/s |"
                for gear, (count, fastest) in self._impacts.items()
            ),
            "",
            "**Commands and events**",
            "",
            *(f"- {line}" for line in self._lines),
        ]
        if self._more:
            lines.append(f"- and {self._more} more: see `sim_time`")
        return "\n".join(lines)

    def _note(self, line: str) -> None:
        if len(self._lines) < LINES_KEPT:
            self._lines.append(line)
        else:
            self._more += 1
