"""What a run was, in a few lines: commands, contact, forces, impacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN, GEARS, IMPACTS
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.events import CHANGE, PAUSE, RESUME, OperatorEvent
from gear_dynamics_ros.viewer.scales import MICROMETRES

LINES_SHOWN: Final = 12  # of commands and events
LINES_KEPT: Final = 1000
RAMP_GAP: Final = 0.1  # s: changes of commands closer together are one ramp
PACING: Final = ("pacing.", "stepping.")
COMMAND_UNITS: Final = {"drive_torque": "N m", "load_torque": "N m", "speed": "rad/s"}
IMPACT_COLUMN: Final = {entry.name: i for i, entry in enumerate(IMPACTS)}

Values = NDArray[np.float64]


class _Ramp(NamedTuple):
    """Commands that change step by step."""

    begin: float  # s
    end: float  # s
    first: Commands  # before it
    last: Commands


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
        self._ramp: _Ramp | None = None
        self._lines: list[tuple[float, str]] = []  # time in s, text
        self._more = 0  # lines beyond those kept

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
            time = sample * self._interval
            if self._ramp is None:
                self._note(time, f"{time:.3f} s: {command}")
                self._ramp = _Ramp(time, time, command, command)
            elif command != self._ramp.last:
                if time - self._ramp.end > RAMP_GAP:
                    self._end_ramp()
                    self._ramp = _Ramp(time, time, self._ramp.last, command)
                else:
                    self._ramp = self._ramp._replace(end=time, last=command)

    def add_event(self, event: OperatorEvent, text: str) -> None:
        """Take in an operator event and its ``text``; those of pacing alone are left out."""
        pacing = all(name.startswith(PACING) for name in event.parameters)
        if event.kind not in (PAUSE, RESUME) and not (event.kind == CHANGE and pacing):
            self._note(event.time, text)

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
        self._end_ramp()
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
            *(f"- {line}" for _, line in sorted(self._lines, key=itemgetter(0))[:LINES_SHOWN]),
        ]
        more = len(self._lines) + self._more - LINES_SHOWN
        if more > 0:
            lines.append(f"- and {more} more: see `sim_time`")
        return "\n".join(lines)

    def _end_ramp(self) -> None:
        """Note the last change of commands."""
        ramp = self._ramp
        if ramp is None or ramp.first == ramp.last:
            return
        when = f"{ramp.begin:.3f} s" if ramp.begin == ramp.end else f"{ramp.begin:.3f} to {ramp.end:.3f} s"
        changes = [
            f"{name} {before:g} to {after:g} {COMMAND_UNITS[name]}"
            for name, before, after in zip(Commands._fields, ramp.first, ramp.last, strict=True)
            if before != after
        ]
        self._note(ramp.begin, f"{when}: {', '.join(changes)}")
        self._ramp = ramp._replace(first=ramp.last)

    def _note(self, time: float, line: str) -> None:
        if len(self._lines) < LINES_KEPT:
            self._lines.append((time, line))
        else:
            self._more += 1
