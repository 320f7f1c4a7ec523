"""The numbers of a recording and its windows as one mapping for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gear_dynamics_ros
from gear_dynamics_ros.analysis import ledger, summary
from gear_dynamics_ros.analysis.energy_flow import energy_flow
from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.statistics import Statistics
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import RESET, RESTORE
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.reporting.findings import find_all, pacing_totals
from gear_dynamics_ros.reporting.windows import AnalysisWindow, whole_span
from gear_dynamics_ros.system.files import output_file


def summarize_run(
    recording: Recording, whole: Statistics, meshing: MeshingTimeline, impacts: Path
) -> dict[str, Any]:
    """What ``recording`` is and does as a whole; ``whole`` and ``meshing`` are of all its samples.

    Writes the list of impacts to ``impacts`` if they were recorded. Raises GearboxError if that can't be
    written, or at a damaged message.
    """
    span = whole_span(recording)
    balance = _energy_balance(recording)
    listed = "impacts" in recording.recorded
    return {
        "recording": str(recording.path),
        "complete": recording.complete,
        "version": recording.version,
        "kernel_hash": recording.kernel_hash,
        "model": recording.parameters.model,
        "duration": span.end - span.start,
        "samples": recording.end_sample - recording.first_sample,
        "sample_interval": recording.parameters.solver.sample_interval,
        "commands": len(recording.commands),
        "events": [_event_to_json(event) for event in recording.events],
        "analyzed_by": gear_dynamics_ros.__version__,
        "node": recording.node,
        "provenance": recording.run.provenance._asdict(),
        "findings": [finding.to_json() for finding in find_all(recording, _greatest_speed(whole))],
        "pacing": pacing_totals(recording),
        "run": {
            **summary.summarize_statistics(whole, span, recording.parameters),
            "meshing_time": _time_shares(meshing),
        },
        "energy": balance,
        "energy_flow": energy_flow(balance).to_json() if balance else None,
        "impacts": _write_impacts(recording, impacts) if listed else None,
    }


def summarize_windows(
    recording: Recording, windows: Sequence[tuple[AnalysisWindow, Samples]]
) -> dict[str, Any]:
    """``windows`` in the order of time; ``window`` is the last of them, without what tells them apart."""
    numbers = [summary.summarize_window(samples, recording.parameters) for _, samples in windows]
    impacts = _impacts_in(recording, [window for window, _ in windows])
    return {
        "window": numbers[-1],
        "windows": [
            {
                "name": window.name,
                "kind": window.kind,
                "commands": window.commands._asdict() if window.commands else None,
                **entries,
                "meshing_time": _time_shares(_meshing_of(samples)),
                "impacts": totals,
            }
            for (window, samples), entries, totals in zip(windows, numbers, impacts, strict=True)
        ],
    }


def _meshing_of(samples: Samples) -> MeshingTimeline:
    meshing = MeshingTimeline()
    meshing.add(samples)
    return meshing


def _time_shares(meshing: MeshingTimeline) -> dict[str, Any] | None:
    """Shares of time in each meshing state, and whether they come from the instants of the contacts."""
    shares = meshing.shares()
    return {**shares._asdict(), "from_events": meshing.from_events} if shares else None


def require_finite(content: Any, path: Path, name: str = "") -> None:
    """Raise GearboxError, naming the entry, if a number in ``content`` is not finite: no run records one."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            require_finite(value, path, f"{name}.{key}" if name else str(key))
    elif isinstance(content, list):
        for number, value in enumerate(content):
            require_finite(value, path, f"{name}[{number}]")
    elif isinstance(content, float) and not math.isfinite(content):
        raise GearboxError(
            f"{path}: {name} is {content}, because the recording has a value that is not finite: "
            "replay verify finds the sample"
        )


def _greatest_speed(whole: Statistics) -> float | None:
    speed = whole.totals().get("driving_speed")
    return max(abs(speed.minimum), abs(speed.maximum)) if speed else None


def _event_to_json(event: OperatorEvent) -> dict[str, Any]:
    """The event without the checkpoint of a restore, which is in the recording."""
    entries = event._asdict()
    del entries["checkpoint"]
    entries["parameters"] = dict(event.parameters)
    return entries


def _energy_balance(recording: Recording) -> dict[str, Any] | None:
    """Energy balance over the whole recording; None if it has no energies."""
    resets = [event.sample for event in recording.events if event.kind in (RESET, RESTORE)]
    balance = ledger.EnergyLedger(resets)
    for time_ns, rows in recording.rows("energy"):
        balance.add(recording.sample_of(time_ns) + 1, rows[0])
    return balance.to_json(recording.parameters.solver.sample_interval, recording.parameters)


def _write_impacts(recording: Recording, path: Path) -> dict[str, Any]:
    """Write the list of impacts to ``path``; returns the totals by bearing."""
    totals = ledger.ImpactTotals(recording.parameters.bearings.minimum_impact_speed)
    with output_file(path) as stream:
        stream.write(f"{ledger.CSV_HEADER}\n".encode())
        for _, rows in recording.rows("impacts"):
            totals.add(rows)
            stream.write("".join(ledger.csv_lines(rows)).encode())
    return {"list": path.name, **totals.to_json()}


def _impacts_in(recording: Recording, windows: Sequence[AnalysisWindow]) -> list[dict[str, Any] | None]:
    """Totals by bearing of the impacts that ended in each window; None if they were not recorded."""
    if "impacts" not in recording.recorded:
        return [None for _ in windows]
    least = recording.parameters.bearings.minimum_impact_speed
    totals = [ledger.ImpactTotals(least) for _ in windows]
    column = ledger.IMPACT_COLUMN["end"]
    for _, rows in recording.rows("impacts"):
        for total, window in zip(totals, windows, strict=True):
            ends = rows[:, column]
            total.add(rows[(ends >= window.span.start) & (ends < window.span.end)])
    return [total.to_json() for total in totals]
