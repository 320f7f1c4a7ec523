"""The viewer with real engine chunks, real files and real ports: modes, queue, thinning."""

from __future__ import annotations

import socket
import subprocess
import sys
import textwrap
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.viewer import Viewer, open_viewer
from gear_dynamics_ros.viewer.run_block import blocks_of
from gear_dynamics_ros.viewer.thinning import Density, extreme_indices, strobe_indices
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


def test_saved_file_and_its_layouts_are_whole(saved: Path, rerun_command: Rerun) -> None:
    layouts = sorted(saved.parent.glob("*.rbl"))
    names = [path.name.split(".")[1] for path in layouts]
    assert names == ["bearings", "dynamics", "operator", "overview"]
    rerun_command("rrd", "verify", saved, *layouts)


def test_saved_file_is_small(saved: Path, chunks: list[Chunk]) -> None:
    seconds = CHUNKS * len(chunks[0]) * chunks[0].interval_ns * 1e-9
    # The slow motion does not grow with the run.
    assert saved.stat().st_size < 3_500_000 + 600_000 * seconds


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


def listening_addresses(*ports: int) -> set[str]:
    """Addresses on which any program listens at one of ``ports``."""
    listening = "0A"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    places = [row[1].split(":") for row in rows if row[3] == listening]
    assert not any(int(port, 16) in ports for port in tcp6_ports(listening))
    return {
        socket.inet_ntoa(bytes.fromhex(address)[::-1]) for address, port in places if int(port, 16) in ports
    }


def tcp6_ports(state: str) -> list[str]:
    path = Path("/proc/net/tcp6")
    rows = [line.split() for line in path.read_text().splitlines()[1:]] if path.exists() else []
    return [row[1].rpartition(":")[2] for row in rows if row[3] == state]


def test_server_listens_on_loopback_and_a_busy_port_is_refused(chunks: list[Chunk]) -> None:
    port, web_port = free_port(), free_port()
    viewer = Viewer(made_for("serve", port=port, web_port=web_port))
    try:
        for chunk in chunks:
            viewer.write(chunk)
        until(lambda: answers(port) and answers(web_port), f"something listens on ports {port}, {web_port}")
        assert listening_addresses(port, web_port) == {"127.0.0.1"}
        assert viewer.address.startswith(
            f"http://127.0.0.1:{web_port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}"
        )
        with urllib.request.urlopen(viewer.address, timeout=10.0) as page:
            assert b"Rerun" in page.read()
        with pytest.raises(UsageError, match=rf"rerun\.port {port} can't be used"):
            Viewer(made_for("serve", port=port, web_port=free_port()))
        with pytest.raises(UsageError, match=rf"rerun\.web_port {web_port} can't be used"):
            Viewer(made_for("serve", port=free_port(), web_port=web_port))
    finally:
        viewer.close()
    assert viewer.error is None
    assert viewer.dropped == 0
    assert not answers(web_port)


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
    blocks = list(blocks_of([*chunks[:3], *chunks[5:7]]))
    assert [len(block.rows) for block in blocks] == [3 * len(chunks[0]), 2 * len(chunks[0])]
    assert blocks[1].first_sample == chunks[5].first_sample
    np.testing.assert_array_equal(blocks[1].rows[0], chunks[5].samples[0])


def test_blocks_of_the_decimation_begin_at_multiples_of_their_width() -> None:
    values = np.cos(np.arange(1000) * 0.2)
    whole = set(extreme_indices(values, 100).tolist())
    parts = {
        i + begin
        for begin, end in ((0, 330), (330, 1000))
        for i in extreme_indices(values[begin:end], 100, begin)
    }
    assert whole <= parts
    assert len(parts) <= len(whole) + 2


def test_a_strobe_shows_the_phase_it_is_set_to_or_slow_motion_as_it_is() -> None:
    phase = np.mod(0.7 * np.arange(1000), 2.0 * np.pi)
    ends, targets = np.array([300, 600, 900]), np.array([0.5, 1.5, 6.2])
    chosen = strobe_indices(phase, ends, targets, 100)
    off = np.mod(phase[chosen] - targets + np.pi, 2.0 * np.pi) - np.pi
    assert (np.abs(off) < 0.7 / 2.0).all()
    assert ((chosen < ends) & (chosen >= ends - 100)).all()
    slow = np.linspace(0.0, 1.0, 1000)
    assert strobe_indices(slow, ends, targets, 100).tolist() == [299, 599, 899]


def test_points_are_further_apart_each_time_a_run_has_doubled() -> None:
    density = Density(60.0)
    assert [density.spacing(time) for time in (0.0, 59.9, 60.0, 119.0, 120.0, 3600.0)] == [1, 1, 2, 2, 4, 64]
    assert Density(float("inf")).spacing(1e9) == 1
