"""Figures: each panel has its axes labelled with units, and its curves are the samples."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gear_dynamics_ros.analysis import figures
from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.statistics import Envelope, derived_quantities
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine

INTERVAL = 1e-5
SAMPLES = 6000
CHANGE = 1500  # sample at which the load rises
GEARS = ("driving", "driven")
Vector = NDArray[np.float64]


@pytest.fixture(scope="module")
def samples() -> Samples:
    """A run with little torque, so that teeth and bearings come apart; its load rises on the way."""
    engine = Engine(Parameters.from_flat({"operation.drive_torque": 1.0, "operation.load_torque": 1.0}))
    before = engine.advance(CHANGE)
    engine.command(Commands(1.0, 1.2, 1623.156))
    after = engine.advance(SAMPLES - CHANGE)
    return Samples(0, INTERVAL, CHANNEL_NAMES, np.vstack([before.samples, after.samples]))


def line(axis: Axes, label: str) -> tuple[Vector, Vector]:
    (found,) = [line for line in axis.get_lines() if line.get_label() == label]
    return np.asarray(found.get_xdata(), dtype=float), np.asarray(found.get_ydata(), dtype=float)


def only_line(axis: Axes) -> tuple[Vector, Vector]:
    (found,) = axis.get_lines()
    return np.asarray(found.get_xdata(), dtype=float), np.asarray(found.get_ydata(), dtype=float)


def labels(figure: Figure) -> list[tuple[str, str]]:
    return [(axis.get_xlabel(), axis.get_ylabel()) for axis in figure.axes]


def assert_holds(axis: Axes, x: Vector, y: Vector) -> None:
    """The axis shows all of a curve."""
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    assert left <= np.nanmin(x) and np.nanmax(x) <= right
    assert low <= np.nanmin(y) and np.nanmax(y) <= high


def magnitude(samples: Samples, vector: str) -> Vector:
    return np.hypot(samples[f"{vector}_x"], samples[f"{vector}_y"])


def test_overview_holds_the_bounds_of_every_quantity_and_marks_what_happened(samples: Samples) -> None:
    envelope = Envelope(capacity=64)
    envelope.add(samples, derived_quantities(samples))
    figure = figures.overview_figure(envelope, [CHANGE * INTERVAL], (0.03, 0.06))
    panels: list[tuple[str, float, list[Vector]]] = [
        ("speed\n(rad/s)", 1.0, [samples[f"{gear}_speed"] for gear in GEARS]),
        ("torque\n(N m)", 1.0, [samples["drive_torque"], samples["load_torque"]]),
        ("DTE\n(µm)", 1e6, [samples["dte"]]),
        ("mesh force\n(kN)", 1e-3, [samples["mesh_force"]]),
        (
            "bearing force\n(kN)",
            1e-3,
            [
                np.hypot(
                    samples[f"{gear}_contact_force_x"] + samples[f"{gear}_film_force_x"],
                    samples[f"{gear}_contact_force_y"] + samples[f"{gear}_film_force_y"],
                )
                for gear in GEARS
            ],
        ),
        ("penetration\n(µm)", 1e6, [samples[f"{gear}_penetration"] for gear in GEARS]),
    ]
    assert [axis.get_ylabel() for axis in figure.axes] == [label for label, _, _ in panels]
    assert figure.axes[-1].get_xlabel() == "simulated time (s)"
    for axis, (_, scale, curves) in zip(figure.axes, panels, strict=True):
        fills = axis.collections[: len(curves)]
        for fill, values in zip(fills, curves, strict=True):
            (x, y) = fill.get_paths()[0].vertices.T
            assert (y.min(), y.max()) == pytest.approx((scale * values.min(), scale * values.max()))
            assert_holds(axis, x, y)
            assert np.ptp(x) > 0.95 * SAMPLES * INTERVAL
        assert list(axis.get_lines()[0].get_xdata()) == [CHANGE * INTERVAL] * 2
        window = axis.patches[0]
        corners = window.get_patch_transform().transform(window.get_path().vertices)
        assert (corners[:, 0].min(), corners[:, 0].max()) == pytest.approx((0.03, 0.06))
    legend = figure.axes[1].get_legend()
    assert legend is not None and [text.get_text() for text in legend.get_texts()] == ["drive", "load"]


def test_time_series_shows_the_last_mesh_periods_sample_by_sample(samples: Samples) -> None:
    figure = figures.time_series_figure(samples, Parameters())
    motion, force, *bearings = figure.axes
    assert labels(figure)[:2] == [("", "DTE (µm)"), ("", "mesh force (kN)")]
    assert [axis.get_ylabel() for axis in bearings] == [f"{gear} bearing\nforce (kN)" for gear in GEARS]
    x, dte = line(motion, "DTE")
    # 12 mesh periods of 40 teeth at 1623 rad/s
    assert len(x) == pytest.approx(12 * 2.0 * math.pi / (40 * 1623.156) / INTERVAL, abs=2)
    last = slice(SAMPLES - len(x), SAMPLES)
    np.testing.assert_allclose(x, 1e3 * INTERVAL * np.arange(len(x)), atol=1e-9)
    np.testing.assert_allclose(dte, 1e6 * samples["dte"][last])
    np.testing.assert_allclose(line(motion, "drive flank")[1], 1e6 * samples["half_backlash"][last])
    np.testing.assert_allclose(only_line(force)[1], 1e-3 * samples["mesh_force"][last])
    for axis, gear in zip(bearings, GEARS, strict=True):
        contact, film = line(axis, "contact")[1], line(axis, "oil film")[1]
        np.testing.assert_allclose(contact, 1e-3 * magnitude(samples, f"{gear}_contact_force")[last])
        np.testing.assert_allclose(film, 1e-3 * magnitude(samples, f"{gear}_film_force")[last])
        assert_holds(axis, x, film)
    assert_holds(motion, x, dte)
    assert bearings[-1].get_xlabel() == f"time after {(SAMPLES - len(x)) * INTERVAL:.6f} s (ms)"


def test_spectrum_has_a_line_at_its_frequency_with_its_amplitude() -> None:
    """3 um at the mesh frequency of 10 kHz, 0.4 um at twice that."""
    count = 20_000
    time = INTERVAL * np.arange(count)
    mesh = 10_000.0
    dte = 25e-6 + 3e-6 * np.cos(2 * np.pi * mesh * time) + 0.4e-6 * np.sin(4 * np.pi * mesh * time)
    values = np.column_stack([time, dte, np.mod(2 * np.pi * mesh * time, 2 * np.pi)])
    figure = figures.spectrum_figure(Samples(0, INTERVAL, ("time", "dte", "mesh_phase"), values))
    axis = figure.axes[0]
    assert labels(figure)[0] == ("frequency (kHz)", "amplitude of DTE (µm)")
    curve = max(axis.get_lines(), key=lambda found: len(np.asarray(found.get_xdata())))
    x, y = np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())
    for frequency, amplitude in ((10.0, 3.0), (20.0, 0.4)):
        near = np.abs(x - frequency) < 0.5
        assert y[near].max() == pytest.approx(amplitude, rel=1e-3)
        assert x[near][y[near].argmax()] == pytest.approx(frequency, abs=0.02)
    orders = sorted(float(found.get_xdata()[0]) for found in axis.get_lines() if found is not curve)
    assert orders == pytest.approx([10.0, 20.0, 30.0, 40.0, 50.0][: len(orders)]) and len(orders) >= 4
    assert axis.get_xlim()[1] == pytest.approx(50.0, rel=0.11) and axis.get_yscale() == "log"
    assert axis.get_ylim()[1] > 3.0
    (above,) = axis.child_axes
    assert above.get_xlabel() == "order of the mesh frequency (10.000 kHz)"


def test_phase_portrait_has_the_motion_its_section_and_the_flanks(samples: Samples) -> None:
    (axis,) = figures.phase_portrait_figure(samples).axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("DTE (µm)", "rate of DTE (m/s)")
    x, y = line(axis, "motion")
    np.testing.assert_allclose(x, 1e6 * samples["dte"])
    np.testing.assert_allclose(y, samples["dte_rate"])
    assert_holds(axis, x, y)
    turns = np.count_nonzero(np.diff(samples["mesh_phase"]) < 0.0)
    (points,) = [found for found in axis.get_lines() if str(found.get_label()).startswith("mesh phase 0")]
    assert len(np.asarray(points.get_xdata())) == pytest.approx(turns, abs=1)
    half = 1e6 * samples["half_backlash"].mean()
    flanks = [float(found.get_xdata()[0]) for found in axis.get_lines() if len(found.get_xdata()) == 2]
    assert flanks == pytest.approx([half, -half]) and {text.get_text() for text in axis.texts} == {
        "drive flank (mean)",
        "back flank (mean)",
    }


def test_orbits_have_the_clearances_around_the_paths(samples: Samples) -> None:
    figure = figures.orbits_figure(samples, Parameters())
    assert set(labels(figure)) == {("x (µm)", "y (µm)")}
    bearings = Parameters().bearings
    for column, (gear, bearing) in enumerate((("driving", bearings.driving), ("driven", bearings.driven))):
        whole, close = figure.axes[column], figure.axes[2 + column]
        radii = [1e6 * bearing.clearance, 1e6 * bearing.oil_clearance]
        for axis in (whole, close):
            circles: Any = axis.patches
            assert [circle.get_radius() for circle in circles] == pytest.approx(radii)
            assert axis.get_aspect() == 1.0
            x, y = only_line(axis)
            np.testing.assert_allclose(x, 1e6 * samples[f"{gear}_x"])
            np.testing.assert_allclose(y, 1e6 * samples[f"{gear}_y"])
            assert_holds(axis, x, y)
        assert whole.get_xlim()[1] > max(radii) > np.ptp(close.get_xlim()) / 2.0


def test_bearing_force_is_drawn_over_penetration_where_there_is_contact(samples: Samples) -> None:
    figure = figures.bearing_force_figure(samples)
    assert labels(figure) == [
        ("penetration (µm)", "bearing contact force (kN)"),
        ("penetration (µm)", ""),
    ]
    for axis, gear in zip(figure.axes, GEARS, strict=True):
        shown = slice(SAMPLES - 5000, SAMPLES)
        penetration = 1e6 * samples[f"{gear}_penetration"][shown]
        x, y = only_line(axis)
        touching = penetration >= 0.0
        assert touching.any() and not touching.all()
        np.testing.assert_allclose(x, np.where(touching, penetration, np.nan))
        np.testing.assert_allclose(y, 1e-3 * magnitude(samples, f"{gear}_contact_force")[shown])
        assert_holds(axis, x, y[touching])


def figure_data(samples: Samples) -> FigureData:
    envelope = Envelope()
    envelope.add(samples, derived_quantities(samples))
    return FigureData(Parameters(), envelope, [CHANGE * INTERVAL], samples)


def only(samples: Samples, *names: str) -> Samples:
    """``samples`` of a recording that has only the channels ``names``."""
    columns = [samples.names.index(name) for name in names]
    return Samples(samples.first, samples.interval, names, samples.values[:, columns])


def test_every_figure_has_a_caption_that_says_what_to_look_for() -> None:
    assert tuple(figures.CAPTIONS) == figures.FIGURE_NAMES
    for name, caption in figures.CAPTIONS.items():
        assert re.search(r"[Ll]ook for ", caption) or "Look where" in caption, name
        assert caption.endswith("."), name


def test_a_figure_without_its_channels_is_left_out_and_says_which(samples: Samples) -> None:
    assert list(figures.recording_figures(figure_data(samples))) == list(figures.FIGURE_NAMES)
    assert figures.lacking_figures(figure_data(samples)) == {}
    few = figure_data(only(samples, "time", "dte").last(10))
    assert list(figures.recording_figures(few)) == ["overview", "time_series"]
    lacking = figures.lacking_figures(few)
    assert set(lacking) == set(figures.FIGURE_NAMES) - {"overview", "time_series"}
    assert lacking["phase_portrait"] == "not recorded: dte_rate"
    assert lacking["spectrum"] == "the window has 10 samples, a spectrum needs 40"
