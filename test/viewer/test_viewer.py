"""The viewer with real engine chunks, real files and real ports."""

from __future__ import annotations

import socket
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.signals import Chunk
from gear_dynamics_ros.viewer import Viewer, open_viewer
from gear_dynamics_ros.viewer.decimation import extremes
from gear_dynamics_ros.viewer.stream import contiguous
from support.domains import free_port
from support.processes import until
from support.rerun_files import Rerun

rerun = pytest.importorskip("rerun", reason="Rerun is optional at run time")

CHUNKS = 100


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


def test_saved_file_is_small(saved: Path, chunks: list[Chunk]) -> None:
    seconds = CHUNKS * len(chunks[0]) * chunks[0].interval_ns * 1e-9
    assert saved.stat().st_size < 200_000 + 6_000_000 * seconds


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
    with pytest.raises(UsageError, match=r"rerun\.url .* is no address of a viewer"):
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
    kept = extremes(values, 100)
    assert np.all(np.diff(kept) > 0)
    assert {17, 700, 1230} <= set(kept.tolist())
    assert len(kept) == 26
    for start in range(0, len(values), 100):
        block, chosen = values[start : start + 100], values[kept[(kept >= start) & (kept < start + 100)]]
        assert (chosen.min(), chosen.max()) == (block.min(), block.max())


def test_decimation_of_little_and_of_constants() -> None:
    assert extremes(np.empty(0), 10).tolist() == []
    assert extremes(np.ones(25), 10).tolist() == [0, 10, 20]


def test_a_dropped_chunk_leaves_a_gap(chunks: list[Chunk]) -> None:
    runs = contiguous([*chunks[:3], *chunks[5:7]])
    assert [len(run) for run in runs] == [3 * len(chunks[0]), 2 * len(chunks[0])]
    np.testing.assert_array_equal(runs[1][0], chunks[5].samples[0])
