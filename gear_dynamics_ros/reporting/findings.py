"""What to know before trusting a recording: what was checked, and what was found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple, TypeAlias

from gear_dynamics_ros.channels import PACE
from gear_dynamics_ros.chunk import Counters
from gear_dynamics_ros.events import CHANGE, END, TIMEOUT
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.reporting.recording_text import fault_lines
from gear_dynamics_ros.reporting.windows import acting_events

OK: Final = "ok"
WARNING: Final = "warning"
UNKNOWN: Final = "unknown"  # not recorded
FindingStatus: TypeAlias = Literal["ok", "warning", "unknown"]
MOST_LINES: Final = 12  # of one subject
_PACE_COLUMN: Final = {entry.name: column for column, entry in enumerate(PACE)}


class Finding(NamedTuple):
    """Result of one check, one line of text for each thing that was found."""

    subject: str
    status: FindingStatus
    lines: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """The same for JSON."""
        return {"subject": self.subject, "status": self.status, "lines": list(self.lines)}


def find_all(recording: Recording, greatest_speed: float | None) -> list[Finding]:
    """All findings on ``recording``.

    ``greatest_speed`` is that of the driving gear in rad/s, None if it was not recorded: then that of the
    parameters counts. Raises GearboxError at a damaged message.
    """
    # Imported here, so that programs that only show their help need not wait for the compiler.
    from gear_dynamics_ros.physics.advice import sampling_warnings, step_warnings, torque_warnings

    in_force = _parameters_in_force(recording)
    return [
        _finding("recording", fault_lines(recording), f"complete, {recording.samples} samples without a gap"),
        _end(recording.events),
        _pacing(recording),
        searches_finding(recording.events),
        _finding(
            "integration step",
            _unique(line for each in in_force for line in step_warnings(each, greatest_speed)),
            _step_text(in_force[-1], greatest_speed),
        ),
        _finding(
            "torque balance",
            _unique(line for each in in_force for line in torque_warnings(each)),
            "the torques of the parameters balance, or the governor sets the drive torque",
        ),
        _finding(
            "sampling",
            _unique(
                line
                for each in in_force
                for line in sampling_warnings(
                    each, each.operation.speed if greatest_speed is None else greatest_speed
                )
            ),
            "the shortest waves of the tooth surfaces pass slower than half the sampling rate",
        ),
    ]


def _finding(subject: str, warnings: Sequence[str], otherwise: str) -> Finding:
    if not warnings:
        return Finding(subject, OK, [otherwise])
    left = len(warnings) - MOST_LINES
    return Finding(subject, WARNING, [*warnings[:MOST_LINES], *([f"and {left} more"] if left > 0 else [])])


def _unique(lines: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(lines))


def _parameters_in_force(recording: Recording) -> list[Parameters]:
    """The parameters at the start, and after each change that acts on the gearbox."""
    found = [recording.parameters]
    for event in acting_events(recording):
        if event.kind == CHANGE and event.sample >= recording.first_sample:
            changed = updated(found[-1], event.parameters)
            if changed != found[-1]:
                found.append(changed)
    return found


def _step_text(parameters: Parameters, greatest_speed: float | None) -> str:
    speed = parameters.operation.speed if greatest_speed is None else greatest_speed
    return f"{parameters.solver.step:g} s is short enough for every rate of the model up to {speed:.5g} rad/s"


def _end(events: Sequence[OperatorEvent]) -> Finding:
    """How the run ended, and whether commands stayed away."""
    ends = [event for event in events if event.kind == END]
    warnings = [
        f"no command came within operation.command_timeout at {event.time:.6f} s"
        for event in events
        if event.kind == TIMEOUT
    ]
    if not ends:
        return Finding("end of the run", UNKNOWN, [*warnings, "the recording ends before the run did"])
    reason = f"ended at {ends[-1].time:.6f} s: {ends[-1].message or 'no reason given'}"
    return Finding("end of the run", WARNING if warnings else OK, [*warnings, reason])


def _pacing(recording: Recording) -> Finding:
    subject = "real time"
    if "pacing" not in recording.recorded:
        return Finding(subject, UNKNOWN, ["not recorded: pacing is not among recording.topics"])
    pace = pacing_totals(recording)
    if pace is None:
        return Finding(subject, OK, ["not paced: it ran as fast as it could, without a clock"])
    if not pace["overruns"]:
        return Finding(subject, OK, ["no chunk was late"])
    return Finding(
        subject,
        WARNING,
        [
            f"{pace['overruns']:.0f} chunks were late, by {pace['worst_lateness']:.3g} s at most; deadlines "
            f"were put off by {pace['slipped']:.3g} s of wall time in all: simulated time is right, but who "
            "commanded the gearbox saw it slow down"
        ],
    )


def pacing_totals(recording: Recording) -> Mapping[str, float] | None:
    """Overruns, s slipped and the worst lateness in s over the recording; None without reports of the pacing.

    Raises GearboxError at a damaged message.
    """
    reports = [rows[-1] for _, rows in recording.rows("pacing")] if "pacing" in recording.recorded else []
    if not reports:
        return None
    return {
        "overruns": float(reports[-1][_PACE_COLUMN["overruns"]]),
        "slipped": float(reports[-1][_PACE_COLUMN["slipped"]]),
        "worst_lateness": max(float(report[_PACE_COLUMN["worst_lateness"]]) for report in reports),
    }


def searches_finding(events: Sequence[OperatorEvent]) -> Finding:
    """Root searches and steps that reached a limit, by the counters of the last of ``events``."""
    subject = "event searches"
    if not events:
        return Finding(subject, UNKNOWN, ["not recorded: there is no event with the counters of the run"])
    return Finding(subject, *_capped(events[-1].counters, events[-1].time))


def _capped(counters: Counters, time: float) -> tuple[FindingStatus, list[str]]:
    until = f"of {counters.events} switching events until {time:.6f} s"
    if not counters.capped:
        return OK, [f"every search {until} converged"]
    return WARNING, [
        f"{counters.capped} searches or steps {until} reached their limit of iterations or events: contacts "
        "there begin or end up to a step too late; lower solver.step"
    ]
