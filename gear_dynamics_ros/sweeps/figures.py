"""Figures of a sweep's dataset: curves over one swept quantity, maps over two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.style import MICRO, styled
from gear_dynamics_ros.sweeps.labels import (
    DIRECTION,
    MODEL,
    SweptQuantity,
    display_unit,
    rising,
    swept_quantities,
    with_symbol,
)

WIDTH: Final = 10.0  # inches
SECTION_POINTS: Final = 400  # drawn of each section
DOTTED_VALUES: Final = 60  # up to this number each value of a curve gets a dot
WATERFALL_LINES: Final = 30
WATERFALL_DECADES: Final = 4.0  # of amplitude in a line's height
WATERFALL_LIFT: Final = 3.0  # height of a line, in distances of lines
MAP_DECADES: Final = 5.0  # of amplitude in the colours of a map
START: Final = "start."  # begins the names of what a run's start is varied in
SAME_MOTION: Final = 0.02  # of the range of DTE: within it two motions that aren't chaotic are the same
BASIN_COLOURS: Final = (
    palette.BLUE,
    palette.SKY,
    palette.GREEN,
    palette.YELLOW,
    palette.PURPLE,
    palette.GREY,
    palette.DIM,
)
NO_RESULT: Final = "#DDDDDD"
MODEL_COLOURS: Final = {
    "traditional": palette.BLUE,
    "compared": palette.ORANGE,
    "improved": palette.GREEN,
}
DIRECTION_COLOURS: Final = {"up": palette.BLUE, "down": palette.ORANGE}
DIRECTION_SHIFTS: Final = {"up": -0.15, "down": 0.15}  # of the distance of two values
REGIME_COLOURS: Final = {
    "periodic": palette.BLUE,
    "quasi-periodic": palette.PURPLE,
    "chaotic": palette.ORANGE,
}


class Quantity(NamedTuple):
    """A scalar result in a figure."""

    variable: str
    label: str


class QuantityBand(NamedTuple):
    """Minimum, maximum and mean of one quantity: the variables are ``prefix`` with _min, _max, _mean."""

    prefix: str
    label: str


RANGES: Final = (
    QuantityBand("dte", "DTE"),
    QuantityBand("mesh_force", "mesh force"),
    QuantityBand("driving_penetration", "penetration of\ndriving bearing"),
    QuantityBand("driving_bearing_force", "force of\ndriving bearing"),
)
SHARES: Final = (
    Quantity("drive_share", "drive flank"),
    Quantity("apart_share", "apart"),
    Quantity("back_share", "back flank"),
)
BRANCHES: Final = (
    Quantity("dte_max", "largest DTE"),
    Quantity("drive_share", "time on\ndrive flank"),
    Quantity("ldmf", "LDMF"),
)
MAPS: Final = (
    Quantity("section_spread", "spread of DTE at mesh phase 0"),
    Quantity("dte_max", "largest DTE"),
    Quantity("drive_share", "time on the drive flank"),
    Quantity("apart_share", "time apart"),
    Quantity("back_share", "time on the back flank"),
    Quantity("ldmf", "LDMF, largest over static mesh force"),
    Quantity("driving_penetration_max", "largest penetration of the driving bearing"),
    Quantity("driving_bearing_force_max", "largest force of the driving bearing"),
    Quantity("lyapunov", "largest Lyapunov exponent"),
    Quantity("zero_one", "K of the 0-1 test"),
)


def sweep_figures(dataset: xr.Dataset) -> dict[str, Callable[[], Figure]]:
    """What draws each figure of a sweep, by name, without those whose variables are missing.

    ``dataset`` has the dimension model, direction if both ways were swept, and one or two swept ones; a sweep
    over more has none: select a value of the others first.
    """
    ordered = rising(dataset)
    swept = swept_quantities(ordered)
    if len(swept) == 1:
        return _figures_over_one(ordered)
    return _figures_over_two(ordered) if len(swept) == 2 else {}


def _figures_over_one(dataset: xr.Dataset) -> dict[str, Callable[[], Figure]]:
    both_ways = dataset.sizes.get(DIRECTION, 1) > 1
    possible: dict[str, tuple[bool, Callable[[], Figure]]] = {
        "bifurcation": (_has(dataset, "section_dte"), lambda: bifurcation_figure(dataset)),
        "spectrum_map": (_has_spectra(dataset), lambda: spectrum_map_figure(dataset)),
        "spectrum_waterfall": (
            _has_spectra(dataset) and not swept_quantities(dataset)[0].names,
            lambda: spectrum_waterfall_figure(dataset),
        ),
        "shares": (_has(dataset, *(share.variable for share in SHARES)), lambda: shares_figure(dataset)),
        "ldmf": (_has(dataset, "ldmf"), lambda: ldmf_figure(dataset)),
        "ranges": (bool(_bands(dataset)), lambda: ranges_figure(dataset)),
        "exponents": (_has(dataset, "lyapunov", "zero_one"), lambda: exponents_figure(dataset)),
        "hysteresis": (
            both_ways and _has(dataset, *(branch.variable for branch in BRANCHES)),
            lambda: hysteresis_figure(dataset),
        ),
    }
    return {name: draw for name, (drawable, draw) in possible.items() if drawable}


def _figures_over_two(dataset: xr.Dataset) -> dict[str, Callable[[], Figure]]:
    figures: dict[str, Callable[[], Figure]] = {}
    if _has(dataset, "regime", "period"):
        figures["map_regime"] = lambda: regime_map_figure(dataset)
        if all(swept.name.startswith(START) for swept in swept_quantities(dataset)):
            figures["basins"] = lambda: basins_figure(dataset)
    for quantity in MAPS:
        if _has(dataset, quantity.variable):
            figures[f"map_{quantity.variable}"] = lambda quantity=quantity: map_figure(  # type: ignore[misc]
                dataset, quantity
            )
    return figures


def _has(dataset: xr.Dataset, *names: str) -> bool:
    """Whether ``dataset`` has all variables, with at least one result each."""
    return all(name in dataset and bool(dataset[name].notnull().any()) for name in names)


def _has_spectra(dataset: xr.Dataset) -> bool:
    return _has(dataset, "dte_spectrum") and dataset.sizes["order"] > 1


def _models(dataset: xr.Dataset) -> list[str]:
    return [str(model) for model in dataset[MODEL].to_numpy()]


def _directions(dataset: xr.Dataset) -> list[str]:
    """Directions of travel; one without name if the dataset has no such dimension."""
    return [str(way) for way in dataset[DIRECTION].to_numpy()] if DIRECTION in dataset.dims else [""]


def _select(dataset: xr.Dataset, model: str, direction: str) -> xr.Dataset:
    chosen = dataset.sel({MODEL: model})
    return chosen.sel({DIRECTION: direction}) if direction else chosen


def _numbers(dataset: xr.Dataset, variable: str) -> NDArray[np.float64]:
    """Values of ``variable``, NaN where they are infinite, as an exponent of two equal orbits is."""
    values = dataset[variable].to_numpy().astype(np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _unit(dataset: xr.Dataset, variable: str) -> tuple[str, float]:
    """Symbol and factor to show ``variable`` in."""
    if variable.endswith("_share"):
        return "%", 100.0
    values = np.abs(_numbers(dataset, variable))
    largest = float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
    return display_unit(str(dataset[variable].attrs.get("units", "1")), largest)


def _mark_axis(axis: Axes, swept: SweptQuantity) -> None:
    """Label and limits of the horizontal axis."""
    low, high = float(swept.positions[0]), float(swept.positions[-1])
    margin = 0.01 * (high - low) or 0.5
    axis.set_xlim(low - margin, high + margin)
    axis.set_xlabel(swept.label)
    if swept.names:
        axis.set_xticks(swept.positions, swept.names)


def _columns(models: Sequence[str], rows: int, height: float) -> tuple[Figure, NDArray[Any]]:
    """A figure with a column of panels for each model, and its axes, shape (rows, models)."""
    size = (max(WIDTH, 3.6 * len(models) + 1.0), height * rows + 0.8)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, len(models), sharex=True, sharey="row", squeeze=False)
    for axis, model in zip(axes[0], models, strict=True):
        axis.set_title(model)
    return figure, axes


def _outside_legend(axis: Axes, **options: Any) -> None:
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.03), handlelength=1.6, **options)


# Over one swept quantity


@styled
def bifurcation_figure(dataset: xr.Dataset) -> Figure:
    """DTE at mesh phase 0 over the swept quantity, a panel a model.

    Colours tell the regime, or the direction of travel where both ways were swept; marks below the panels
    are points without result.
    """
    (swept,) = swept_quantities(dataset)
    models = _models(dataset)
    figure = Figure(figsize=(WIDTH, 2.7 * len(models) + 0.6), layout="constrained")
    axes = figure.subplots(len(models), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, model in zip(axes, models, strict=True):
        for direction in _directions(dataset):
            _draw_sections(axis, swept, _select(dataset, model, direction), direction)
        axis.set_title(f"{model}: DTE at mesh phase 0")
        axis.set_ylabel("DTE (µm)")
        _mark_missing(axis, swept, _numbers(_select(dataset, model, _directions(dataset)[0]), "section_dte"))
        if axis.get_legend_handles_labels()[0]:
            _outside_legend(axis)
    _mark_axis(axes[-1], swept)
    return figure


def _draw_sections(axis: Axes, swept: SweptQuantity, dataset: xr.Dataset, direction: str) -> None:
    sections = MICRO * _numbers(dataset, "section_dte")[:, -SECTION_POINTS:]
    # Side by side, as motions that both ways share would hide each other.
    shift = DIRECTION_SHIFTS.get(direction, 0.0) * _spacing(swept.positions)
    for name, colour, chosen in _classes(dataset, direction, len(sections)):
        if not np.isfinite(sections[chosen]).any():
            continue
        places = np.repeat(swept.positions[chosen] + shift, sections.shape[1])
        axis.plot(
            places,
            sections[chosen].ravel(),
            linestyle="",
            marker=".",
            markersize=_dot(len(sections)),
            markeredgewidth=0,
            color=colour,
            alpha=0.5,
            rasterized=True,
        )
        if name:  # a dot of its own: those of the points are too small to tell colours
            axis.plot([], [], ".", color=colour, markersize=8.0, label=name)


def _spacing(positions: NDArray[np.float64]) -> float:
    """Least distance of neighbours; 0 of a single one."""
    return float(np.diff(positions).min()) if len(positions) > 1 else 0.0


def _classes(dataset: xr.Dataset, direction: str, count: int) -> list[tuple[str, str, NDArray[np.bool_]]]:
    """Name and colour of each class of the ``count`` points, and which points belong to it."""
    if direction:
        name = f"swept {direction}"
        return [(name, DIRECTION_COLOURS.get(direction, palette.GREY), np.ones(count, dtype=np.bool_))]
    if "regime" not in dataset:
        return [("", palette.BLUE, np.ones(count, dtype=np.bool_))]
    regimes = _regimes(dataset)
    return [(name, colour, regimes == name) for name, colour in REGIME_COLOURS.items()]


def _regimes(dataset: xr.Dataset) -> NDArray[np.str_]:
    """Name of each point's regime, empty without result."""
    regime = dataset["regime"]
    flags = zip(regime.attrs["flag_values"], regime.attrs["flag_meanings"].split(), strict=True)
    numbers = regime.to_numpy()
    named = np.full(numbers.shape, "", dtype="U14")
    for flag, name in flags:
        named[numbers == flag] = name
    return named


def _dot(values: int) -> float:
    """Size of a dot in points, the smaller the more values stand side by side."""
    return float(np.clip(400.0 / values, 0.7, 3.0))


def _mark_missing(axis: Axes, swept: SweptQuantity, values: NDArray[np.float64]) -> None:
    missing = np.isnan(values).all(axis=1)
    if missing.any():
        axis.plot(
            swept.positions[missing],
            np.zeros(int(missing.sum())),
            "|",
            transform=axis.get_xaxis_transform(),
            color=palette.GREY,
            markersize=7.0,
            label=f"no result ({int(missing.sum())})",
        )


@styled
def spectrum_map_figure(dataset: xr.Dataset) -> Figure:
    """Amplitude of DTE over the swept quantity and the order of the mesh frequency, as colours."""
    (swept,) = swept_quantities(dataset)
    models, directions = _models(dataset), _directions(dataset)
    top = MICRO * float(np.nanmax(_numbers(dataset, "dte_spectrum")))
    lowest = top / 10.0**MAP_DECADES
    norm = LogNorm(lowest, top)
    figure, axes = _columns(models, len(directions), 4.4)
    orders = dataset["order"].to_numpy().astype(np.float64)
    for row, direction in zip(axes, directions, strict=True):
        for axis, model in zip(row, models, strict=True):
            amplitudes = MICRO * _numbers(_select(dataset, model, direction), "dte_spectrum")[:, 1:]
            image = _draw_map(axis, swept.positions, orders[1:], np.maximum(amplitudes, lowest), norm)
        row[0].set_ylabel(_row_label("order of the mesh frequency", direction))
    for axis in axes[-1]:
        _mark_axis(axis, swept)
        axis.set_xlim(*_edges(swept.positions)[[0, -1]])
    figure.colorbar(image, ax=axes, label="amplitude of DTE (µm)", pad=0.01)
    return figure


def _row_label(text: str, direction: str) -> str:
    return f"{text}\nswept {direction}" if direction else text


def _draw_map(
    axis: Axes,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    values: NDArray[np.float64],
    norm: Normalize,
    colours: str | ListedColormap = "viridis",
) -> Any:
    """Colours of ``values`` (len(x), len(y)), each up to half way to its neighbours; grey where it is NaN."""
    axis.set_facecolor(NO_RESULT)
    axis.grid(visible=False)
    shown = np.ma.masked_invalid(values.T)
    return axis.pcolormesh(_edges(x), _edges(y), shown, norm=norm, cmap=colours, rasterized=True)


def _edges(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bounds half way between the ``centres`` (n,), and as far outside; shape (n + 1,)."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])


@styled
def spectrum_waterfall_figure(dataset: xr.Dataset) -> Figure:
    """Amplitude spectra of DTE over the order of the mesh frequency, one above the other.

    Each line stands at its value of the swept quantity; its height is the logarithm of the amplitude.
    """
    (swept,) = swept_quantities(dataset)
    models, directions = _models(dataset), _directions(dataset)
    top = MICRO * float(np.nanmax(_numbers(dataset, "dte_spectrum")))
    figure, axes = _columns(models, len(directions), 6.4)
    orders = dataset["order"].to_numpy().astype(np.float64)
    count = len(swept.positions)
    chosen = np.unique(np.linspace(0, count - 1, min(count, WATERFALL_LINES)).round().astype(int))
    places = swept.positions[chosen]
    lift = WATERFALL_LIFT * (float(np.ptp(places)) or 1.0) / max(len(places) - 1, 1)
    for row, direction in zip(axes, directions, strict=True):
        for axis, model in zip(row, models, strict=True):
            spectra = MICRO * _numbers(_select(dataset, model, direction), "dte_spectrum")[chosen]
            _draw_waterfall(axis, orders, places, lift, spectra / top)
            axis.set_xlim(0.0, float(orders[-1]))
            axis.set_ylim(places[0] - 0.25 * lift, places[-1] + 1.1 * lift)
        row[0].set_ylabel(_row_label(swept.label, direction))
        _draw_scale(row[-1], float(places[0]), lift, top)
    for axis in axes[-1]:
        axis.set_xlabel("order of the mesh frequency")
    return figure


def _draw_waterfall(
    axis: Axes,
    orders: NDArray[np.float64],
    places: NDArray[np.float64],
    lift: float,
    spectra: NDArray[np.float64],
) -> None:
    """Lines of ``spectra`` (len(places), len(orders)), relative to their largest amplitude."""
    axis.grid(axis="y", visible=False)
    lowest = 10.0**-WATERFALL_DECADES
    for number, (place, spectrum) in enumerate(zip(places, spectra, strict=True)):
        height = lift * (1.0 + np.log10(np.maximum(spectrum, lowest)) / WATERFALL_DECADES)
        behind = 2.0 + 0.01 * (len(places) - number)  # those in front hide those behind
        axis.fill_between(
            orders[1:], place, place + height[1:], facecolor="white", linewidth=0, zorder=behind
        )
        axis.plot(orders[1:], place + height[1:], color=palette.BLUE, linewidth=0.6, zorder=behind)


def _draw_scale(axis: Axes, base: float, lift: float, top: float) -> None:
    """A second axis on the right with the amplitudes of the lowest line."""
    powers = np.arange(-WATERFALL_DECADES, 0.5, 2.0)
    right = axis.secondary_yaxis("right")
    right.set_yticks(
        base + lift * (1.0 + powers / WATERFALL_DECADES), [f"{top * 10.0**power:.2g}" for power in powers]
    )
    right.set_ylabel("amplitude of DTE (µm), at the lowest line", loc="bottom")
    right.tick_params(labelsize=7.5)


@styled
def shares_figure(dataset: xr.Dataset) -> Figure:
    """Shares of time on the drive flank, apart and on the back flank over the swept quantity."""
    figure = _curves_figure(dataset, SHARES, 2.0)
    figure.axes[0].set_title("Share of the time")
    return figure


@styled
def ldmf_figure(dataset: xr.Dataset) -> Figure:
    """Largest mesh force over the static one (LDMF) over the swept quantity."""
    figure = _curves_figure(dataset, (Quantity("ldmf", "LDMF"),), 3.6)
    figure.axes[0].set_title("LDMF: largest over static mesh force")
    return figure


def _curves_figure(dataset: xr.Dataset, quantities: Sequence[Quantity], height: float) -> Figure:
    """A panel for each quantity, with a curve for each model and direction."""
    (swept,) = swept_quantities(dataset)
    figure = Figure(figsize=(WIDTH, height * len(quantities) + 0.7), layout="constrained")
    axes = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
    for axis, quantity in zip(axes, quantities, strict=True):
        _draw_curves(axis, swept, dataset, quantity)
    _outside_legend(axes[0])
    _mark_axis(axes[-1], swept)
    figure.align_ylabels()
    return figure


def _draw_curves(axis: Axes, swept: SweptQuantity, dataset: xr.Dataset, quantity: Quantity) -> None:
    symbol, factor = _unit(dataset, quantity.variable)
    for model in _models(dataset):
        for direction in _directions(dataset):
            values = factor * _numbers(_select(dataset, model, direction), quantity.variable)
            _draw_curve(axis, swept, values, model, direction)
    axis.set_ylabel(with_symbol(quantity.label, symbol))


def _draw_curve(
    axis: Axes, swept: SweptQuantity, values: NDArray[np.float64], model: str, direction: str
) -> None:
    axis.plot(
        swept.positions,
        values,
        color=MODEL_COLOURS.get(model, palette.GREY),
        linestyle="--" if direction == "down" else "" if swept.names else "-",
        marker="." if len(values) <= DOTTED_VALUES else "",
        linewidth=0.9,
        label=f"{model}, {direction}" if direction else model,
    )


@styled
def ranges_figure(dataset: xr.Dataset) -> Figure:
    """Minimum, maximum and mean of DTE, forces and penetration over the swept quantity, a column a model."""
    (swept,) = swept_quantities(dataset)
    models, bands = _models(dataset), _bands(dataset)
    figure, axes = _columns(models, len(bands), 2.0)
    for row, band in zip(axes, bands, strict=True):
        symbol, factor = _unit(dataset, f"{band.prefix}_max")
        for axis, model in zip(row, models, strict=True):
            for direction in _directions(dataset):
                _draw_band(axis, swept, _select(dataset, model, direction), band.prefix, factor, direction)
        row[0].set_ylabel(with_symbol(band.label, symbol))
    for axis in axes[-1]:
        _mark_axis(axis, swept)
    _outside_legend(axes[0, -1])
    figure.align_ylabels()
    return figure


def _bands(dataset: xr.Dataset) -> list[QuantityBand]:
    return [
        band
        for band in RANGES
        if _has(dataset, *(f"{band.prefix}_{kind}" for kind in ("min", "max", "mean")))
    ]


def _draw_band(
    axis: Axes, swept: SweptQuantity, dataset: xr.Dataset, prefix: str, factor: float, direction: str
) -> None:
    low, high, mean = (factor * _numbers(dataset, f"{prefix}_{kind}") for kind in ("min", "max", "mean"))
    colour = DIRECTION_COLOURS.get(direction, palette.BLUE)
    suffix = f", {direction}" if direction else ""
    axis.fill_between(
        swept.positions,
        low,
        high,
        facecolor=(colour, 0.25),
        edgecolor=colour,
        linewidth=0.7,
        label=f"minimum to maximum{suffix}",
    )
    axis.plot(swept.positions, mean, color=colour, linewidth=1.0, linestyle=":", label=f"mean{suffix}")


@styled
def exponents_figure(dataset: xr.Dataset) -> Figure:
    """Largest Lyapunov exponent, K of the 0-1 test and, if there are any, periods over the swept quantity."""
    (swept,) = swept_quantities(dataset)
    rows = 3 if _has(dataset, "period") else 2
    figure = Figure(figsize=(WIDTH, 2.1 * rows + 0.7), layout="constrained")
    exponent, zero_one, *rest = figure.subplots(rows, 1, sharex=True)
    _draw_curves(exponent, swept, dataset, Quantity("lyapunov", "largest Lyapunov\nexponent"))
    exponent.axhline(0.0, color="#555555", linewidth=0.8)
    exponent.set_title("Chaos: exponent above 0, K near 1")
    _outside_legend(exponent)
    _draw_curves(zero_one, swept, dataset, Quantity("zero_one", "K of the\n0-1 test"))
    zero_one.set_ylim(min(-0.1, zero_one.get_ylim()[0]), 1.1)
    for axis in rest:
        _draw_periods(axis, swept, dataset)
    _mark_axis(figure.axes[-1], swept)
    figure.align_ylabels()
    return figure


def _draw_periods(axis: Axes, swept: SweptQuantity, dataset: xr.Dataset) -> None:
    """k of k-T in mesh periods; the curves of the models side by side at each k."""
    models, directions = _models(dataset), _directions(dataset)
    shifts = np.linspace(-0.25, 0.25, len(models) * len(directions)) if len(models) > 1 else [0.0, 0.0]
    curves = [(model, direction) for model in models for direction in directions]
    for shift, (model, direction) in zip(shifts, curves, strict=False):
        period = _numbers(_select(dataset, model, direction), "period")
        axis.plot(
            swept.positions,
            np.where(period > 0.0, period + shift, np.nan),
            marker="_" if direction == "down" else ".",
            linestyle="",
            markersize=3.5,
            color=MODEL_COLOURS.get(model, palette.GREY),
        )
    highest = max(4.0, float(np.nanmax(_numbers(dataset, "period"))))
    axis.set_ylim(0.4, highest + 0.6)
    axis.set_yticks(np.arange(1.0, highest + 0.5, 1.0 if highest <= 8.0 else 2.0))
    axis.set_ylabel("period\n(mesh periods)")


@styled
def hysteresis_figure(dataset: xr.Dataset) -> Figure:
    """What differs between a sweep up and a sweep down: largest DTE, time on the drive flank, LDMF."""
    (swept,) = swept_quantities(dataset)
    models = _models(dataset)
    figure, axes = _columns(models, len(BRANCHES), 2.2)
    for row, branch in zip(axes, BRANCHES, strict=True):
        symbol, factor = _unit(dataset, branch.variable)
        for axis, model in zip(row, models, strict=True):
            curves = {
                direction: factor * _numbers(_select(dataset, model, direction), branch.variable)
                for direction in _directions(dataset)
            }
            axis.fill_between(swept.positions, *curves.values(), facecolor=NO_RESULT, label="difference")
            for direction, values in curves.items():
                axis.plot(
                    swept.positions,
                    values,
                    color=DIRECTION_COLOURS.get(direction, palette.GREY),
                    linestyle="--" if direction == "down" else "-",
                    marker="." if len(values) <= DOTTED_VALUES else "",
                    linewidth=0.9,
                    label=f"swept {direction}",
                )
        row[0].set_ylabel(with_symbol(branch.label, symbol))
    for axis in axes[-1]:
        _mark_axis(axis, swept)
    _outside_legend(axes[0, -1])
    figure.align_ylabels()
    return figure


# Over two swept quantities


@styled
def map_figure(dataset: xr.Dataset, quantity: Quantity) -> Figure:
    """One scalar result as colours over the two swept quantities, a panel a model."""
    symbol, factor = _unit(dataset, quantity.variable)
    values = factor * _numbers(dataset, quantity.variable)
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    colours, norm = "viridis", Normalize(low, high if high > low else low + 1.0)
    if quantity.variable == "lyapunov" and low < 0.0 < high:
        colours, norm = "PuOr_r", TwoSlopeNorm(0.0, -max(high, -low), max(high, -low))
    elif quantity.variable == "zero_one":
        norm = Normalize(0.0, 1.0)
    figure, axes, images = _maps(dataset, factor, quantity.variable, norm, colours)
    figure.colorbar(images[-1], ax=axes, label=with_symbol(quantity.label, symbol), pad=0.01)
    return figure


def _maps(
    dataset: xr.Dataset, factor: float, variable: str, norm: Normalize, colours: str | ListedColormap
) -> tuple[Figure, NDArray[Any], list[Any]]:
    """Panels of the maps of ``variable``, with labelled axes."""
    across, along = swept_quantities(dataset)
    models, directions = _models(dataset), _directions(dataset)
    figure, axes = _columns(models, len(directions), 4.0)
    images = []
    for row, direction in zip(axes, directions, strict=True):
        for axis, model in zip(row, models, strict=True):
            chosen = _select(dataset, model, direction).transpose(across.name, along.name, ...)
            values = factor * _numbers(chosen, variable)
            images.append(_draw_map(axis, across.positions, along.positions, values, norm, colours))
        row[0].set_ylabel(_row_label(along.label, direction))
        if along.names:
            row[0].set_yticks(along.positions, along.names)
    for axis in axes[-1]:
        axis.set_xlabel(across.label)
        if across.names:
            axis.set_xticks(across.positions, across.names)
    return figure, axes, images


LONGEST_NAMED_PERIOD: Final = 4
REGIME_CLASSES: Final = (
    *(f"{k}-T" for k in range(1, LONGEST_NAMED_PERIOD + 1)),
    "longer period",
    "follows the teeth",
    "quasi-periodic",
    "chaotic",
)
FOLLOWS_TEETH, QUASI_PERIODIC, CHAOTIC = (
    REGIME_CLASSES.index(name) for name in ("follows the teeth", "quasi-periodic", "chaotic")
)


@styled
def regime_map_figure(dataset: xr.Dataset) -> Figure:
    """Period and regime of the motion over the two swept quantities, a panel a model.

    A periodic motion without period is one that follows the teeth: it repeats with the hunting cycle only.
    """
    classes = _regime_classes(dataset)
    blues = mpl.colormaps["viridis"](np.linspace(0.25, 0.95, LONGEST_NAMED_PERIOD + 1))
    colours = ListedColormap([*map(tuple, blues), palette.SKY, palette.PURPLE, palette.ORANGE])
    norm = BoundaryNorm(np.arange(-0.5, len(REGIME_CLASSES)), len(REGIME_CLASSES))
    figure, axes, _ = _maps(dataset.assign(regime_class=classes), 1.0, "regime_class", norm, colours)
    present = sorted({int(value) for value in np.unique(classes.to_numpy()) if np.isfinite(value)})
    patches = [Patch(color=colours(value), label=REGIME_CLASSES[value]) for value in present]
    if bool(classes.isnull().any()):
        patches.append(Patch(color=NO_RESULT, label="no result"))
    _outside_legend(axes[0, -1], handles=patches)
    return figure


def _regime_classes(dataset: xr.Dataset) -> xr.DataArray:
    """Index into REGIME_CLASSES of each point, NaN without result."""
    regimes = _regimes(dataset)
    period = _numbers(dataset, "period")
    named = np.where(period > LONGEST_NAMED_PERIOD, LONGEST_NAMED_PERIOD, period - 1.0)
    classes = np.full(regimes.shape, np.nan)
    periodic = regimes == "periodic"
    classes[periodic] = np.where(period > 0.0, named, FOLLOWS_TEETH)[periodic]
    classes[regimes == "quasi-periodic"] = QUASI_PERIODIC
    classes[regimes == "chaotic"] = CHAOTIC
    return xr.DataArray(classes, dims=dataset["regime"].dims)


class Attractor(NamedTuple):
    """A motion that starts lead to."""

    regime: str
    period: float
    low: float  # DTE, m
    high: float

    @property
    def name(self) -> str:
        """Kind of motion, and its range of DTE."""
        kind = f"{self.period:.0f}-T" if self.regime == "periodic" and self.period > 0.0 else self.regime
        return f"{kind}\n{MICRO * self.low:.1f} to {MICRO * self.high:.1f} µm"


@styled
def basins_figure(dataset: xr.Dataset) -> Figure:
    """Which motion each start leads to, a panel a model: the basins of the attractors, over two start values.

    Two motions of the same period are the same if least and largest DTE agree within SAME_MOTION of the range
    of DTE; all chaotic motions count as one. The legends give the range of DTE of the first of each.
    """
    across, along = swept_quantities(dataset)
    models, directions = _models(dataset), _directions(dataset)
    figure = Figure(figsize=(WIDTH, 3.6 * len(models) * len(directions) + 0.6), layout="constrained")
    axes = figure.subplots(len(models) * len(directions), 1, sharex=True, squeeze=False)[:, 0]
    panels = [(model, direction) for model in models for direction in directions]
    for axis, (model, direction) in zip(axes, panels, strict=True):
        chosen = _select(dataset, model, direction).transpose(across.name, along.name, ...)
        attractors, basin = find_attractors(chosen)
        colours = [_basin_colour(attractor, number) for number, attractor in enumerate(attractors)]
        norm = BoundaryNorm(np.arange(-0.5, len(colours) + 0.6), len(colours) + 1)
        shades = ListedColormap([*colours, NO_RESULT])
        _draw_map(axis, across.positions, along.positions, basin, norm, shades)
        patches = [Patch(color=c, label=a.name) for c, a in zip(colours, attractors, strict=True)]
        if np.isnan(basin).any():
            patches.append(Patch(color=NO_RESULT, label="no result"))
        _outside_legend(axis, handles=patches)
        axis.set_title(f"{model}: motion that each start leads to, and its range of DTE")
        axis.set_ylabel(_row_label(along.label, direction))
    axes[-1].set_xlabel(across.label)
    return figure


def _basin_colour(attractor: Attractor, number: int) -> str:
    if attractor.regime == "chaotic":
        return palette.ORANGE
    return BASIN_COLOURS[number % len(BASIN_COLOURS)]


def find_attractors(dataset: xr.Dataset) -> tuple[list[Attractor], NDArray[np.float64]]:
    """The motions of ``dataset``, and the index of that of each point, of its shape; NaN without result."""
    low, high, period = (_numbers(dataset, name) for name in ("dte_min", "dte_max", "period"))
    regimes = _regimes(dataset)
    tolerance = SAME_MOTION * float(np.nanmax(high) - np.nanmin(low))
    found: list[Attractor] = []
    basin = np.full(low.shape, np.nan)
    for point in zip(*np.nonzero(regimes != ""), strict=True):
        motion = Attractor(str(regimes[point]), float(period[point]), float(low[point]), float(high[point]))
        known = (number for number, other in enumerate(found) if _is_same(motion, other, tolerance))
        number = next(known, len(found))
        if number == len(found):
            found.append(motion)
        basin[point] = number
    return found, basin


def _is_same(motion: Attractor, other: Attractor, tolerance: float) -> bool:
    if "chaotic" in (motion.regime, other.regime):
        return motion.regime == other.regime
    apart = max(abs(motion.low - other.low), abs(motion.high - other.high))
    return motion[:2] == other[:2] and apart <= tolerance
