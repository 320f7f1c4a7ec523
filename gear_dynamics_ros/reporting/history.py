"""Commands and events of a recording on a time line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.statistics import Envelope
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.events import CHANGE, END, START
from gear_dynamics_ros.parameters.decimals import exact_text
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.reporting.charts import Band, Chart, Curve, Lane, Mark, draw_chart
from gear_dynamics_ros.reporting.windows import AnalysisWindow, acting_events, whole_span

# s between two values of one command, up to which they belong to one change: a ramp is a value a chunk.
RAMP_GAP: Final = 0.05
MOST_ROWS: Final = 40  # of each table
MOST_TEXTS: Final = 16  # of marks on the time line
MOST_MARKS: Final = 200
COMMAND_NAMES: Final = {
    "drive_torque": ("drive torque", "N m"),
    "load_torque": ("load torque", "N m"),
    "speed": ("speed", "rad/s"),
}


class CommandChange(NamedTuple):
    """One command that changed, at once or over a time: times in s, values in the command's unit."""

    name: str  # field of Commands
    start: float
    end: float
    before: float
    after: float
    values: int

    @property
    def text(self) -> str:
        """Command, values and unit."""
        label, unit = COMMAND_NAMES[self.name]
        steps = f" in {self.values} values" if self.values > 1 else ""
        return f"{label} {self.before:.6g} to {self.after:.6g} {unit}{steps}"

    @property
    def mark(self) -> str:
        """Short text for the time line."""
        label, unit = COMMAND_NAMES[self.name]
        return f"{label.removesuffix(' torque')} {self.after:.4g} {unit}"


class EventRow(NamedTuple):
    """One event of the table."""

    time: float
    kind: str
    text: str


def command_changes(recording: Recording) -> list[CommandChange]:
    """The changes of commands in the order of time; values close to each other are one change."""
    interval = recording.parameters.solver.sample_interval
    changes: list[CommandChange] = []
    newest: dict[str, int] = {}  # index in ``changes`` by command
    for (_, before), (sample, after) in zip(recording.commands, recording.commands[1:], strict=False):
        time = sample * interval
        for name in Commands._fields:
            old, new = getattr(before, name), getattr(after, name)
            if old == new:
                continue
            last = newest.get(name)
            if last is not None and time - changes[last].end <= RAMP_GAP:
                changes[last] = changes[last]._replace(end=time, after=new, values=changes[last].values + 1)
            else:
                newest[name] = len(changes)
                changes.append(CommandChange(name, time, time, old, new, 1))
    return changes


def event_rows(recording: Recording) -> list[EventRow]:
    """The events, those that changed nothing for any sample left out, except start and end."""
    shown = acting_events(recording)
    rows = [event for event in recording.events if event in shown or event.kind in (START, END)]
    return [EventRow(event.time, event.kind, _event_text(event)) for event in rows]


def _event_text(event: OperatorEvent) -> str:
    if event.kind == CHANGE:
        return ", ".join(f"{name} = {_value_text(value)}" for name, value in event.parameters.items())
    return event.message


def _value_text(value: Any) -> str:
    return exact_text(value) if isinstance(value, float) else str(value)


def draw_history(recording: Recording, envelope: Envelope, windows: Sequence[AnalysisWindow]) -> Chart:
    """Time line: commands and what the gearbox did, commands and events marked, ``windows`` shaded."""
    span = whole_span(recording)
    shades = [
        Band(window.span.start, window.span.end, -np.inf, np.inf, palette.GREEN, window.name)
        for window in windows
    ]
    speed = [
        *_commanded(recording, "speed", "set-point", palette.DIM),
        *_recorded(envelope, "driving_speed", "driving", palette.BLUE),
        *_recorded(envelope, "driven_speed", "driven", palette.ORANGE),
    ]
    torque = [
        *_recorded(envelope, "drive_torque", "drive", palette.BLUE),
        *_recorded(envelope, "load_torque", "load", palette.ORANGE),
        *_commanded(recording, "load_torque", "load commanded", palette.DIM),
    ]
    marks = [
        Lane("commands", marks=_command_marks(recording)),
        Lane("events", marks=_event_marks(recording)),
    ]
    lanes = [
        *(lane for lane in marks if lane.marks),
        Lane("speed", "rad/s", speed, bands=shades),
        Lane("torque", "N m", torque, bands=shades),
    ]
    return draw_chart(
        "Commands and events over simulated time",
        lanes,
        span.start,
        span.end,
        "history",
        "simulated time (s)",
    )


def _command_marks(recording: Recording) -> list[Mark]:
    changes = command_changes(recording)
    return [
        Mark(change.start, change.mark if place < MOST_TEXTS else "", palette.DIM)
        for place, change in enumerate(changes[:MOST_MARKS])
    ]


def _event_marks(recording: Recording) -> list[Mark]:
    events = [event for event in acting_events(recording) if event.sample > recording.first_sample]
    return [
        Mark(event.time, event.kind if place < MOST_TEXTS else "", palette.PURPLE)
        for place, event in enumerate(events[:MOST_MARKS])
    ]


def _commanded(recording: Recording, name: str, label: str, colour: str) -> list[Curve]:
    """The command in force as a line with steps."""
    interval = recording.parameters.solver.sample_interval
    if not recording.commands:
        return []
    times = np.array([sample * interval for sample, _ in recording.commands])
    values = np.array([float(getattr(commands, name)) for _, commands in recording.commands])
    ends = np.append(times[1:], recording.end_sample * interval)
    stepped_times = np.column_stack([times, ends]).ravel()
    stepped = np.repeat(values, 2)
    return [Curve(label, colour, stepped_times, stepped, stepped, dashed=True)]


def _recorded(envelope: Envelope, name: str, label: str, colour: str) -> list[Curve]:
    if name not in envelope.names:
        return []
    return [Curve(label, colour, envelope.times(), *envelope.bounds(name))]
