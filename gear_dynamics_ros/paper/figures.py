"""The paper's figures 2 and 5 to 9 from our runs, and chaos with the published and the refined equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import FIGURE_STYLE, MICRO
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.paper.cases import (
    DIMENSIONS,
    MODELS,
    RESTITUTION_SCAN,
    RESTITUTIONS,
    ROUGHNESSES,
    speed_scan,
)
from gear_dynamics_ros.paper.measures import FORCE, PERCENT, column
from gear_dynamics_ros.paper.results import CaseResult, PaperResults
from gear_dynamics_ros.paper.tooth_profiles import (
    ToothProfile,
    profiles_over_dimension,
    profiles_over_roughness,
)
from gear_dynamics_ros.paper.waveforms import section_of
from gear_dynamics_ros.sweeps.point import spectrum_orders

COLOURS: Final = {"traditional": palette.BLUE, "compared": palette.ORANGE, "improved": palette.GREEN}
THREE: Final = (palette.BLUE, palette.ORANGE, palette.GREEN)
GEAR: Final = "driving"
SHOWN_PERIODS: Final = 8  # of the mesh, in diagrams over time
SHOWN_TEETH: Final = 3  # in the diagram of the profile
LEAST_AMPLITUDE: Final = 1e-3  # um, of spectra
SPECTRUM_ORDERS: Final = 3.0
SECTION_POINTS: Final = 200  # drawn at each speed
DOT: Final = 1.6  # points, of each of them


class PaperFigure(NamedTuple):
    """One figure: the name of its file without the suffix, what it shows, and what draws it."""

    name: str
    caption: str
    draw: Callable[[], Figure]


def paper_figures(published: PaperResults, refined: PaperResults) -> list[PaperFigure]:
    """All figures of ``published``, and one beside ``refined``."""
    at_16500 = {f"{model}, 16500 rpm": f"{model} at 16500 rpm" for model in MODELS}
    return [
        PaperFigure("paper_figure_2", "Figure 2. Tooth profiles.", lambda: profiles_figure(published)),
        PaperFigure(
            "paper_figure_5a",
            "Figure 5a. DTE at mesh phase 0 over speed (bifurcation diagram).",
            lambda: speed_bifurcation_figure([published]),
        ),
        PaperFigure(
            "paper_figure_5b",
            "Figure 5b. Spectra of DTE over speed.",
            lambda: speed_spectra_figure(published),
        ),
        PaperFigure(
            "paper_figure_5c",
            "Figure 5c. Shares of the meshing states over speed.",
            lambda: speed_shares_figure(published),
        ),
        PaperFigure(
            "paper_figure_5d",
            "Figure 5d. Largest dynamic mesh force over speed.",
            lambda: speed_ldmf_figure(published),
        ),
        PaperFigure(
            "paper_figure_6a",
            "Figure 6a. Phase portraits and Poincaré sections at 16500 rpm.",
            lambda: portraits_figure(published, at_16500),
        ),
        PaperFigure(
            "paper_figure_6b",
            "Figure 6b. Spectra of DTE at 16500 rpm.",
            lambda: lines_figure(published, at_16500),
        ),
        PaperFigure(
            "paper_figure_6c",
            "Figure 6c. Bearing contact force over penetration at 16500 rpm.",
            lambda: loops_figure(published, at_16500),
        ),
        PaperFigure(
            "paper_figure_6d",
            "Figure 6d. Bearing contact force over time at 16500 rpm.",
            lambda: forces_figure(published, at_16500),
        ),
        PaperFigure(
            "paper_figure_7",
            "Figure 7. Improved at 15000 rpm and three restitutions.",
            lambda: restitutions_figure(published),
        ),
        PaperFigure(
            "paper_figure_8",
            "Figure 8. Bearing contact force over restitution, improved at 15000 rpm.",
            lambda: force_over_restitution_figure(published),
        ),
        PaperFigure(
            "paper_figure_9",
            "Figure 9. Improved at 15500 rpm: three roughnesses (top), three fractal dimensions (bottom).",
            lambda: surfaces_figure(published),
        ),
        PaperFigure(
            "paper_refined",
            "DTE at mesh phase 0 over speed: published equations (left), refined ones (right).",
            lambda: speed_bifurcation_figure([published, refined]),
        ),
    ]


def drawn(figure: PaperFigure) -> Figure:
    """``figure`` in the style of all figures."""
    with mpl.rc_context(cast(Any, FIGURE_STYLE)):  # its stub wants a literal for every key
        made = figure.draw()
        made.canvas.draw()
        return made


def profiles_figure(results: PaperResults) -> Figure:
    """Tooth profiles over some teeth: three roughnesses, three fractal dimensions."""
    parameters = results.parameter_set.parameters
    figure = Figure(figsize=(10.0, 7.6), layout="constrained")
    columns = figure.subplots(3, 2, sharex=True, sharey="col").T
    rough, fractal = profiles_over_roughness(parameters), profiles_over_dimension(parameters)
    for axes, profiles in zip(columns, (rough, fractal), strict=True):
        for axis, profile, colour in zip(axes, profiles, THREE, strict=True):
            _draw_profile(axis, profile, parameters.gears.driving.teeth, colour)
        axes[-1].set_xlabel("position (tooth pitches)")
    return figure


def _draw_profile(axis: Axes, profile: ToothProfile, teeth: int, colour: str) -> None:
    pitches = np.linspace(0.0, SHOWN_TEETH, 4000)
    heights = np.abs(profile.profile.height(2.0 * math.pi * pitches / teeth))
    axis.plot(pitches, MICRO * heights, color=colour, linewidth=0.8)
    axis.set_ylabel("height |z| (µm)")
    axis.set_title(
        f"Ra {MICRO * profile.roughness:g} µm, D {profile.fractal_dimension:g}: "
        f"{profile.peaks_per_tooth:.1f} peaks a tooth, mean height {MICRO * profile.peak_height:.2f} µm"
    )


def speed_bifurcation_figure(sets: Sequence[PaperResults]) -> Figure:
    """DTE at mesh phase 0 over speed: a row for each model, a column for each of ``sets``."""
    figure = Figure(figsize=(10.0, 9.0), layout="constrained")
    axes = figure.subplots(len(MODELS), len(sets), sharex=True, sharey=True, squeeze=False)
    for row, model in zip(axes, MODELS, strict=True):
        for axis, results in zip(row, sets, strict=True):
            _draw_bifurcation(axis, results.scan(speed_scan(model)), COLOURS[model])
            extra = f", {results.parameter_set.title}" if len(sets) > 1 else ""
            axis.set_title(f"{model}{extra}")
        row[0].set_ylabel("DTE at mesh phase 0 (µm)")
    for axis in axes[-1]:
        axis.set_xlabel("speed (rpm)")
    return figure


def _draw_bifurcation(axis: Axes, scan: Sequence[CaseResult], colour: str) -> None:
    for result in scan:
        points = MICRO * result.point.arrays["section_dte"][-SECTION_POINTS:]
        speeds = np.full(len(points), result.case.speed)
        axis.plot(speeds, points, ".", color=colour, markersize=DOT, markeredgewidth=0, rasterized=True)


def speed_spectra_figure(results: PaperResults) -> Figure:
    """Amplitude of DTE over speed and mesh order, one panel a model."""
    figure = Figure(figsize=(10.0, 9.6), layout="constrained")
    axes = figure.subplots(len(MODELS), 1, sharex=True)
    orders = spectrum_orders(results.effort.measurement.keep)
    shown = orders <= SPECTRUM_ORDERS
    for axis, model in zip(axes, MODELS, strict=True):
        scan = results.scan(speed_scan(model))
        speeds = np.array([result.case.speed for result in scan])
        amplitudes = MICRO * np.array([result.point.arrays["dte_spectrum"][shown] for result in scan])
        mesh = axis.pcolormesh(
            speeds,
            orders[shown],
            np.maximum(amplitudes, LEAST_AMPLITUDE).T,
            norm=LogNorm(LEAST_AMPLITUDE * 10.0, 20.0),
            cmap="viridis",
            shading="nearest",
            rasterized=True,
        )
        axis.grid(visible=False)
        axis.set_title(model)
        axis.set_ylabel("mesh order")
    axes[-1].set_xlabel("speed (rpm)")
    figure.colorbar(mesh, ax=list(axes), label="amplitude of DTE (µm)", extend="both")
    return figure


def speed_shares_figure(results: PaperResults) -> Figure:
    """Shares of time on the drive flank, apart, and on the back flank over speed."""
    figure = Figure(figsize=(10.0, 8.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    kinds = (
        ("drive_share", "on the drive flank"),
        ("apart_share", "apart"),
        ("back_share", "on the back flank"),
    )
    for axis, (name, title) in zip(axes, kinds, strict=True):
        _draw_scalar(axis, results, name, PERCENT)
        axis.set_ylabel("share of time (%)")
        axis.set_title(title)
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("speed (rpm)")
    return figure


def speed_ldmf_figure(results: PaperResults) -> Figure:
    """Largest dynamic mesh force over the static one, over speed."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axis = figure.subplots()
    _draw_scalar(axis, results, "ldmf", 1.0)
    axis.set_ylabel("LDMF: largest mesh force / static one")
    axis.set_xlabel("speed (rpm)")
    axis.legend(loc="upper right")
    return figure


def _draw_scalar(axis: Axes, results: PaperResults, name: str, scale: float) -> None:
    for model in MODELS:
        scan = results.scan(speed_scan(model))
        speeds = [result.case.speed for result in scan]
        axis.plot(speeds, scale * column(scan, name), color=COLOURS[model], linewidth=0.9, label=model)


def portraits_figure(results: PaperResults, cases: Mapping[str, str]) -> Figure:
    """Phase portrait and Poincaré section of each of ``cases``, titles to names."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    axes = figure.subplots(1, len(cases), sharex=True, sharey=True)
    for axis, name, colour in _panels(axes, cases):
        _draw_portrait(axis, results.waveforms.get(name), colour)
    axes[0].set_ylabel("rate of DTE (m/s)")
    return figure


def _panels(axes: Sequence[Axes], cases: Mapping[str, str]) -> Iterator[tuple[Axes, str, str]]:
    """Axis, case and colour of each of ``cases``, titles to names; the axis gets its title."""
    for axis, (title, name), colour in zip(axes, cases.items(), THREE, strict=True):
        axis.set_title(title)
        yield axis, name, colour


def _draw_portrait(axis: Axes, samples: Samples | None, colour: str) -> None:
    axis.set_xlabel("DTE (µm)")
    if samples is None:
        _nothing(axis)
        return
    axis.plot(MICRO * samples["dte"], samples["dte_rate"], color=colour, linewidth=0.3, alpha=0.5)
    points = section_of(samples, "dte", "dte_rate")
    axis.plot(MICRO * points[:, 0], points[:, 1], ".", color="black", markersize=2.5)


def _nothing(axis: Axes) -> None:
    axis.text(0.5, 0.5, "the run ended early", transform=axis.transAxes, ha="center", color="#666666")


def lines_figure(results: PaperResults, cases: Mapping[str, str]) -> Figure:
    """Spectrum of DTE of each of ``cases``, titles to names."""
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    axes = figure.subplots(len(cases), 1, sharex=True, sharey=True)
    for axis, name, colour in _panels(axes, cases):
        _draw_lines(axis, results, name, colour)
        axis.set_ylabel("amplitude of DTE (µm)")
    axes[-1].set_xlabel("mesh order")
    return figure


def _draw_lines(axis: Axes, results: PaperResults, name: str, colour: str) -> None:
    orders = spectrum_orders(results.effort.measurement.keep)
    shown = (orders > 0.0) & (orders <= SPECTRUM_ORDERS)
    amplitudes = MICRO * results.at(name).point.arrays["dte_spectrum"][shown]
    axis.semilogy(orders[shown], np.maximum(amplitudes, LEAST_AMPLITUDE), color=colour, linewidth=0.8)
    axis.set_ylim(LEAST_AMPLITUDE, 30.0)


def loops_figure(results: PaperResults, cases: Mapping[str, str]) -> Figure:
    """Bearing contact force over penetration of each of ``cases``, titles to names."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    axes = figure.subplots(1, len(cases))
    for axis, name, colour in _panels(axes, cases):
        _draw_loop(axis, results.waveforms.get(name), colour)
    axes[0].set_ylabel("bearing contact force (N)")
    return figure


def _draw_loop(axis: Axes, samples: Samples | None, colour: str) -> None:
    axis.set_xlabel("penetration (µm)")
    if samples is None:
        _nothing(axis)
        return
    penetration = samples[f"{GEAR}_penetration"]
    touching = np.where(penetration >= 0.0, MICRO * penetration, np.nan)
    axis.plot(touching, samples.contact_force(GEAR), color=colour, linewidth=0.4, alpha=0.7)


def forces_figure(results: PaperResults, cases: Mapping[str, str]) -> Figure:
    """Bearing contact force over time of each of ``cases``, titles to names."""
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    axes = figure.subplots(len(cases), 1, sharex=True)
    titled = {f"{title} (dashed: T_M / r_b)": name for title, name in cases.items()}
    for axis, name, colour in _panels(axes, titled):
        samples = results.waveforms.get(name)
        if samples is None:
            _nothing(axis)
        else:
            periods, shown = _last_periods(samples)
            axis.plot(periods, shown.contact_force(GEAR), color=colour)
            axis.set_xlim(0.0, SHOWN_PERIODS)
        axis.axhline(results.static_force, color=palette.GREY, linewidth=0.9, linestyle="--")
        axis.set_ylabel("bearing contact\nforce (N)")
    axes[-1].set_xlabel("time (mesh periods)")
    return figure


def _last_periods(samples: Samples) -> tuple[np.ndarray[Any, np.dtype[np.float64]], Samples]:
    """Time in mesh periods from a mesh phase 0 on, and the samples of the last SHOWN_PERIODS."""
    turns = np.unwrap(samples["mesh_phase"]) / (2.0 * math.pi)
    first = math.floor(turns[-1]) - SHOWN_PERIODS
    count = int(np.count_nonzero(turns >= first))
    return turns[-count:] - first, samples.last(count)


def restitutions_figure(results: PaperResults) -> Figure:
    """DTE over time, its spectrum, phase portrait and bearing loop at each of RESTITUTIONS."""
    names = {f"restitution {eta:g}": f"restitution {eta:g}" for eta in RESTITUTIONS}
    figure = Figure(figsize=(11.0, 12.0), layout="constrained")
    axes = figure.subplots(4, len(names), sharey="row")
    for number, ((title, name), colour) in enumerate(zip(names.items(), THREE, strict=True)):
        samples = results.waveforms.get(name)
        time, lines, portrait, loop = axes[:, number]
        _draw_channel(time, samples, "dte", MICRO, colour)
        _draw_lines(lines, results, name, colour)
        lines.set_xlabel("mesh order")
        _draw_portrait(portrait, samples, colour)
        _draw_loop(loop, samples, colour)
        time.set_title(title)
    labels = "DTE (µm)", "amplitude of DTE (µm)", "rate of DTE (m/s)", "bearing contact force (N)"
    for axis, label in zip(axes[:, 0], labels, strict=True):
        axis.set_ylabel(label)
    return figure


def _draw_channel(axis: Axes, samples: Samples | None, channel: str, scale: float, colour: str) -> None:
    axis.set_xlabel("time (mesh periods)")
    if samples is None:
        _nothing(axis)
        return
    periods, shown = _last_periods(samples)
    axis.plot(periods, scale * shown[channel], color=colour)
    axis.set_xlim(0.0, SHOWN_PERIODS)
    axis.ticklabel_format(axis="y", useOffset=False)


def force_over_restitution_figure(results: PaperResults) -> Figure:
    """Least, mean and largest bearing contact force over restitution, each over its greatest value."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axis = figure.subplots()
    scan = results.scan(RESTITUTION_SCAN)
    etas = [result.case.restitution or 0.0 for result in scan]
    kinds = (
        ("max", "largest", palette.ORANGE),
        ("mean", "mean", palette.BLUE),
        ("min", "least", palette.GREEN),
    )
    for kind, label, colour in kinds:
        values = column(scan, f"{FORCE}_{kind}")
        greatest = float(np.nanmax(values))
        shown = values / greatest if greatest > 0.0 else values
        axis.plot(etas, shown, ".-", color=colour, label=f"{label}, of {greatest:.1f} N")
    axis.axvline(0.08, color=palette.GREY, linewidth=0.9, linestyle="--")
    axis.set_xlabel("restitution (dashed: 0.08, where the paper has the peaks)")
    axis.set_ylabel("bearing contact force / its greatest")
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def surfaces_figure(results: PaperResults) -> Figure:
    """DTE over time, its spectrum, phase portrait and pressure angle over roughness and over dimension."""
    rough = {f"Ra {MICRO * r:g} µm": f"roughness {MICRO * r:g} um" for r in ROUGHNESSES}
    fractal = {f"D {dimension:g}": f"dimension {dimension:g}" for dimension in DIMENSIONS}
    figure = Figure(figsize=(13.0, 12.0), layout="constrained")
    axes = figure.subplots(6, 4)
    cases = [*rough.items(), *fractal.items()]
    for row, (title, name), colour in zip(axes, cases, (*THREE, *THREE), strict=True):
        samples = results.waveforms.get(name)
        time, lines, portrait, angle = row
        _draw_channel(time, samples, "dte", MICRO, colour)
        _draw_lines(lines, results, name, colour)
        _draw_portrait(portrait, samples, colour)
        _draw_channel(angle, samples, "pressure_angle", 180.0 / math.pi, colour)
        time.set_ylabel("DTE (µm)")
        time.set_title(title)
        lines.set_ylabel("DTE (µm)")
        lines.set_xlabel("mesh order")
        portrait.set_ylabel("rate (m/s)")
        angle.set_ylabel("pressure angle\n(deg)")
    for column_of_axes in axes.T:
        _share_limits(column_of_axes)
    return figure


def _share_limits(axes: Sequence[Axes]) -> None:
    """Give ``axes`` the same limits of y, so that they can be compared."""
    limits = np.array([axis.get_ylim() for axis in axes])
    for axis in axes:
        axis.set_ylim(limits[:, 0].min(), limits[:, 1].max())
