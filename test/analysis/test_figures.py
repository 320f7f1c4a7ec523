"""Figures: each panel has its axes labelled with units, and its curves are the samples."""

from __future__ import annotations

import base64
import io
import math
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from gear_dynamics_ros.analysis import figures
from gear_dynamics_ros.analysis.contact_loops import loss_per_period
from gear_dynamics_ros.analysis.figure_data import FigureData
from gear_dynamics_ros.analysis.figures import (
    journal_motion,
    meshing_shares,
    order_map,
    overview,
    phase_portrait,
    spectrum,
    style,
    time_series,
)
from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.run_up import RunUp, SpeedSpectra
from gear_dynamics_ros.analysis.statistics import Envelope, derived_quantities
from gear_dynamics_ros.analysis.summary import TimeSpan
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.physics.modes import natural_frequencies
from gear_dynamics_ros.simulation.engine import Engine

INTERVAL = 1e-5
SAMPLES = 6000
CHANGE = 1500  # sample at which the load rises
GEARS = ("driving", "driven")
SVG, XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
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
    figure = overview.overview_figure(envelope, [CHANGE * INTERVAL], [(0.03, 0.06)])
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
    figure = time_series.time_series_figure(samples, Parameters())
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
    np.testing.assert_allclose(line(force, "mesh force")[1], 1e-3 * samples["mesh_force"][last])
    static = np.abs(samples["load_torque"]).mean() / base_radii(Parameters())[1]
    ldmf = samples["mesh_force"].max() / static
    assert line(force, f"static force\n(load factor LDMF\nof the window {ldmf:.2f})")[1] == pytest.approx(
        [1e-3 * static] * 2
    )
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
    figure = spectrum.spectrum_figure(Samples(0, INTERVAL, ("time", "dte", "mesh_phase"), values))
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
    (axis,) = phase_portrait.phase_portrait_figure(samples).axes
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
    figure = journal_motion.orbits_figure(samples, Parameters())
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


def test_bearing_force_is_drawn_over_penetration_with_the_energy_that_its_loops_lose(
    samples: Samples,
) -> None:
    figure = journal_motion.bearing_force_figure(samples)
    assert labels(figure) == [
        ("penetration (µm)", "bearing contact force (kN)"),
        ("penetration (µm)", ""),
    ]
    for axis, gear in zip(figure.axes, GEARS, strict=True):
        force = 1e-3 * magnitude(samples, f"{gear}_contact_force")
        shown = slice(SAMPLES - journal_motion.LOOP_SAMPLES, SAMPLES)
        penetration = 1e6 * samples[f"{gear}_penetration"]
        loops, greatest = axis.get_lines()
        x, y = np.asarray(loops.get_xdata()), np.asarray(loops.get_ydata())
        touching = penetration[shown] >= 0.0
        assert touching.any() and not touching.all()
        np.testing.assert_allclose(x, np.where(touching, penetration[shown], np.nan))
        np.testing.assert_allclose(y, force[shown])
        assert_holds(axis, x, y[touching])
        peak = force.argmax()
        assert greatest.get_xydata()[0] == pytest.approx([penetration[peak], force[peak]])
        assert_holds(axis, penetration[[peak]], force[[peak]])
        area = loss_per_period(samples, gear)
        assert area and f"{1e3 * area:.3g} mJ per mesh period" in axis.get_title(loc="left")


def test_pressure_angle_shows_the_last_mesh_periods_and_the_range_of_the_window(samples: Samples) -> None:
    figure = time_series.pressure_angle_figure(samples, Parameters())
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "pressure angle\n(°)",
        "angle of the line\nof centres (°)",
    ]
    assert figure.axes[-1].get_xlabel().endswith("s (ms)")
    names = ("pressure_angle", "position_angle")
    for axis, name, nominal in zip(figure.axes, names, (20.0, 0.0), strict=True):
        values = np.degrees(samples[name])
        x, y = line(axis, "dynamic")
        np.testing.assert_allclose(y, values[-len(y) :])
        assert_holds(axis, x, y)
        assert line(axis, "nominal")[1] == pytest.approx([nominal] * 2)
        (band,) = axis.patches
        _, low = band.get_xy()
        assert (low, low + band.get_height()) == pytest.approx((values.min(), values.max()))
    alone = time_series.pressure_angle_figure(only(samples, "time", "pressure_angle"), Parameters())
    assert len(alone.axes) == 1


def test_meshing_shares_add_up_over_the_run_and_in_every_window(samples: Samples) -> None:
    timeline = MeshingTimeline()
    timeline.add(samples)
    windows = [samples.last(3000), samples.last(1000)]
    course, bars = meshing_shares.meshing_shares_figure(timeline, [CHANGE * INTERVAL], windows).axes[:2]
    assert course.get_xlabel() == "simulated time (s)" and course.get_ylabel() == "share of time (%)"
    assert "from event times" in course.get_title(loc="left")
    stacked: Any = [patch.get_data() for patch in course.patches[:3]]
    np.testing.assert_allclose(stacked[0].baseline, 0.0)
    np.testing.assert_allclose(stacked[1].baseline, stacked[0].values)
    np.testing.assert_allclose(stacked[2].baseline, stacked[1].values)
    np.testing.assert_allclose(stacked[2].values, 100.0)
    heights = np.array([bar.get_height() for bar in bars.patches]).reshape(3, 3)
    np.testing.assert_allclose(heights.sum(axis=1), 100.0)
    for found, part in zip(heights, (samples, *windows), strict=True):
        counted = [100.0 * np.mean(part["meshing_state"] == state) for state in (1.0, 0.0, -1.0)]
        np.testing.assert_allclose(found, counted, atol=1.0)
    assert [label.get_text() for label in bars.get_xticklabels()] == ["run", "1", "2"]


def chirp(amplitude: float) -> SpeedSpectra:
    """A run-up from 200 to 800 rad/s in 1 s, on which the DTE has ``amplitude`` in m at mesh order 1."""
    run_up = RunUp(TimeSpan(0.0, 1.0), 200.0, 800.0)
    time = INTERVAL * np.arange(100_000)
    speed = 200.0 + 600.0 * time
    angle = 40.0 * (200.0 * time + 300.0 * time**2)
    values = np.column_stack([25e-6 + amplitude * np.cos(angle), speed, np.full_like(time, -45.0)])
    spectra = SpeedSpectra(run_up, 40, INTERVAL)
    for first in range(0, len(values), 7001):
        block = values[first : first + 7001]
        spectra.add(Samples(first, INTERVAL, ("dte", "driving_speed", "load_torque"), block))
    return spectra


def test_order_map_has_its_ridge_on_the_ray_of_its_order() -> None:
    spectra = chirp(3e-6)
    axis, bar = order_map.order_map_figure(spectra, Parameters()).axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("speed of the driving gear (rad/s)", "frequency (kHz)")
    assert bar.get_ylabel() == "amplitude of DTE (µm)"
    (image,) = axis.images
    drawn = np.asarray(image.get_array())
    left, right, bottom, top = image.get_extent()
    rows, columns = drawn.shape
    speeds = left + (np.arange(columns) + 0.5) * (right - left) / columns
    ridge = bottom + drawn.argmax(axis=0) * (top - bottom) / (rows - 1)
    np.testing.assert_allclose(ridge, 1e-3 * 40 * speeds / (2.0 * np.pi), atol=0.15)
    assert 0.8 * 3.0 < np.median(drawn.max(axis=0)) < 3.02
    rays = [found for found in axis.get_lines() if found.get_xydata()[0][0] == pytest.approx(200.0)]
    slopes = [found.get_xydata()[1][1] / found.get_xydata()[1][0] for found in rays]
    assert slopes == pytest.approx([1e-3 * 40 / (2.0 * np.pi) * order for order in order_map.DRAWN_ORDERS])
    level = sorted(found.get_ydata()[0] for found in axis.get_lines() if found not in rays)
    load = 45.0 / base_radii(Parameters())[1]
    found = {round(f / (2e3 * np.pi), 3) for f in natural_frequencies(Parameters(), load, 3e8)}
    assert level == pytest.approx(sorted(found))


def test_a_thinned_curve_keeps_its_extremes() -> None:
    x = np.arange(100_000.0)
    y = np.sin(1e-3 * x)
    y[12_345], y[54_321] = 7.0, -9.0
    kept_x, kept_y = style.thinned(x, y, columns=100)
    assert len(kept_x) <= 202 and (np.diff(kept_x) > 0.0).all()
    assert (kept_x[0], kept_x[-1]) == (x[0], x[-1])
    assert kept_y[kept_x == 12_345] == 7.0 and kept_y[kept_x == 54_321] == -9.0
    np.testing.assert_array_equal(y[kept_x.astype(int)], kept_y)
    assert style.thinned(x[:200], y[:200], columns=100)[0] is not None


def test_a_vector_file_is_always_the_same_and_shows_what_the_picture_shows(samples: Samples) -> None:
    written = []
    for _ in range(2):
        with io.BytesIO() as stream:
            figures.write_svg(phase_portrait.phase_portrait_figure(samples), stream)
            written.append(stream.getvalue())
    assert written[0] == written[1]
    assert b"<dc:date>" not in written[0]
    root = ElementTree.fromstring(written[0])
    names = [element.get(f"{XLINK}href", "") for element in root.iter(f"{SVG}image")]
    (dense,) = [base64.b64decode(name.partition(",")[2]) for name in names]
    picture = np.asarray(Image.open(io.BytesIO(dense)).convert("RGBA")).astype(int)
    assert 0.02 < (picture[..., 3] > 0).mean() < 0.98, "the motion is drawn, on a clear ground"


def figure_data(samples: Samples) -> FigureData:
    envelope = Envelope()
    envelope.add(samples, derived_quantities(samples))
    timeline = MeshingTimeline()
    timeline.add(samples)
    return FigureData(Parameters(), envelope, [CHANGE * INTERVAL], samples, [samples], timeline, chirp(1e-6))


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
    few = figure_data(only(samples, "time", "dte").last(10))._replace(run_up=None)
    assert list(figures.recording_figures(few)) == ["overview", "time_series"]
    lacking = figures.lacking_figures(few)
    assert set(lacking) == set(figures.FIGURE_NAMES) - {"overview", "time_series"}
    assert lacking["phase_portrait"] == "not recorded: dte_rate"
    assert lacking["order_map"] == "not recorded: driving_speed"
    assert "no run-up" in figures.lacking_figures(figure_data(samples)._replace(run_up=None))["order_map"]
    assert lacking["spectrum"] == "the window has 10 samples, a spectrum needs 40"
