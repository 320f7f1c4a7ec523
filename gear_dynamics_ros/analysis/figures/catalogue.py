"""The figures of a recording: what each shows, what it needs, and what to look for."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from matplotlib.figure import Figure

from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.figures.journal_motion import bearing_force_figure, orbits_figure
from gear_dynamics_ros.analysis.figures.meshing_shares import meshing_shares_figure
from gear_dynamics_ros.analysis.figures.order_map import order_map_figure
from gear_dynamics_ros.analysis.figures.overview import ends_of, overview_figure, shown_panels
from gear_dynamics_ros.analysis.figures.phase_portrait import phase_portrait_figure
from gear_dynamics_ros.analysis.figures.spectrum import spectrum_figure
from gear_dynamics_ros.analysis.figures.time_series import pressure_angle_figure, time_series_figure
from gear_dynamics_ros.analysis.run_up import LEAST_CHANGE, RUN_UP_CHANNELS
from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES
from gear_dynamics_ros.channels import GEARS, contact_channels


class RecordingFigure(NamedTuple):
    """One figure of a recording."""

    name: str
    caption: str
    lacking: Callable[[FigureData], str]  # why it can't be drawn; empty if it can
    draw: Callable[[FigureData], Figure]


def _lacking_channels(*names: str) -> Callable[[FigureData], str]:
    """Names what is missing of the channels ``names``."""

    def lacking(data: FigureData) -> str:
        missing = [name for name in names if not data.window.has(name)]
        return f"not recorded: {', '.join(missing)}" if missing else ""

    return lacking


def _lacking_spectrum(data: FigureData) -> str:
    count = len(data.window)
    few = f"the window has {count} samples, a spectrum needs {MIN_SAMPLES}" if count < MIN_SAMPLES else ""
    return _lacking_channels("dte")(data) or few


def _lacking_shares(data: FigureData) -> str:
    return (
        "" if data.meshing.shares() else "not recorded: dte and half_backlash, or meshing_state, or too short"
    )


def _lacking_run_up(data: FigureData) -> str:
    if data.run_up is not None:
        return ""
    return _lacking_channels(*RUN_UP_CHANNELS)(data) or (
        f"no run-up: the speed neither rises nor falls steadily by {100 * LEAST_CHANGE:.0f} % of its maximum"
    )


def _draw_order_map(data: FigureData) -> Figure:
    if data.run_up is None:
        raise ValueError("the run has no run-up")
    return order_map_figure(data.run_up, data.parameters)


_OF_THE_RUN: Final = (
    RecordingFigure(
        "overview",
        "The whole run, minimum and maximum of each interval, so that no peak is lost. Look for what follows "
        "each command or event (grey): where the band of the DTE widens, teeth or journals have begun to "
        "come apart; where the mesh force touches zero, contact was lost.",
        lambda data: "" if shown_panels(data.envelope) else "not recorded: any of its channels",
        lambda data: overview_figure(data.envelope, data.changes, [ends_of(w) for w in data.windows]),
    ),
    RecordingFigure(
        "meshing_shares",
        "Shares of time on the drive flank, apart and on the back flank, over the run and in each window "
        "(framed). The instants of contact are interpolated between samples; contacts shorter than a sample "
        "interval are missed. Look for a back flank (hatched): the teeth rattle through the whole backlash.",
        _lacking_shares,
        lambda data: meshing_shares_figure(data.meshing, data.changes, data.windows),
    ),
    RecordingFigure(
        "order_map",
        "Amplitude of the DTE over speed and frequency in the largest run-up or coast-down of the run, with "
        "rays at mesh orders (dashed, halves dotted) and level lines at the natural frequencies of the model "
        "linearised at the mean load. Look for where a ray crosses a level line: a bright spot there is a "
        "resonance. Lost contact softens the teeth, so it comes at lower speeds. Light along the dotted rays "
        "is a motion of two mesh periods.",
        _lacking_run_up,
        _draw_order_map,
    ),
)
_OF_A_WINDOW: Final = (
    RecordingFigure(
        "time_series",
        "The last mesh periods of the window, sample by sample. The teeth touch where the DTE is above the "
        "drive flank or below the back flank, and are apart between them. Look for mesh forces that return "
        "from zero with a peak (impacts of the teeth), and for bearing contact forces of zero (the "
        "journal has left its bearing).",
        _lacking_channels("dte"),
        lambda data: time_series_figure(data.window, data.parameters),
    ),
    RecordingFigure(
        "pressure_angle",
        "Working pressure angle and angle of the line of centres, which move with the journals: the line of "
        "action turns by both. Look for how far they leave the nominal values (dashed), and whether they "
        "move with each tooth or slowly.",
        _lacking_channels("pressure_angle"),
        lambda data: pressure_angle_figure(data.window, data.parameters),
    ),
    RecordingFigure(
        "spectrum",
        "Amplitude of the DTE over frequency; the upper axis counts orders of the mesh frequency. A motion "
        "of the mesh period has lines at whole orders only. Look for lines between them: at halves or thirds "
        "the motion takes 2 or 3 mesh periods, a raised floor means a chaotic motion.",
        _lacking_spectrum,
        lambda data: spectrum_figure(data.window),
    ),
    RecordingFigure(
        "phase_portrait",
        "Rate of the DTE over DTE, with one point for each mesh period (Poincaré section). One point is a "
        "motion of the mesh period, n points one of n periods, a closed line a quasi-periodic and a cloud a "
        "chaotic motion. Look where the curve crosses a flank: there contact begins or ends.",
        _lacking_channels("dte", "dte_rate"),
        lambda data: phase_portrait_figure(data.window),
    ),
    RecordingFigure(
        "orbits",
        "Path of each journal's centre, in its bearing (above) and enlarged (below). Outside the clearance "
        "circle the journal presses into the bearing, inside it flies free. Look for paths that leave the "
        "circle and come back: each return is an impact.",
        _lacking_channels(*(f"{gear}_{axis}" for gear in GEARS for axis in "xy")),
        lambda data: orbits_figure(data.window, data.parameters),
    ),
    RecordingFigure(
        "bearing_force",
        "Contact force over penetration of each bearing. Loading runs above unloading, and the area between "
        "them is the energy that the contact dissipates, given as the mean of a mesh period. Look for wide "
        "loops (much damping) and for loops that begin and end at zero (impacts, not a lasting contact).",
        _lacking_channels(
            *(name for gear in GEARS for name in (f"{gear}_penetration", *contact_channels(gear)))
        ),
        lambda data: bearing_force_figure(data.window),
    ),
)
RECORDING_FIGURES: Final = (*_OF_THE_RUN, *_OF_A_WINDOW)
RUN_FIGURES: Final = tuple(figure.name for figure in _OF_THE_RUN)  # the same for every window
FIGURE_NAMES: Final = tuple(figure.name for figure in RECORDING_FIGURES)
CAPTIONS: Final[Mapping[str, str]] = {figure.name: figure.caption for figure in RECORDING_FIGURES}


def recording_figures(data: FigureData) -> dict[str, Callable[[], Figure]]:
    """What draws each of FIGURE_NAMES, without those in ``lacking_figures``."""
    return {
        figure.name: functools.partial(figure.draw, data)
        for figure in RECORDING_FIGURES
        if not figure.lacking(data)
    }


def lacking_figures(data: FigureData) -> dict[str, str]:
    """Why each of FIGURE_NAMES that can't be drawn can't be."""
    reasons = {figure.name: figure.lacking(data) for figure in RECORDING_FIGURES}
    return {name: reason for name, reason in reasons.items() if reason}
