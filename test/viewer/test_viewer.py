"""The viewer with real engine chunks, real files and real ports."""

from __future__ import annotations

import socket
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.viewer import Viewer, open_viewer
from gear_dynamics_ros.viewer.decimation import extreme_indices
from gear_dynamics_ros.viewer.stream import contiguous_blocks
from support.domains import free_port
from support.processes import until
from support.rerun_files import Rerun, rows_of

rerun = pytest.importorskip("rerun", reason="Rerun is optional at run time")

CHUNKS = 100
INTERVAL_NS = 10_000


def made_for(mode: str, **settings: object) -> Parameters:
    return Parameters.from_flat({"rerun.mode": mode, **{f"rerun.{name}": v for name, v in settings.items()}})


@pytest.fixture(scope="module")
def chunks() -> list[Chunk]:
    engine = Engine(Parameters())
    return [engine.advance() for _ in range(CHUNKS)]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, chunks: list[Chunk]) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "new folder" / "run.rrd"
    viewer = Viewer(made_for("save", path=str(path)))
    for chunk in chunks:
        viewer.write(chunk)
    viewer.close()
    assert viewer.error is None
    assert viewer.dropped == 0
    assert viewer.queued == 0
    return path


def test_off_is_no_viewer() -> None:
    assert open_viewer(Parameters()) is None


def test_saved_file_is_whole_and_holds_every_view(saved: Path, rerun_command: Rerun) -> None:
    rerun_command("rrd", "verify", saved)
    described = rerun_command("rrd", "stats", saved)
    for entity in (
        "/mesh/dte",
        "/mesh/force",
        "/mesh/pressure_angle",
        "/bearing/driving/contact",
        "/bearing/driven/film",
        "/shaft/speed/driven",
        "/shaft/torque/drive",
        "/orbit/driving/path",
        "/orbit/driven/circles",
        "/phase/portrait/path",
        "/phase/strobe/samples",
        "/time_panel",
    ):
        assert f"{entity}:" in described


@pytest.fixture(scope="module")
def samples(chunks: list[Chunk]) -> NDArray[np.float64]:
    return np.vstack([chunk.samples for chunk in chunks])


def column(samples: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    return samples[:, COLUMN[name]]


CURVES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "/mesh/dte": lambda s: column(s, "dte") * 1e6,
    "/mesh/force": lambda s: column(s, "mesh_force"),
    "/mesh/pressure_angle": lambda s: np.degrees(column(s, "pressure_angle")),
    "/mesh/state": lambda s: column(s, "meshing_state"),
    "/shaft/speed/driving": lambda s: column(s, "driving_speed"),
    "/shaft/speed/driven": lambda s: column(s, "driven_speed"),
    "/shaft/torque/drive": lambda s: column(s, "drive_torque"),
    "/shaft/torque/load": lambda s: column(s, "load_torque"),
    **{
        f"/bearing/{gear}/{kind}": lambda s, name=f"{gear}_{kind}_force": np.hypot(
            column(s, f"{name}_x"), column(s, f"{name}_y")
        )
        for gear in ("driving", "driven")
        for kind in ("contact", "film")
    },
}


@pytest.mark.parametrize("entity", CURVES)
def test_curves_have_the_samples_values_at_their_times_and_every_peak(
    saved: Path, samples: NDArray[np.float64], entity: str
) -> None:
    found = rows_of(saved, entity, "Scalars:scalars", "sim_time")
    at = np.rint(found.times_ns / INTERVAL_NS).astype(int)
    np.testing.assert_allclose(found.times_ns, at * INTERVAL_NS, rtol=0.0, atol=1.0)
    expected = CURVES[entity](samples)
    values = np.array(found.values)[:, 0]
    np.testing.assert_allclose(values, expected[at], rtol=1e-15)
    assert (np.diff(at) > 0).all()
    # The lowest and the highest of every 100 samples, which are one where nothing changes.
    for begin in range(0, len(expected), 100):
        block, kept = expected[begin : begin + 100], values[(at >= begin) & (at < begin + 100)]
        assert (kept.min(), kept.max()) == pytest.approx((block.min(), block.max()), rel=1e-15)
        assert len(kept) <= 2


def pictures(saved: Path, entity: str, component: str) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Index behind the last sample of each picture, and its points (n, 2) with y upward."""
    found = rows_of(saved, entity, component, "sim_time")
    assert len(found.values) == 5  # every 40 ms of 0.2 s
    for time_ns, value in zip(found.times_ns, found.values, strict=True):
        points = np.array(value[0] if component.startswith("LineStrips") else value, dtype=float)
        yield round(time_ns / INTERVAL_NS) + 1, points * [1.0, -1.0]


@pytest.mark.parametrize("gear", ["driving", "driven"])
def test_orbits_are_the_paths_of_the_journals_in_micrometres(
    saved: Path, samples: NDArray[np.float64], gear: str
) -> None:
    path = np.column_stack([column(samples, f"{gear}_x"), column(samples, f"{gear}_y")]) * 1e6
    ends = []
    for end, points in pictures(saved, f"/orbit/{gear}/path", "LineStrips2D:strips"):
        np.testing.assert_allclose(points, path[max(0, end - 1000) : end], rtol=1e-6, atol=1e-6)
        ends.append(end)
    assert np.diff(ends).tolist() == [4000] * 4
    for end, points in pictures(saved, f"/orbit/{gear}/now", "Points2D:positions"):
        np.testing.assert_allclose(points, path[end - 1 : end], rtol=1e-6, atol=1e-6)


def test_phase_pictures_are_in_half_backlashes_of_the_mesh_mode(
    saved: Path, samples: NDArray[np.float64]
) -> None:
    half_backlash, torsion = 25e-6, 2.0 * np.pi * 4654.579  # m; rad/s, docs/validation.md
    dte, rate = column(samples, "dte") / half_backlash, column(samples, "dte_rate")
    portrait = np.column_stack([dte, rate / (half_backlash * torsion)])
    for end, points in pictures(saved, "/phase/portrait/path", "LineStrips2D:strips"):
        np.testing.assert_allclose(points, portrait[max(0, end - 1000) : end], rtol=1e-6, atol=1e-6)
    turns = column(samples, "mesh_phase") / (2.0 * np.pi)
    for end, points in pictures(saved, "/phase/strobe/samples", "Points2D:positions"):
        shown = slice(max(0, end - 1000), end)
        width = np.ptp(points[:, 0]) / np.ptp(turns[shown])
        np.testing.assert_allclose(points[:, 0], width * turns[shown], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(points[:, 1], dte[shown], rtol=1e-6, atol=1e-6)


def test_saved_file_is_small(saved: Path, chunks: list[Chunk]) -> None:
    seconds = CHUNKS * len(chunks[0]) * chunks[0].interval_ns * 1e-9
    assert saved.stat().st_size < 200_000 + 2_500_000 * seconds


def test_existing_file_is_kept(saved: Path) -> None:
    before = saved.read_bytes()
    with pytest.raises(UsageError, match=r"rerun\.path .*run\.rrd exists already"):
        Viewer(made_for("save", path=str(saved)))
    assert saved.read_bytes() == before


def test_file_below_a_file_is_refused(saved: Path) -> None:
    with pytest.raises(UsageError, match=r"rerun\.path .*folder can't be made"):
        Viewer(made_for("save", path=str(saved / "deeper" / "run.rrd")))


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_server_listens_on_loopback_and_a_busy_port_is_refused(chunks: list[Chunk]) -> None:
    port = free_port()
    viewer = Viewer(made_for("serve", port=port))
    try:
        for chunk in chunks:
            viewer.write(chunk)
        until(lambda: answers(port), f"something listens on port {port}")
        with pytest.raises(UsageError, match=rf"rerun\.port {port} can't be used"):
            Viewer(made_for("serve", port=port))
    finally:
        viewer.close()
    assert viewer.error is None
    assert viewer.dropped == 0


def test_without_a_viewer_to_connect_to_everything_is_dropped_and_counted(chunks: list[Chunk]) -> None:
    viewer = Viewer(made_for("connect", url=f"rerun+http://127.0.0.1:{free_port()}/proxy"))
    for chunk in chunks:
        viewer.write(chunk)
    viewer.close()
    assert viewer.dropped == CHUNKS
    assert viewer.error is None


def test_connects_to_a_viewer_that_answers(chunks: list[Chunk]) -> None:
    port = free_port()
    server = rerun.RecordingStream("server")
    server.set_sinks(rerun.GrpcServerSink("127.0.0.1", port))
    try:
        viewer = Viewer(made_for("connect", url=f"rerun+http://127.0.0.1:{port}/proxy"))
        for chunk in chunks:
            viewer.write(chunk)
        viewer.close()
        assert viewer.error is None
        assert viewer.dropped == 0
    finally:
        server.disconnect()


def test_what_comes_after_the_end_is_dropped_and_counted(chunks: list[Chunk], tmp_path: Path) -> None:
    viewer = Viewer(made_for("save", path=str(tmp_path / "run.rrd")))
    viewer.close()
    for chunk in chunks:
        viewer.write(chunk)
    assert viewer.dropped == CHUNKS
    viewer.close()


@pytest.mark.parametrize("url", ["rerun://nowhere", "rerun+http://127.0.0.1:port/proxy"])
def test_addresses_without_a_port_are_refused(url: str) -> None:
    with pytest.raises(UsageError, match=r"rerun\.url .* is not the address of a viewer"):
        Viewer(made_for("connect", url=url))


def test_without_rerun_one_clear_line_says_so() -> None:
    program = textwrap.dedent(
        """
        import sys
        sys.modules["rerun"] = None
        import gear_dynamics_ros.analysis.summary
        from gear_dynamics_ros.errors import UsageError
        from gear_dynamics_ros.parameters import Parameters
        from gear_dynamics_ros.viewer import open_viewer
        assert open_viewer(Parameters()) is None
        try:
            open_viewer(Parameters.from_flat({"rerun.mode": "serve"}))
        except UsageError as error:
            print(error)
        """
    )
    found = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert found.startswith("rerun.mode is serve, but Rerun can't be imported")
    assert "pip install rerun-sdk" in found
    assert found.count("\n") == 1


def test_decimation_keeps_every_peak() -> None:
    values = np.sin(np.arange(1234) * 0.37)
    values[[17, 700, 1230]] = 5.0, -5.0, 7.0
    kept = extreme_indices(values, 100)
    assert np.all(np.diff(kept) > 0)
    assert {17, 700, 1230} <= set(kept.tolist())
    assert len(kept) == 26
    for start in range(0, len(values), 100):
        block, chosen = values[start : start + 100], values[kept[(kept >= start) & (kept < start + 100)]]
        assert (chosen.min(), chosen.max()) == (block.min(), block.max())


def test_decimation_of_little_and_of_constants() -> None:
    assert extreme_indices(np.empty(0), 10).tolist() == []
    assert extreme_indices(np.ones(25), 10).tolist() == [0, 10, 20]


def test_a_dropped_chunk_leaves_a_gap(chunks: list[Chunk]) -> None:
    runs = contiguous_blocks([*chunks[:3], *chunks[5:7]])
    assert [len(run) for run in runs] == [3 * len(chunks[0]), 2 * len(chunks[0])]
    np.testing.assert_array_equal(runs[1][0], chunks[5].samples[0])
