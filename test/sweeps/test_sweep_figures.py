"""Figures of a sweep: axes with units, and curves and colours that are the dataset's numbers."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.figures import write_png
from gear_dynamics_ros.sweeps import figures, labels

MODELS = ["traditional", "compared", "improved"]
KEPT, PER_ORDER = 60, 20
RPM = np.linspace(2000.0, 18000.0, 33)
SCALARS = {
    "dte_min": "m",
    "dte_max": "m",
    "dte_mean": "m",
    "mesh_force_min": "N",
    "mesh_force_max": "N",
    "mesh_force_mean": "N",
    "driving_penetration_max": "m",
    "driving_bearing_force_max": "N",
    "section_spread": "m",
    "drive_share": "1",
    "apart_share": "1",
    "back_share": "1",
    "ldmf": "1",
    "lyapunov": "1/s",
    "zero_one": "1",
    "period": "1",
}


def made(coordinates: dict[str, Any], lengths: dict[str, int]) -> xr.Dataset:
    """A dataset like a sweep's, with other numbers in every variable, and one point without result."""
    generator = np.random.default_rng(5)
    dims = list(lengths)
    shape = tuple(lengths.values())
    lost = (0,) * (len(shape) - 1) + (3,)

    def values(*more: int) -> NDArray[np.float64]:
        numbers = generator.uniform(0.1, 0.9, (*shape, *more))
        numbers[lost] = np.nan
        return numbers

    sizes = {"m": 1e-5, "N": 2000.0, "1": 1.0, "1/s": 2000.0}
    variables: dict[str, Any] = {
        name: (dims, sizes[unit] * values(), {"units": unit}) for name, unit in SCALARS.items()
    }
    variables["lyapunov"][1][...] -= 1000.0
    variables["period"][1][...] = np.floor(6.0 * variables["period"][1])
    regimes = np.array(["periodic", "quasi-periodic", "chaotic", ""], dtype=object)
    regime = regimes[generator.integers(0, 3, shape)]
    regime[lost] = ""
    variables["regime"] = (dims, regime)
    variables["section_dte"] = ([*dims, "section"], 4e-5 * values(KEPT), {"units": "m"})
    spectrum = 1e-5 * 10.0 ** (-5.0 * values(5 * PER_ORDER + 1))
    variables["dte_spectrum"] = ([*dims, "order"], spectrum, {"units": "m"})
    order = np.arange(5 * PER_ORDER + 1) / PER_ORDER
    return xr.Dataset(variables, {**coordinates, "section": np.arange(KEPT), "order": order})


def speeds(count: int = len(RPM)) -> tuple[str, NDArray[np.float64], dict[str, str]]:
    return ("operation.speed", math.pi / 30.0 * RPM[:count], {"units": "rad/s"})


@pytest.fixture(scope="module")
def over_speed() -> xr.Dataset:
    return made({"model": MODELS, "operation.speed": speeds()}, {"model": 3, "operation.speed": len(RPM)})


@pytest.fixture(scope="module")
def both_ways() -> xr.Dataset:
    return made(
        {"model": MODELS[1:], "direction": ["up", "down"], "operation.speed": speeds()},
        {"model": 2, "direction": 2, "operation.speed": len(RPM)},
    )


@pytest.fixture(scope="module")
def over_two() -> xr.Dataset:
    roughness = ("surface.*.roughness", np.linspace(0.2e-6, 3.2e-6, 7), {"units": "m"})
    return made(
        {"model": MODELS, "operation.speed": speeds(9), "surface.*.roughness": roughness},
        {"model": 3, "operation.speed": 9, "surface.*.roughness": 7},
    )


def texts(figure: Figure) -> set[str]:
    return {text for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel()) if text}


def legend(figure: Figure, panel: int) -> list[str]:
    found = figure.axes[panel].get_legend()
    return [text.get_text() for text in found.get_texts()] if found else []


def curves(figure: Figure, panel: int) -> dict[str, NDArray[np.float64]]:
    return {
        str(line.get_label()): np.asarray(line.get_ydata(), dtype=float)
        for line in figure.axes[panel].get_lines()
    }


def test_names_of_the_figures(over_speed: xr.Dataset, both_ways: xr.Dataset, over_two: xr.Dataset) -> None:
    single = ["bifurcation", "spectrum_map", "spectrum_waterfall", "shares", "ldmf", "ranges", "exponents"]
    assert list(figures.sweep_figures(over_speed)) == single
    assert list(figures.sweep_figures(both_ways)) == [*single, "hysteresis"]
    expected = ["map_regime", *(f"map_{quantity.variable}" for quantity in figures.MAPS)]
    assert list(figures.sweep_figures(over_two)) == expected


@pytest.mark.parametrize("kind", ["over_speed", "both_ways", "over_two"])
def test_every_figure_is_drawn_with_labelled_axes(kind: str, request: pytest.FixtureRequest) -> None:
    for name, draw in figures.sweep_figures(request.getfixturevalue(kind)).items():
        figure, stream = draw(), io.BytesIO()
        write_png(figure, stream)
        assert stream.getvalue()[:4] == b"\x89PNG", name
        assert any("operation.speed (rpm)" in text for text in texts(figure)), name


def test_what_is_missing_is_left_out(over_speed: xr.Dataset) -> None:
    bare = over_speed[["section_dte", "ldmf"]]
    assert list(figures.sweep_figures(bare)) == ["bifurcation", "ldmf"]
    empty = over_speed.assign(ldmf=over_speed["ldmf"] * np.nan)
    assert "ldmf" not in figures.sweep_figures(empty)
    assert figures.sweep_figures(over_speed.isel({"operation.speed": 0}, drop=True)) == {}


def test_bifurcation_holds_every_point_by_regime_and_marks_points_without_result(
    over_speed: xr.Dataset,
) -> None:
    figure = figures.bifurcation_figure(over_speed)
    assert texts(figure) == {"operation.speed (rpm)", "DTE (µm)"}
    for panel, model in enumerate(MODELS):
        drawn = figure.axes[panel].get_lines()
        x = np.concatenate([np.asarray(line.get_xdata()) for line in drawn if len(line.get_xdata()) > 40])
        y = np.concatenate([np.asarray(line.get_ydata()) for line in drawn if len(line.get_xdata()) > 40])
        expected = 1e6 * over_speed["section_dte"].sel(model=model).to_numpy().ravel()
        order, wanted = np.lexsort((y, x)), np.lexsort((expected, np.repeat(RPM, KEPT)))
        kept = np.isfinite(expected[wanted])
        np.testing.assert_allclose(y[order][: kept.sum()], expected[wanted][kept])
        np.testing.assert_allclose(x[order][: kept.sum()], np.repeat(RPM, KEPT)[wanted][kept])
    assert legend(figure, 0) == ["periodic", "quasi-periodic", "chaotic", "no result (1)"]


def test_bifurcation_of_both_ways_tells_them_apart(both_ways: xr.Dataset) -> None:
    figure = figures.bifurcation_figure(both_ways)
    assert legend(figure, 1) == ["swept up", "swept down"]
    up, down = (np.asarray(line.get_xdata()) for line in figure.axes[1].get_lines()[:3:2])
    assert (np.unique(down) > np.unique(up)).all()


def test_shares_are_percent_of_each_model(over_speed: xr.Dataset) -> None:
    figure = figures.shares_figure(over_speed)
    labelled = [axis.get_ylabel() for axis in figure.axes]
    assert labelled == ["drive flank (%)", "apart (%)", "back flank (%)"]
    for panel, name in enumerate(("drive_share", "apart_share", "back_share")):
        drawn = curves(figure, panel)
        assert list(drawn) == MODELS
        for model in MODELS:
            np.testing.assert_allclose(drawn[model], 100.0 * over_speed[name].sel(model=model))


def test_exponents_and_periods(over_speed: xr.Dataset) -> None:
    figure = figures.exponents_figure(over_speed)
    exponent, zero_one, period = figure.axes
    np.testing.assert_allclose(curves(figure, 0)["improved"], over_speed["lyapunov"].sel(model="improved"))
    assert exponent.get_ylabel() == "largest Lyapunov\nexponent (1/s)"
    assert zero_one.get_ylim()[0] <= -0.1 and zero_one.get_ylim()[1] == 1.1
    assert period.get_ylabel() == "period\n(mesh periods)"
    low, high = period.get_ylim()
    assert low < 1.0 and high > float(over_speed["period"].max())


def test_an_exponent_of_orbits_that_became_equal_is_left_out(over_speed: xr.Dataset) -> None:
    infinite = over_speed.copy(deep=True)
    infinite["lyapunov"][2, 5] = -math.inf
    drawn = curves(figures.exponents_figure(infinite), 0)["improved"]
    assert np.isnan(drawn[5]) and np.isfinite(np.delete(drawn, 5)[:2]).all()


def test_maps_hold_the_values_with_grey_where_there_are_none(over_two: xr.Dataset) -> None:
    quantity = next(quantity for quantity in figures.MAPS if quantity.variable == "section_spread")
    figure = figures.map_figure(over_two, quantity)
    for axis, model in zip(figure.axes, MODELS, strict=False):
        (mesh,) = [found for found in axis.collections if isinstance(found, QuadMesh)]
        shown = np.ma.filled(np.ma.asarray(mesh.get_array()), np.nan).reshape(7, 9)
        np.testing.assert_allclose(shown, 1e6 * over_two["section_spread"].sel(model=model).to_numpy().T)
        assert axis.get_title(loc="left") == model
    assert {"surface.*.roughness (µm)", "spread of DTE at mesh phase 0 (µm)"} <= texts(figure)


def test_the_map_of_regimes_names_those_that_occur(over_two: xr.Dataset) -> None:
    figure = figures.regime_map_figure(over_two)
    assert set(legend(figure, 2)) == {*figures.REGIME_CLASSES, "no result"}
    periodic = over_two.assign(
        regime=over_two["regime"].where(over_two["period"].isnull(), "periodic"),
        period=over_two["period"].where(over_two["period"].isnull(), 2.0),
    )
    assert legend(figures.regime_map_figure(periodic), 2) == ["2-T", "no result"]


def test_spectrum_maps_share_their_colours_and_have_the_mean_left_out(over_speed: xr.Dataset) -> None:
    figure = figures.spectrum_map_figure(over_speed)
    top = 1e6 * float(over_speed["dte_spectrum"].max())
    for axis, model in zip(figure.axes, MODELS, strict=False):
        (mesh,) = axis.collections
        assert (mesh.norm.vmin, mesh.norm.vmax) == pytest.approx((1e-5 * top, top))
        shown = np.ma.filled(np.ma.asarray(mesh.get_array()), np.nan).reshape(-1, len(RPM))
        expected = 1e6 * over_speed["dte_spectrum"].sel(model=model).to_numpy().T[1:]
        np.testing.assert_allclose(shown, expected)
    assert "order of the mesh frequency" in texts(figure) and "amplitude of DTE (µm)" in texts(figure)


def test_lines_of_the_waterfall_stand_at_their_values(over_speed: xr.Dataset) -> None:
    shown = over_speed.isel({"operation.speed": slice(None, figures.WATERFALL_LINES)})
    figure = figures.spectrum_waterfall_figure(shown)
    axis = figure.axes[1]
    lift = figures.WATERFALL_LIFT * 500.0  # rpm between lines
    spectra = shown["dte_spectrum"].sel(model="compared").to_numpy()
    top = float(shown["dte_spectrum"].max())
    for line, base, spectrum in zip(axis.get_lines(), RPM[: len(spectra)], spectra, strict=True):
        decades = np.maximum(np.log10(spectrum[1:] / top), -figures.WATERFALL_DECADES)
        expected = base + lift * (1.0 + decades / figures.WATERFALL_DECADES)
        np.testing.assert_allclose(np.asarray(line.get_ydata(), dtype=float), expected)


def test_values_in_any_order_are_drawn_in_rising_order(over_speed: xr.Dataset) -> None:
    shuffled = over_speed.isel({"operation.speed": np.random.default_rng(1).permutation(len(RPM))})
    figure = figures.sweep_figures(shuffled)["ldmf"]()
    (x, y) = (np.asarray(data, dtype=float) for data in figure.axes[0].get_lines()[0].get_data())
    np.testing.assert_allclose(x, RPM)
    np.testing.assert_allclose(y, over_speed["ldmf"].sel(model="traditional"))


def test_names_are_swept_as_names() -> None:
    laws = ["lankarani_nikravesh", "exact"]
    dataset = made(
        {"model": MODELS[:1], "restitution_law": laws, "operation.speed": speeds(5)},
        {"model": 1, "restitution_law": 2, "operation.speed": 5},
    )
    figure = figures.sweep_figures(dataset)["map_ldmf"]()
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == laws
    figure = figures.sweep_figures(dataset.isel({"operation.speed": 0}, drop=True))["shares"]()
    assert [label.get_text() for label in figure.axes[-1].get_xticklabels()] == laws


@pytest.mark.parametrize(
    ("unit", "largest", "symbol", "factor"),
    [
        ("rad/s", 1885.0, "rpm", 30.0 / math.pi),
        ("m", 4e-5, "µm", 1e6),
        ("m", 13e-3, "mm", 1e3),
        ("m", 2.0, "m", 1.0),
        ("rad", 0.35, "°", 180.0 / math.pi),
        ("N", 1900.0, "N", 1.0),
        ("N", 2e4, "kN", 1e-3),
        ("Pa s", 0.02, "mPa s", 1e3),
        ("1", 3.0, "", 1.0),
        ("N m", 30.0, "N m", 1.0),
    ],
)
def test_units_that_readers_expect(unit: str, largest: float, symbol: str, factor: float) -> None:
    assert labels.display_unit(unit, largest) == pytest.approx((symbol, factor))
