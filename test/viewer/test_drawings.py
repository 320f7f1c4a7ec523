"""What stands in a saved file: entities and values read back, against the samples."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, COLUMN, GEARS
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.events import RESET, OperatorEvent
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.viewer import Viewer
from support.rerun_files import fixed_value, rows_of

rerun = pytest.importorskip("rerun", reason="Rerun is optional at run time")

CHUNKS = 150
INTERVAL_NS = 10_000
WIDTH = 400  # samples of which a curve keeps the least and the greatest
# Teeth lose contact, and back flanks strike.
RATTLE = {"operation.speed": 1000.0, "operation.drive_torque": 2.0, "operation.load_torque": 2.0}
STATE_COLOURS = {1.0: 0x56B4E9FF, 0.0: 0xF0E442FF, -1.0: 0xD55E00FF}
GAP, HUB = 20.0, 500.0  # magnifications, as the text says

Samples = NDArray[np.float64]


@pytest.fixture(scope="module")
def chunks() -> list[Chunk]:
    engine = Engine(Parameters.from_flat(RATTLE))
    return [engine.advance() for _ in range(CHUNKS)]


@pytest.fixture(scope="module")
def samples(chunks: list[Chunk]) -> Samples:
    return np.vstack([chunk.samples for chunk in chunks])


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, chunks: list[Chunk]) -> Path:
    path = tmp_path_factory.mktemp("drawings") / "run.rrd"
    viewer = Viewer(Parameters.from_flat({**RATTLE, "rerun.mode": "save", "rerun.path": str(path)}))
    for chunk in chunks:
        viewer.write(chunk)
    viewer.write_event(OperatorEvent(20_000, 0.2, RESET, "by hand", chunks[-1].counters))
    viewer.write_pace(0.25, 0.98)
    viewer.close()
    assert viewer.error is None
    return path


def column(samples: Samples, name: str) -> Samples:
    return samples[:, COLUMN[name]]


def force(samples: Samples, gear: str, *kinds: str) -> Samples:
    x, y = (sum(column(samples, f"{gear}_{kind}_force_{axis}") for kind in kinds) for axis in ("x", "y"))
    return np.hypot(x, y)


CURVES: dict[str, Callable[[Samples], Samples]] = {
    "dte": lambda s: column(s, "dte") * 1e6,
    "half_backlash": lambda s: column(s, "half_backlash") * 1e6,
    "minus_half_backlash": lambda s: column(s, "half_backlash") * -1e6,
    "mesh_force": lambda s: column(s, "mesh_force"),
    "pressure_angle": lambda s: np.degrees(column(s, "pressure_angle")),
    "driving_speed": lambda s: column(s, "driving_speed"),
    "driven_speed": lambda s: column(s, "driven_speed"),
    "drive_torque": lambda s: column(s, "drive_torque"),
    "load_torque": lambda s: column(s, "load_torque"),
    **{f"{gear}_penetration": lambda s, n=f"{gear}_penetration": column(s, n) * 1e6 for gear in GEARS},
    **{
        f"{gear}_{name}_force": lambda s, gear=gear, kinds=kinds: force(s, gear, *kinds)
        for gear in GEARS
        for name, kinds in (("contact", ["contact"]), ("film", ["film"]), ("bearing", ["contact", "film"]))
    },
}


def indices(times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Samples at ``times_ns``, which must be those of samples."""
    at = np.rint(times_ns / INTERVAL_NS).astype(np.int64)
    np.testing.assert_allclose(times_ns, at * INTERVAL_NS, rtol=0.0, atol=1.0)
    return at


@pytest.mark.parametrize("name", CURVES)
def test_curves_have_the_samples_values_at_their_times_and_every_peak(
    saved: Path, samples: Samples, name: str
) -> None:
    found = rows_of(saved, f"/waveform/{name}", "Scalars:scalars", "sim_time")
    at, expected = indices(found.times_ns), CURVES[name](samples)
    values = np.array(found.values)[:, 0]
    np.testing.assert_allclose(values, expected[at], rtol=1e-12)
    assert (np.diff(at) > 0).all()
    for begin in range(0, len(expected), WIDTH):
        block, kept = expected[begin : begin + WIDTH], values[(at >= begin) & (at < begin + WIDTH)]
        assert (kept.min(), kept.max()) == pytest.approx((block.min(), block.max()), rel=1e-12)


def test_curves_bear_the_names_and_units_of_the_channels(saved: Path) -> None:
    display = {"m": "µm", "rad": "°"}
    for channel in CHANNELS:
        if channel.name in CURVES:
            unit = display.get(channel.unit, channel.unit)
            labels = fixed_value(saved, f"/waveform/{channel.name}", "SeriesLines:names")
            assert labels == [f"{channel.name} ({unit})"]


def test_gears_have_their_teeth_and_turn_with_the_channels_angle(saved: Path, samples: Samples) -> None:
    for gear in GEARS:
        (outline,) = fixed_value(saved, f"/scene/{gear}/outline", "LineStrips2D:strips")
        outside = np.hypot(*np.array(outline).T) > 60.0
        assert np.count_nonzero(np.diff(outside.astype(int)) == 1) == 40
    found = rows_of(saved, "/scene/driving", "Transform3D:quaternion", "sim_time")
    at = indices(found.times_ns)
    assert len(at) >= 4
    quaternion = np.array(found.values)[:, 0]
    # Rerun's y axis points down, so counter-clockwise is negative there.
    angle = -2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3])
    difference = np.mod(angle - column(samples, "driving_angle")[at] + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-5)


def test_gears_and_journals_are_displaced_by_the_stated_factors(saved: Path, samples: Samples) -> None:
    for gear, middle in (("driving", 0.0), ("driven", 120.0)):
        for entity, component, factor in (
            (f"/scene/{gear}", "Transform3D:translation", GAP),
            (f"/scene/hub/{gear}/journal", "Points2D:positions", HUB),
        ):
            found = rows_of(saved, entity, component, "sim_time")
            at, drawn = indices(found.times_ns), np.array(found.values)[:, 0, :2]
            np.testing.assert_allclose(
                drawn[:, 0], middle + 1e3 * factor * column(samples, f"{gear}_x")[at], atol=1e-4
            )
            np.testing.assert_allclose(
                drawn[:, 1], -1e3 * factor * column(samples, f"{gear}_y")[at], atol=1e-4
            )
    text = fixed_value(saved, "/about/view", "TextDocument:text")[0]
    assert f"**{GAP:g} times**" in text
    assert f"**{HUB:g} times**" in text


def test_slow_motion_has_every_sample_where_contact_is_lost(saved: Path, samples: Samples) -> None:
    """The window is one of the run, at a constant rate, and its flanks have the colours of the states."""
    curve = rows_of(saved, "/waveform/dte", "Scalars:scalars", "slow_motion")
    values = np.array(curve.values)[:, 0]
    dte = column(samples, "dte") * 1e6
    first = int(np.argmax(np.isnan(values)))  # a gap ends the window
    assert first > 100
    assert np.ptp(np.diff(curve.times_ns[:first])) <= 1
    begins = np.flatnonzero(np.isclose(dte, values[0], rtol=1e-12))
    (begin,) = [b for b in begins if np.allclose(dte[b : b + first], values[:first], rtol=1e-12)]
    states = column(samples, "meshing_state")[begin : begin + first]
    assert {1.0, 0.0, -1.0} <= set(states)
    flanks = rows_of(saved, "/scene/flanks", "LineStrips2D:colors", "slow_motion")
    shown = flanks.times_ns < curve.times_ns[first - 1]
    at = np.searchsorted(curve.times_ns, flanks.times_ns[shown])
    colours = [value[0] for value, used in zip(flanks.values, shown, strict=True) if used]
    assert colours == [STATE_COLOURS[state] for state in states[at]]


def test_stills_show_each_state(saved: Path) -> None:
    for name, state in (("drive", 1.0), ("apart", 0.0), ("back", -1.0)):
        assert (
            fixed_value(saved, f"/moments/{name}/flanks", "LineStrips2D:colors") == [STATE_COLOURS[state]] * 2
        )
    gap = np.array(fixed_value(saved, "/moments/apart/gap", "LineStrips2D:strips")[0])
    (title,) = fixed_value(saved, "/moments/apart/title", "Points2D:labels")
    stated = float(title.split("gap ")[1].removesuffix(" µm"))
    assert np.hypot(*(gap[1] - gap[0])) == pytest.approx(stated * 1e-3 * GAP, abs=0.05e-3 * GAP + 1e-5)


def test_orbits_are_the_paths_of_the_journals_in_micrometres(saved: Path, samples: Samples) -> None:
    for gear in GEARS:
        path = np.column_stack([column(samples, f"{gear}_x"), -column(samples, f"{gear}_y")]) * 1e6
        found = rows_of(saved, f"/orbit/{gear}/path", "LineStrips2D:strips", "sim_time")
        ends = indices(found.times_ns) + 1
        assert ends.tolist() == [1, 10_000, 20_000, 30_000]
        for end, (line,) in zip(ends, found.values, strict=True):
            np.testing.assert_allclose(line, path[end - len(line) : end], rtol=1e-5, atol=1e-5)
        circles = fixed_value(saved, f"/orbit/{gear}/clearance", "LineStrips2D:strips")
        np.testing.assert_allclose(np.hypot(*np.array(circles[0]).T), 27.0, rtol=1e-6)
        film = fixed_value(saved, f"/orbit/{gear}/film", "LineStrips2D:strips")
        np.testing.assert_allclose(np.hypot(*np.array(film[0]).T), 150.0, rtol=1e-6)


def test_phase_portrait_is_in_half_backlashes_of_the_mesh_mode(saved: Path, samples: Samples) -> None:
    half_backlash, torsion = 25e-6, 2.0 * np.pi * 4654.579  # m; rad/s, docs/validation.md
    dte, rate = column(samples, "dte") / half_backlash, column(samples, "dte_rate")
    portrait = np.column_stack([dte, -rate / (half_backlash * torsion)])
    found = rows_of(saved, "/phase_portrait/path", "LineStrips2D:strips", "sim_time")
    for time, (line,) in zip(indices(found.times_ns), found.values, strict=True):
        np.testing.assert_allclose(line, portrait[time + 1 - len(line) : time + 1], rtol=1e-5, atol=1e-5)
    points = np.array(rows_of(saved, "/phase_portrait/poincare", "Points2D:positions", "sim_time").values[-1])
    assert len(points) > 100
    assert np.abs(points[:, 0]).max() <= np.abs(portrait[:, 0]).max() + 1e-3


def test_impacts_commands_events_energies_and_pace_are_drawn(saved: Path, chunks: list[Chunk]) -> None:
    impacts = np.concatenate([chunk.impacts for chunk in chunks])
    for number, gear in enumerate(GEARS):
        mine = impacts[impacts[:, 2] == number]
        found = rows_of(saved, f"/impact/{gear}", "Scalars:scalars", "sim_time")
        speeds = np.array(found.values)[:, 0]
        assert speeds.max() == pytest.approx(mine[:, 3].max(), rel=1e-12)
        assert np.isin(np.round(speeds, 12), np.round(mine[:, 3], 12)).all()
        assert np.isin(found.times_ns, np.rint(mine[:, 0] * 1e9)).all()
    torque = rows_of(saved, "/command/drive_torque", "Scalars:scalars", "sim_time")
    assert set(np.array(torque.values)[:, 0]) == {2.0}
    (line,) = rows_of(saved, "/event", "TextLog:text", "sim_time").values
    assert line == ["0.200000 s: reset: by hand"]
    pace = rows_of(saved, "/pacing/real_time_factor", "Scalars:scalars", "sim_time")
    assert (pace.times_ns.tolist(), pace.values) == ([250_000_000], [[0.98]])
    loss = rows_of(saved, "/energy/mesh_loss", "Scalars:scalars", "sim_time")
    assert len(loss.values) == len(rows_of(saved, "/energy/residual", "Scalars:scalars", "sim_time").values)
    assert "back flanks in contact" in fixed_value(saved, "/about/run", "TextDocument:text")[0]


def test_spectrum_of_dte_has_its_line_at_the_mesh_frequency() -> None:
    from gear_dynamics_ros.viewer.order_spectrum import order_amplitudes

    rows = np.zeros((4000, len(COLUMN)))
    turns = 0.02 * np.arange(4000) + 2e-6 * np.arange(4000) ** 2  # the speed rises
    rows[:, COLUMN["mesh_phase"]] = np.mod(2.0 * np.pi * turns, 2.0 * np.pi)
    rows[:, COLUMN["dte"]] = 3e-6 * np.sin(2.0 * np.pi * turns) + 1e-6 * np.sin(4.0 * np.pi * turns)
    found = order_amplitudes(rows)
    assert found is not None
    for order, amplitude in ((1.0, 3e-6), (2.0, 1e-6)):
        at = np.argmin(np.abs(found.order - order))
        assert found.amplitude[at] == pytest.approx(amplitude, rel=5e-3)
    assert found.amplitude[np.abs(found.order - 3.0).argmin()] < 2e-8
    assert order_amplitudes(rows[:10]) is None


def test_each_doubling_of_a_run_takes_half_of_its_begin(chunks: list[Chunk], tmp_path: Path) -> None:
    """Frames and points of a run drawn at full density for its first 64 ms."""
    from gear_dynamics_ros.viewer.run_block import blocks_of
    from gear_dynamics_ros.viewer.run_display import RunDisplay
    from gear_dynamics_ros.viewer.thinning import Density

    stream = rerun.RecordingStream("gear_dynamics_ros")
    stream.set_sinks(rerun.FileSink(tmp_path / "long.rrd"))
    display = RunDisplay(stream, Parameters.from_flat(RATTLE), Density(0.064))
    for begin in range(0, 128, 16):
        for block in blocks_of(chunks[begin : begin + 16]):
            display.draw(block)
    display.canvas.send()
    stream.flush(timeout_sec=10.0)
    stream.disconnect()
    times = rows_of(tmp_path / "long.rrd", "/waveform/dte", "Scalars:scalars", "sim_time").times_ns
    at = times / 1e9
    shares = [np.count_nonzero((at >= low) & (at < 2.0 * low)) for low in (0.064, 0.128)]
    full = np.count_nonzero(at < 0.064)
    assert all(0.4 * full <= share <= 0.62 * full for share in shares)
