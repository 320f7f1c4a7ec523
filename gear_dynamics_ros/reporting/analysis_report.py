"""Analyses a recording and writes the results: a report, a summary, a list of impacts, and figures."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.run_up import RUN_UP_CHANNELS, SpeedSpectra, find_run_up
from gear_dynamics_ros.analysis.statistics import Envelope, Statistics, derived_quantities
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.recording import Recording
from gear_dynamics_ros.reporting.analysis_summary import require_finite, summarize_run, summarize_windows
from gear_dynamics_ros.reporting.recording_page import RUN, EmbeddedFigure, recording_page
from gear_dynamics_ros.reporting.windows import (
    MOST_WINDOWS,
    AnalysisWindow,
    change_times,
    choose_windows,
    window_name,
)
from gear_dynamics_ros.system.files import output_file, replace_files

SUMMARY_FILE: Final = "summary.json"
IMPACTS_FILE: Final = "impacts.csv"
REPORT_FILE: Final = "report.html"


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
    windows: Sequence[tuple[AnalysisWindow, Samples]]  # in the order of time, at least one
    run_up: SpeedSpectra | None


class FigureJob(NamedTuple):
    """One figure to draw."""

    name: str
    window: int  # its number, or RUN
    stem: str  # of its files
    draw: Callable[[], Any]


def analyze_recording(
    recording: Recording, start: float | None, end: float | None, progress: Callable[[int], None]
) -> RecordingAnalysis:
    """Read the whole recording once, and its windows into memory: ``choose_windows`` has ``start``, ``end``.

    ``progress`` is called with the number of samples read. Raises UsageError if the window is invalid or the
    waveform was not recorded, GearboxError if the recording is empty or damaged.
    """
    recording.require_topic("waveform")
    if recording.end_sample == recording.first_sample:
        raise GearboxError(f"{recording.path} holds no samples: nothing to analyse")
    changes = change_times(recording)
    chosen = choose_windows(recording, changes, start, end)
    windows = [(window, recording.window(*window.span)) for window in chosen]
    whole = _read_whole(recording, progress)
    return RecordingAnalysis(recording, changes, whole, windows, _read_run_up(recording, whole.envelope))


def write_analysis(
    analysis: RecordingAnalysis, folder: Path, progress: Callable[[int, int], None]
) -> list[Path]:
    """Write report, summary, figures (PNG, SVG) and, if recorded, impacts; returns their paths.

    Together they replace those of an earlier analysis in ``folder``; if anything fails, these stay.
    ``progress`` is called with the number of figures drawn and that of all. Raises GearboxError if a file
    can't be written or the recording is damaged.
    """
    recording = analysis.recording
    names = [REPORT_FILE, SUMMARY_FILE, IMPACTS_FILE, *_figure_files()]
    with replace_files(folder, names) as draft:
        content = summarize_run(
            recording, analysis.whole.statistics, analysis.whole.meshing, draft / IMPACTS_FILE
        )
        content.update(summarize_windows(recording, analysis.windows))
        require_finite(content, recording.path)
        drawn = list(_draw(analysis, draft, progress))
        _name_figures(content, drawn)
        _write(draft / SUMMARY_FILE, f"{json.dumps(content, indent=2, allow_nan=False)}\n".encode())
        windows = [window for window, _ in analysis.windows]
        page = recording_page(recording, analysis.whole.envelope, windows, content, drawn, left_out(analysis))
        _write(draft / REPORT_FILE, page)
    return [folder / name for name in names if (folder / name).exists()]


def figure_data(analysis: RecordingAnalysis, window: Samples) -> FigureData:
    """What the figures of ``analysis`` are drawn from, with one of its windows."""
    return FigureData(
        analysis.recording.parameters,
        analysis.whole.envelope,
        analysis.changes,
        window,
        [samples for _, samples in analysis.windows],
        analysis.whole.meshing,
        analysis.run_up,
    )


def left_out(analysis: RecordingAnalysis) -> dict[str, str]:
    """Why each figure that ``write_analysis`` doesn't draw can't be drawn."""
    from gear_dynamics_ros.analysis import figures

    return figures.lacking_figures(figure_data(analysis, analysis.windows[-1][1]))


def _write(path: Path, content: bytes) -> None:
    with output_file(path) as stream:
        stream.write(content)


def _figure_files() -> Iterator[str]:
    """Every name that the file of a figure may have, of any recording."""
    from gear_dynamics_ros.analysis import figures

    of_windows = [name for name in figures.FIGURE_NAMES if name not in figures.RUN_FIGURES]
    before = [f"{window_name(number)}_{name}" for number in range(1, MOST_WINDOWS) for name in of_windows]
    for stem in (*figures.FIGURE_NAMES, *before):
        yield from (f"{stem}.png", f"{stem}.svg")


def _draw(
    analysis: RecordingAnalysis, folder: Path, progress: Callable[[int, int], None]
) -> Iterator[EmbeddedFigure]:
    """Draw all figures into files."""
    from gear_dynamics_ros.analysis import figures

    jobs = _jobs(analysis)
    for count, job in enumerate(jobs, start=1):
        figure, drawn = job.draw(), io.BytesIO()
        figures.write_png(figure, drawn)
        picture = drawn.getvalue()
        _write(folder / f"{job.stem}.png", picture)
        with output_file(folder / f"{job.stem}.svg") as stream:
            figures.write_svg(figure, stream)
        yield EmbeddedFigure(
            job.name, job.window, f"{job.stem}.png", figures.CAPTIONS[job.name], figures.small_png(picture)
        )
        progress(count, len(jobs))


def _jobs(analysis: RecordingAnalysis) -> list[FigureJob]:
    """The figures of the run, then those of each window.

    The files of windows before the last begin with the name of the window.
    """
    from gear_dynamics_ros.analysis import figures

    of_run: list[FigureJob] = []
    of_windows: list[FigureJob] = []
    for window, samples in analysis.windows:
        last = window.number == len(analysis.windows)
        for name, draw in figures.recording_figures(figure_data(analysis, samples)).items():
            if name not in figures.RUN_FIGURES:
                stem = name if last else f"{window.name}_{name}"
                of_windows.append(FigureJob(name, window.number, stem, draw))
            elif last:
                of_run.append(FigureJob(name, RUN, name, draw))
    return [*of_run, *of_windows]


def _name_figures(content: dict[str, Any], drawn: Sequence[EmbeddedFigure]) -> None:
    """Add the files of the figures to the run and to its windows."""
    for number, entries in ((RUN, content["run"]), *enumerate(content["windows"], start=1)):
        entries["figures"] = {figure.name: figure.file for figure in drawn if figure.window == number}


def _read_whole(recording: Recording, progress: Callable[[int], None]) -> WholeRun:
    whole = WholeRun(Statistics(), Envelope(), MeshingTimeline())
    for held in recording.coverage.held:
        for samples in recording.pieces(*held):
            columns = derived_quantities(samples)
            whole.statistics.add(samples, columns)
            whole.envelope.add(samples, columns)
            whole.meshing.add(samples)
            progress(whole.statistics.samples)
    return whole


def _read_run_up(recording: Recording, envelope: Envelope) -> SpeedSpectra | None:
    """Spectra over the greatest rise or fall of the speed; None if there is none, or it is too short.

    None too if samples are missing in it.
    """
    found = find_run_up(envelope)
    if found is None or not set(RUN_UP_CHANNELS) <= set(recording.channel_names):
        return None
    first, end = recording.clip(*found.span)
    if any(gap.first < end and first < gap.end for gap in recording.coverage.gaps):
        return None
    parameters = recording.parameters
    spectra = SpeedSpectra(found, parameters.gears.driving.teeth, parameters.solver.sample_interval)
    channels = [name for name in (*RUN_UP_CHANNELS, "load_torque") if name in recording.channel_names]
    for samples in recording.blocks(*found.span, channels):
        spectra.add(samples)
    return spectra if spectra.frames else None
