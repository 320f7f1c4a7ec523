"""Figures of a run. Each is a matplotlib Figure drawn without pyplot or any other global state."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any, BinaryIO, Final, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from PIL import Image

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.comparison import ChannelDifference
from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES, amplitude_spectrum
from gear_dynamics_ros.analysis.statistics import Envelope, bearing_force_name
from gear_dynamics_ros.analysis.summary import QUANTITY_UNITS, observed_mesh_frequency, poincare_section
from gear_dynamics_ros.channels import GEARS, contact_channels, film_channels
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import Parameters

MICRO: Final = 1e6
KILO: Final = 1e-3
SERIES_PERIODS: Final = 12  # mesh periods in the time series
SERIES_MIN_SAMPLES: Final = 60
SERIES_SAMPLES: Final = 500  # where the mesh frequency isn't known
DOTTED_SAMPLES: Final = 400  # up to this number every sample gets a dot
MIN_HALF_SIDE: Final = 1.5  # of a close view of an orbit, um
ORBIT_SAMPLES: Final = 20_000  # drawn of orbits and phase portrait
LOOP_SAMPLES: Final = 5_000  # drawn of force over penetration
DYNAMIC_RANGE: Final = 1e5  # of the spectrum's amplitude axis
ORDERS: Final = 5.5  # mesh orders on the spectrum's frequency axis
MAX_CHANGE_LINES: Final = 40  # changes marked by a line each; above that, by ticks

FIGURE_STYLE: Final[dict[str, Any]] = {
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#222222",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.7,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.dpi": 140,
    "agg.path.chunksize": 20000,
}
GEAR_COLOURS: Final = {"driving": palette.BLUE, "driven": palette.ORANGE}


class OverviewCurve(NamedTuple):
    """One quantity in a panel of the overview."""

    name: str
    label: str
    colour: str


class OverviewPanel(NamedTuple):
    """One panel of the overview: ``scale`` turns SI units into those of ``axis_label``."""

    axis_label: str
    scale: float
    curves: tuple[OverviewCurve, ...]


OVERVIEW_PANELS: Final = (
    OverviewPanel(
        "speed\n(rad/s)",
        1.0,
        (
            OverviewCurve("driving_speed", "driving", palette.BLUE),
            OverviewCurve("driven_speed", "driven", palette.ORANGE),
        ),
    ),
    OverviewPanel(
        "torque\n(N m)",
        1.0,
        (
            OverviewCurve("drive_torque", "drive", palette.BLUE),
            OverviewCurve("load_torque", "load", palette.ORANGE),
        ),
    ),
    OverviewPanel("DTE\n(µm)", MICRO, (OverviewCurve("dte", "", palette.BLUE),)),
    OverviewPanel("mesh force\n(kN)", KILO, (OverviewCurve("mesh_force", "", palette.BLUE),)),
    OverviewPanel(
        "bearing force\n(kN)",
        KILO,
        tuple(OverviewCurve(bearing_force_name(gear), gear, GEAR_COLOURS[gear]) for gear in GEARS),
    ),
    OverviewPanel(
        "penetration\n(µm)",
        MICRO,
        tuple(OverviewCurve(f"{gear}_penetration", gear, GEAR_COLOURS[gear]) for gear in GEARS),
    ),
)


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """``draw`` with FIGURE_STYLE in force while it runs."""

    def wrapper(*args: Any, **keywords: Any) -> Figure:
        with mpl.rc_context(cast(Any, FIGURE_STYLE)):  # its stub wants a literal for every key
            return draw(*args, **keywords)

    return wrapper


def write_png(figure: Figure, stream: BinaryIO) -> None:
    """Write ``figure`` to ``stream``. Raises OSError if that fails."""
    figure.savefig(stream, format="png")


def write_small_png(figure: Figure, stream: BinaryIO) -> None:
    """As ``write_png``, in 128 colours: a third of the size, for pictures that documents show."""
    with io.BytesIO() as drawn:
        write_png(figure, drawn)
        picture = Image.open(drawn).convert("RGB")
    small = picture.quantize(colors=128, dither=Image.Dither.NONE)
    small.save(stream, format="PNG", optimize=True)


@styled
def overview_figure(envelope: Envelope, changes: Sequence[float], window: tuple[float, float]) -> Figure:
    """The whole run: minimum and maximum of each quantity over time.

    Marked are ``changes``, the times of commands and events in s, and ``window``, the start and end in s of
    what the other figures show.
    """
    panels = _panels(envelope)
    figure = Figure(figsize=(10.0, 1.0 + 1.45 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    times = envelope.times()
    for axis, panel in zip(axes, panels, strict=True):
        for number, curve in enumerate(panel.curves):
            low, high = (panel.scale * bound for bound in envelope.bounds(curve.name))
            # Only the first is filled: two fills over each other would hide both.
            fill = {"facecolor": (curve.colour, 0.0 if number else 0.35)}
            axis.fill_between(
                times, low, high, **fill, edgecolor=curve.colour, linewidth=0.7, label=curve.label
            )
        if len(changes) <= MAX_CHANGE_LINES or axis is axes[0]:
            _mark_changes(axis, changes)
        axis.axvspan(*window, color=palette.GREEN, alpha=0.13, linewidth=0)
        axis.set_ylabel(panel.axis_label)
        axis.margins(x=0.01)
        if len(panel.curves) > 1:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.2)
    axes[-1].set_xlabel("simulated time (s)")
    axes[0].set_title(_overview_title(len(changes)))
    figure.align_ylabels(axes)
    return figure


def _panels(envelope: Envelope) -> list[OverviewPanel]:
    present = set(envelope.names)
    kept = (
        panel._replace(curves=tuple(c for c in panel.curves if c.name in present))
        for panel in OVERVIEW_PANELS
    )
    return [panel for panel in kept if panel.curves]


def _mark_changes(axis: Axes, changes: Sequence[float]) -> None:
    if len(changes) <= MAX_CHANGE_LINES:
        for time in changes:
            axis.axvline(time, color=palette.GREY, linewidth=0.8, linestyle=(0, (3, 3)))
    else:
        axis.plot(
            changes,
            np.ones(len(changes)),
            "|",
            color=palette.GREY,
            markersize=5,
            transform=axis.get_xaxis_transform(),
            clip_on=False,
        )


def _overview_title(changes: int) -> str:
    marks = "grey: commands and events, " if changes else ""
    return f"Whole run ({marks}green: window of the other figures)"


@styled
def time_series_figure(samples: Samples, parameters: Parameters) -> Figure:
    """The last mesh periods of a window, sample by sample: DTE and flanks, mesh force, bearing forces.

    What wasn't recorded is left out.
    """
    shown = samples.last(_period_samples(samples))
    milliseconds = 1e3 * (shown.time - shown.time[0])
    dots = {"marker": "." if len(shown) <= DOTTED_SAMPLES else "", "markersize": 3.0}
    figure = Figure(figsize=(10.0, 7.6), layout="constrained")
    motion, force, *bearings = figure.subplots(4, 1, sharex=True)
    if shown.has("dte"):
        motion.plot(milliseconds, MICRO * shown["dte"], color=palette.BLUE, label="DTE", **dots)
    if shown.has("half_backlash"):
        half = MICRO * shown["half_backlash"]
        motion.plot(
            milliseconds, half, color=palette.GREY, linewidth=0.9, linestyle="--", label="drive flank"
        )
        if shown.has("dte") and MICRO * shown["dte"].min() < 0.0:
            motion.plot(
                milliseconds, -half, color=palette.GREY, linewidth=0.9, linestyle=":", label="back flank"
            )
    if shown.has("mesh_force"):
        force.plot(milliseconds, KILO * shown["mesh_force"], color=palette.BLUE, **dots)
    motion.set_ylabel("DTE (µm)")
    force.set_ylabel("mesh force (kN)")
    for axis, gear in zip(bearings, GEARS, strict=True):
        if shown.has(*contact_channels(gear)):
            axis.plot(
                milliseconds, KILO * shown.contact_force(gear), color=palette.BLUE, label="contact", **dots
            )
        if parameters.model == "improved" and shown.has(*film_channels(gear)):
            axis.plot(
                milliseconds, KILO * shown.film_force(gear), color=palette.ORANGE, label="oil film", **dots
            )
        axis.set_ylabel(f"{gear} bearing\nforce (kN)")
    for axis in (motion, *bearings):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.4)
    bearings[-1].set_xlabel(f"time after {shown.time[0]:.6f} s (ms)")
    motion.set_title(_periods_title(shown))
    motion.margins(x=0.01)
    figure.align_ylabels()
    return figure


def _period_samples(samples: Samples) -> int:
    mesh = observed_mesh_frequency(samples)
    if mesh is None:
        return SERIES_SAMPLES
    return max(SERIES_MIN_SAMPLES, round(SERIES_PERIODS / (abs(mesh) * samples.interval)))


def _periods_title(shown: Samples) -> str:
    mesh = observed_mesh_frequency(shown)
    if mesh is None:
        return f"Last {len(shown)} samples of the window"
    periods = abs(mesh) * len(shown) * shown.interval
    return f"Last {periods:.0f} mesh periods of the window (mesh frequency {KILO * abs(mesh):.3f} kHz)"


@styled
def spectrum_figure(samples: Samples) -> Figure:
    """Amplitude spectrum of the DTE, with orders of the mesh frequency on top.

    Needs the channel dte; raises ValueError for fewer than spectra.MIN_SAMPLES samples.
    """
    found = amplitude_spectrum(samples["dte"], samples.interval)
    mesh = observed_mesh_frequency(samples)
    highest = float(found.frequency[-1])
    limit = min(highest, ORDERS * abs(mesh)) if mesh else highest
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axis = figure.subplots()
    shown = slice(1, int(np.searchsorted(found.frequency, limit)) + 1)
    amplitude = MICRO * found.amplitude[shown]
    top = float(amplitude.max()) or 1.0
    axis.semilogy(
        KILO * found.frequency[shown],
        np.maximum(amplitude, top / DYNAMIC_RANGE / 10.0),
        color=palette.BLUE,
        linewidth=0.8,
    )
    axis.set_ylim(top / DYNAMIC_RANGE, 2.0 * top)
    axis.set_xlim(0.0, KILO * limit)
    axis.set_xlabel("frequency (kHz)")
    axis.set_ylabel("amplitude of DTE (µm)")
    axis.grid(axis="x", visible=mesh is None)
    if mesh is not None:
        _mesh_orders(axis, KILO * abs(mesh), KILO * limit)
    axis.set_title(
        f"Spectrum of the DTE over {len(samples) * samples.interval:.3g} s "
        f"(flat-top window, bins of {found.resolution:.3g} Hz)"
    )
    return figure


def _mesh_orders(axis: Axes, mesh: float, limit: float) -> None:
    """Lines at whole orders, and their numbers on an axis above; ``mesh`` and ``limit`` in kHz."""
    for order in range(1, int(limit / mesh) + 1):
        axis.axvline(order * mesh, color=palette.ORANGE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
    above = axis.secondary_xaxis(
        "top", functions=(lambda f: np.asarray(f) / mesh, lambda order: np.asarray(order) * mesh)
    )
    above.set_xlabel(f"order of the mesh frequency ({mesh:.3f} kHz)", color=palette.ORANGE)
    above.tick_params(colors=palette.ORANGE)


@styled
def phase_portrait_figure(samples: Samples) -> Figure:
    """DTE rate over DTE, with the points where the mesh phase wraps. Needs the channels dte and dte_rate."""
    figure = Figure(figsize=(7.4, 5.4), layout="constrained")
    axis = figure.subplots()
    shown = samples.last(ORBIT_SAMPLES)
    axis.plot(
        MICRO * shown["dte"], shown["dte_rate"], color=palette.SKY, linewidth=0.35, alpha=0.6, label="motion"
    )
    if samples.has("mesh_phase"):
        points = poincare_section(samples)
        axis.plot(
            MICRO * points[:, 0],
            points[:, 1],
            "o",
            color=palette.ORANGE,
            markersize=2.4,
            markeredgewidth=0,
            label=f"mesh phase 0 ({len(points)} points)",
        )
    if samples.has("half_backlash"):
        _mark_flanks(axis, samples)
    axis.set_xlabel("DTE (µm)")
    axis.set_ylabel("rate of DTE (m/s)")
    axis.set_title(f"Phase portrait and Poincaré section over {len(samples) * samples.interval:.3g} s")
    legend = axis.legend(loc="upper right")
    for handle in legend.get_lines():
        handle.set_linewidth(1.2)
        handle.set_alpha(1.0)
        handle.set_markersize(4.5)
    return figure


def _mark_flanks(axis: Axes, samples: Samples) -> None:
    """Mark the mean positions of the flanks that the motion comes near."""
    half = float(samples["half_backlash"].mean())
    lowest, highest = float(samples["dte"].min()), float(samples["dte"].max())
    for place, name in ((half, "drive flank"), (-half, "back flank")):
        if lowest - 0.2 * half <= place <= highest + 0.2 * half:
            axis.axvline(MICRO * place, color=palette.GREY, linewidth=0.9, linestyle="--")
            axis.annotate(
                f"{name} (mean)",
                (MICRO * place, 0.02),
                xycoords=("data", "axes fraction"),
                xytext=(4, 0),
                textcoords="offset points",
                rotation=90,
                va="bottom",
                color="#666666",
                fontsize=8,
            )


@styled
def orbits_figure(samples: Samples, parameters: Parameters) -> Figure:
    """Path of each journal's centre in its clearance circle, and in the oil clearance where a film acts.

    Needs the displacements of both gears.
    """
    figure = Figure(figsize=(10.0, 10.4), layout="constrained")
    axes = figure.subplots(2, 2)
    shown = samples.last(ORBIT_SAMPLES)
    sizes = {"driving": parameters.bearings.driving, "driven": parameters.bearings.driven}
    for (bearing, close), gear in zip(axes.T, GEARS, strict=True):
        path = MICRO * np.column_stack([shown[f"{gear}_x"], shown[f"{gear}_y"]])
        circles = [ClearanceCircle(MICRO * sizes[gear].clearance, palette.ORANGE, "bearing clearance")]
        if parameters.model == "improved":
            circles.append(ClearanceCircle(MICRO * sizes[gear].oil_clearance, palette.GREEN, "oil clearance"))
        half = 1.08 * max(*(circle.radius for circle in circles), float(np.abs(path).max()))
        _draw_orbit(bearing, path, circles, (0.0, 0.0), half)
        _draw_orbit(close, path, circles, *_close_view(path))
        bearing.set_title(f"Journal of the {gear} gear")
        close.set_title("The same, enlarged")
        bearing.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=2)
    return figure


class ClearanceCircle(NamedTuple):
    """A circle about the bearing's centre, radius in um."""

    radius: float
    colour: str
    name: str

    def patch(self) -> Circle:
        """The circle to draw."""
        label = f"{self.name}, {self.radius:g} µm"
        return Circle((0.0, 0.0), self.radius, fill=False, edgecolor=self.colour, linewidth=1.1, label=label)


def _draw_orbit(
    axis: Axes,
    path: NDArray[np.float64],
    circles: Sequence[ClearanceCircle],
    centre: tuple[float, float],
    half: float,
) -> None:
    """Draw the path (n, 2) in a square view of half side ``half`` about ``centre``, all in um."""
    for circle in circles:
        axis.add_patch(circle.patch())
    axis.plot(path[:, 0], path[:, 1], color=palette.BLUE, linewidth=0.6, alpha=0.8, label="journal centre")
    axis.set(
        xlim=(centre[0] - half, centre[0] + half),
        ylim=(centre[1] - half, centre[1] + half),
        aspect="equal",
        xlabel="x (µm)",
        ylabel="y (µm)",
    )


def _close_view(path: NDArray[np.float64]) -> tuple[tuple[float, float], float]:
    """Centre and half side of a square around the path with some margin, um."""
    low, high = path.min(axis=0), path.max(axis=0)
    x, y = (float(value) for value in (low + high) / 2.0)
    return (x, y), max(MIN_HALF_SIDE, 0.65 * float((high - low).max()))


@styled
def bearing_force_figure(samples: Samples) -> Figure:
    """Contact force over penetration of each bearing: the area of a loop is the energy dissipated.

    Needs penetration and contact force of both gears.
    """
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    shown = samples.last(LOOP_SAMPLES)
    for axis, gear in zip(axes, GEARS, strict=True):
        penetration = shown[f"{gear}_penetration"]
        touching = np.where(penetration >= 0.0, MICRO * penetration, np.nan)
        axis.plot(
            touching, KILO * shown.contact_force(gear), color=GEAR_COLOURS[gear], linewidth=0.6, alpha=0.8
        )
        if np.isnan(touching).all():
            axis.text(0.5, 0.5, "no contact", transform=axis.transAxes, ha="center", color="#666666")
        axis.set_xlabel("penetration (µm)")
        axis.set_title(f"Bearing of the {gear} gear, last {len(shown) * shown.interval:.3g} s of the window")
    axes[0].set_ylabel("bearing contact force (kN)")
    return figure


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


RECORDING_FIGURES: Final = (
    RecordingFigure(
        "overview",
        "The whole run, minimum and maximum of each interval, so that no peak is lost. Look for what follows "
        "each command or event (grey): where the band of the DTE widens, teeth or journals have begun to "
        "come apart; where the mesh force touches zero, contact was lost.",
        lambda data: "" if _panels(data.envelope) else "not recorded: any of its channels",
        lambda data: overview_figure(
            data.envelope, data.changes, (float(data.window.time[0]), float(data.window.time[-1]))
        ),
    ),
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
        "them is the energy that the contact dissipates. Look for wide loops (much damping) and for loops "
        "that begin and end at zero (impacts, not a lasting contact).",
        _lacking_channels(
            *(name for gear in GEARS for name in (f"{gear}_penetration", *contact_channels(gear)))
        ),
        lambda data: bearing_force_figure(data.window),
    ),
)
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


class Overlay(NamedTuple):
    """One channel of A and B around the time ``marked`` in s."""

    title: str
    channel: str
    a: Samples
    b: NDArray[np.float64]  # shape (n,)
    marked: float


@styled
def divergence_figure(
    envelope: Envelope,
    differences: Mapping[str, ChannelDifference],
    interval: float,
    overlays: Sequence[Overlay],
) -> Figure:
    """How two recordings differ: |A - B| of some channels over time, and A and B in ``overlays``.

    ``envelope`` holds |A - B|, ``differences`` the channels to show, of which at least one value differs;
    ``interval`` is the sample interval in s.
    """
    heights = (1.7 * len(differences) + 0.6, 4.4)
    figure = Figure(figsize=(10.0, sum(heights)), layout="constrained")
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)
    above, below = parts[:, 0]
    axes = above.subplots(len(differences), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, found) in zip(axes, differences.items(), strict=True):
        _draw_growth(axis, envelope, name, found, interval)
    axes[0].set_title("|A - B|, maximum of each time interval")
    axes[-1].set_xlabel("simulated time (s)")
    above.align_ylabels(axes)
    columns = below.subplots(2, len(overlays), sharex="col", squeeze=False, height_ratios=(3, 2)).T
    for (values, apart), overlay in zip(columns, overlays, strict=True):
        _draw_overlay(values, apart, overlay)
    columns[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    below.align_ylabels()
    return figure


def _draw_growth(
    axis: Axes, envelope: Envelope, name: str, found: ChannelDifference, interval: float
) -> None:
    """|A - B| of one channel on a logarithmic axis, which leaves out where it is 0."""
    greatest, times = envelope.bounds(name)[1], envelope.times()
    axis.semilogy(
        times,
        np.where(greatest > 0.0, greatest, np.nan),
        color=palette.BLUE,
        marker=".",
        markersize=2.0,
        linewidth=0.8,
        label="|A - B|",
    )
    if found.rms_a > 0.0:
        axis.axhline(
            found.rms_a,
            color=palette.GREY,
            linewidth=0.9,
            linestyle="--",
            label=f"RMS of A\n{found.rms_a:.3g}",
        )
    if found.first_difference is not None:
        first = found.first_difference * interval
        axis.axvline(
            first, color=palette.ORANGE, linewidth=1.1, linestyle=":", label=f"first differs\n{first:.9g} s"
        )
    axis.set_xlim(*_with_margin(float(times[0]), float(times[-1])))
    axis.set_ylabel(_with_unit(name))
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), handlelength=1.6)


def _with_margin(low: float, high: float) -> tuple[float, float]:
    margin = 0.01 * (high - low) or 1e-6
    return low - margin, high + margin


def _with_unit(name: str) -> str:
    unit = QUANTITY_UNITS[name]
    return f"{name}\n({unit})" if unit else name


def _draw_overlay(values: Axes, apart: Axes, overlay: Overlay) -> None:
    """A and B in one diagram, and A - B below."""
    milliseconds = 1e3 * (overlay.a.time - overlay.marked)
    a, b = overlay.a[overlay.channel], overlay.b
    scale, unit = (
        (MICRO, "µm") if QUANTITY_UNITS[overlay.channel] == "m" else (1.0, QUANTITY_UNITS[overlay.channel])
    )
    name = "DTE" if overlay.channel == "dte" else overlay.channel
    # The thin curve B stays visible on top of the wide curve A where they are equal.
    values.plot(milliseconds, scale * a, color=palette.SKY, linewidth=4.0, label="A")
    values.plot(milliseconds, scale * b, ".-", color=palette.ORANGE, linewidth=0.9, markersize=3.0, label="B")
    values.set_ylabel(f"{name} ({unit})" if unit else name)
    values.set_title(overlay.title)
    apart.plot(milliseconds, scale * (a - b), ".-", color=palette.BLUE, linewidth=0.9, markersize=3.0)
    apart.set_ylabel(f"A - B ({unit})" if unit else "A - B")
    apart.set_xlabel(f"time after {overlay.marked:.9g} s (ms)")
    for axis in (values, apart):
        axis.axvline(0.0, color=palette.ORANGE, linewidth=1.1, linestyle=":")
        axis.margins(x=0.01)
