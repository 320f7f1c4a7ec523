"""Analyses a recording and writes the results: a summary, a list of impacts, and figures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.analysis import ledger, summary
from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.run_up import RUN_UP_CHANNELS, SpeedSpectra, find_run_up
from gear_dynamics_ros.analysis.statistics import Envelope, Statistics, derived_quantities
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import RESET, RESTORE
from gear_dynamics_ros.recording import OperatorEvent, Recording
from gear_dynamics_ros.reporting.windows import change_times, choose_window, whole_span
from gear_dynamics_ros.system.files import output_file, replace_files

SUMMARY_FILE: Final = "summary.json"
IMPACTS_FILE: Final = "impacts.csv"


class WholeRun(NamedTuple):
    """Results of one pass through a whole recording."""

    statistics: Statistics
    envelope: Envelope
    meshing: MeshingTimeline


class RecordingAnalysis(NamedTuple):
    """Data for the summary and the figures of a recording."""

    recording: Recording
    changes: Sequence[float]  # times of commands and events, s
    whole: WholeRun
    window: Samples
    run_up: SpeedSpectra | None


def analyze_recording(
    recording: Recording, start: float | None, end: float | None, progress: Callable[[int], None]
) -> RecordingAnalysis:
    """Read the whole recording once, and the window from ``start`` to before ``end`` (s) into memory.

    Without ``start`` and ``end``, the window is the latest steady one. ``progress`` is called with the number
    of samples read. Raises UsageError if the window is invalid or the waveform was not recorded, GearboxError
    if the recording is empty or damaged.
    """
    recording.require_topic("waveform")
    if recording.end_sample == recording.first_sample:
        raise GearboxError(f"{recording.path} holds no samples: nothing to analyse")
    changes = change_times(recording)
    window = recording.window(*choose_window(recording, changes, start, end))
    whole = _read_whole(recording, progress)
    return RecordingAnalysis(recording, changes, whole, window, _read_run_up(recording, whole.envelope))


def write_analysis(
    analysis: RecordingAnalysis, folder: Path, progress: Callable[[int, int], None]
) -> list[Path]:
    """Write SUMMARY_FILE, IMPACTS_FILE if impacts were recorded, and figures (PNG, SVG); returns their paths.

    Together they replace those of an earlier analysis in ``folder``; if anything fails, these stay.
    ``progress`` is called with the number of figures drawn and that of all. Raises GearboxError if a file
    can't be written or the recording is damaged.
    """
    from gear_dynamics_ros.analysis import figures

    names = [
        SUMMARY_FILE,
        IMPACTS_FILE,
        *(file for name in figures.FIGURE_NAMES for file in _figure_files(name)),
    ]
    with replace_files(folder, names) as draft:
        _write_numbers(analysis, draft)
        drawings = figures.recording_figures(figure_data(analysis))
        for count, (name, draw) in enumerate(drawings.items(), start=1):
            figure = draw()
            for file, write in zip(_figure_files(name), (figures.write_png, figures.write_svg), strict=True):
                with output_file(draft / file) as stream:
                    write(figure, stream)
            progress(count, len(drawings))
    return [folder / name for name in names if (folder / name).exists()]


def figure_data(analysis: RecordingAnalysis) -> FigureData:
    """What the figures of ``analysis`` are drawn from."""
    return FigureData(
        analysis.recording.parameters,
        analysis.whole.envelope,
        analysis.changes,
        analysis.window,
        [analysis.window],
        analysis.whole.meshing,
        analysis.run_up,
    )


def left_out(analysis: RecordingAnalysis) -> dict[str, str]:
    """Why each figure that ``write_analysis`` doesn't draw can't be drawn."""
    from gear_dynamics_ros.analysis import figures

    return figures.lacking_figures(figure_data(analysis))


def _figure_files(name: str) -> tuple[str, str]:
    return f"{name}.png", f"{name}.svg"


def _write_numbers(analysis: RecordingAnalysis, folder: Path) -> None:
    content = _summary(analysis)
    content["energy"], content["impacts"] = _energy_balance(analysis.recording), None
    if "impacts" in analysis.recording.recorded:
        content["impacts"] = _write_impacts(analysis.recording, folder / IMPACTS_FILE)
    _require_finite(content, analysis.recording.path)
    with output_file(folder / SUMMARY_FILE) as stream:
        stream.write(f"{json.dumps(content, indent=2, allow_nan=False)}\n".encode())


def _require_finite(summary: Mapping[str, Any], path: Path, prefix: str = "") -> None:
    """Raise GearboxError, naming the entry, if a number in ``summary`` is not finite: no run records one."""
    for name, value in summary.items():
        if isinstance(value, Mapping):
            _require_finite(value, path, f"{prefix}{name}.")
        elif isinstance(value, float) and not math.isfinite(value):
            raise GearboxError(
                f"{path}: {prefix}{name} is {value}, because the recording has a value that is not finite: "
                "replay verify finds the sample"
            )


def _read_whole(recording: Recording, progress: Callable[[int], None]) -> WholeRun:
    whole = WholeRun(Statistics(), Envelope(), MeshingTimeline())
    for samples in recording.blocks():
        columns = derived_quantities(samples)
        whole.statistics.add(samples, columns)
        whole.envelope.add(samples, columns)
        whole.meshing.add(samples)
        progress(whole.statistics.samples)
    return whole


def _read_run_up(recording: Recording, envelope: Envelope) -> SpeedSpectra | None:
    """Spectra over the greatest rise or fall of the speed; None if there is none, or it is too short."""
    found = find_run_up(envelope)
    if found is None or not set(RUN_UP_CHANNELS) <= set(recording.channel_names):
        return None
    parameters = recording.parameters
    spectra = SpeedSpectra(found, parameters.gears.driving.teeth, parameters.solver.sample_interval)
    channels = [name for name in (*RUN_UP_CHANNELS, "load_torque") if name in recording.channel_names]
    for samples in recording.blocks(*found.span, channels):
        spectra.add(samples)
    return spectra if spectra.frames else None


def _summary(analysis: RecordingAnalysis) -> dict[str, Any]:
    recording = analysis.recording
    span = whole_span(recording)
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
        "run": summary.summarize_statistics(analysis.whole.statistics, span, recording.parameters),
        "window": summary.summarize_window(analysis.window, recording.parameters),
    }


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
