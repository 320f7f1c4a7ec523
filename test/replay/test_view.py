"""``replay view``: a recording in Rerun, with the pictures of the live viewer."""

from __future__ import annotations

import signal
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.replay.view import recorded_blocks
from gear_dynamics_ros.simulation.run import Run
from support.domains import free_port
from support.processes import StartProcess
from support.recordings import record
from support.rerun_files import fixed_value, rows_of
from support.terminal import error_line

rerun = pytest.importorskip("rerun", reason="Rerun is optional at run time")

CHUNKS = 150
RATTLE = {"operation.speed": 1000.0, "operation.drive_torque": 2.0, "operation.load_torque": 2.0}
LATER = Commands(2.0, 4.0, 1000.0)


def command_later(run: Run, chunk: int) -> Commands | None:
    if chunk == 60:
        run.reset("by hand")
    return LATER if chunk == 100 else None


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> recording.Recording:
    return record(
        tmp_path_factory.mktemp("view") / "bag", Parameters.from_flat(RATTLE), CHUNKS, command_later
    )


@pytest.fixture(scope="module")
def shown(bag: recording.Recording) -> Path:
    assert replay_main(["view", str(bag.path)]) == 0
    return bag.path.with_name("bag.rrd")


def curve(path: Path, entity: str, timeline: str = "sim_time") -> tuple[np.ndarray, np.ndarray]:
    found = rows_of(path, entity, "Scalars:scalars", timeline)
    return found.times_ns, np.array(found.values)[:, 0]


def test_curves_are_those_of_the_recording(bag: recording.Recording, shown: Path) -> None:
    times, values = curve(shown, "/waveform/mesh_force")
    recorded = bag.window(channels=["mesh_force"])["mesh_force"]
    np.testing.assert_array_equal(values, recorded[np.rint(times / bag.sample_interval_ns).astype(int)])
    assert (values.min(), values.max()) == (recorded.min(), recorded.max())


def test_commands_events_impacts_and_energies_come_from_their_topics(
    bag: recording.Recording, shown: Path
) -> None:
    times, torque = curve(shown, "/command/load_torque")
    assert (torque[times < 200_000_000] == 2.0).all()
    assert (torque[times >= 200_000_000] == 4.0).all()
    events = rows_of(shown, "/event", "TextLog:text", "sim_time").values
    assert ["0.120000 s: reset: by hand"] in events
    impacts = bag.impacts()
    for number, gear in enumerate(("driving", "driven")):
        _, speeds = curve(shown, f"/impact/{gear}")
        assert speeds.max() == impacts["impact_speed"][impacts["bearing"] == number].max()
    assert len(curve(shown, "/energy/residual")[0]) >= 1
    text = fixed_value(shown, "/about/run", "TextDocument:text")[0]
    assert "load_torque 2 to 4 N m" in text
    assert text.index("0.120000 s: reset") < text.index("0.200 s: load_torque")


def test_layouts_stand_beside_the_file(shown: Path) -> None:
    names = sorted(path.name for path in shown.parent.glob("*.rbl"))
    assert names == ["bag.bearings.rbl", "bag.dynamics.rbl", "bag.operator.rbl", "bag.overview.rbl"]


def test_a_window_alone(bag: recording.Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "part.rrd"
    words = ["--from", "0.1", "--to", "0.15", "--output", str(output)]
    assert replay_main(["view", str(bag.path), *words]) == 0
    assert str(output) in capsys.readouterr().out
    times, _ = curve(output, "/waveform/dte")
    assert times[0] >= 100_000_000
    assert times[-1] < 150_000_000


def test_blocks_have_the_commands_in_force(bag: recording.Recording) -> None:
    (block,) = recorded_blocks(bag, 15_000, 25_000)
    assert [sample for sample, _ in block.commands] == [15_000, 20_000]
    assert block.commands[1][1] == LATER
    assert block.first_sample == 15_000
    assert block.rows.shape == (10_000, len(CHANNEL_NAMES))
    ended = bag.impacts(0.15, 0.25)["end"]
    np.testing.assert_array_equal(block.impacts[:, 1], ended)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--from", "7"], "has no sample from 7 s: take from 0 s to 0.3 s"),
        (["--from", "0.2", "--to", "0.1"], "is empty: let it end after it starts"),
        (["--from", "nan"], "is not finite"),
        (["--serve", "--output", "x.rrd"], "--serve writes no file"),
        (["--output", "no/such/folder/x.rrd"], "does not exist: make it or choose another place"),
    ],
)
def test_what_it_refuses(
    bag: recording.Recording, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(bag.path.parent.iterdir())
    assert replay_main(["view", str(bag.path), *words]) == 2
    assert told in error_line(capsys)
    assert sorted(bag.path.parent.iterdir()) == before


def test_existing_files_are_kept(
    bag: recording.Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.rrd", "a.dynamics.rbl"):
        existing = tmp_path / name
        existing.write_text("mine")
        assert replay_main(["view", str(bag.path), "--output", str(tmp_path / "a.rrd")]) == 2
        assert f"'{existing}' exists already" in error_line(capsys)
        assert existing.read_text() == "mine"
        assert list(tmp_path.iterdir()) == [existing]
        existing.unlink()


def test_missing_channels_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    some = tuple(name for name in CHANNEL_NAMES if name not in ("dte_rate", "driven_x"))
    part = record(tmp_path / "part", Parameters.from_flat({**RATTLE, "waveform_channels": some}), 2)
    assert replay_main(["view", str(part.path)]) == 2
    assert "has no channel dte_rate, driven_x: the viewer needs all of them" in error_line(capsys)


def test_a_damaged_recording_leaves_no_file(
    bag: recording.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError("the disk is gone")

    monkeypatch.setattr(recording.Recording, "pieces", broken)
    assert replay_main(["view", str(bag.path), "--output", str(tmp_path / "a.rrd")]) == 1
    assert list(tmp_path.iterdir()) == []


def test_it_serves_a_browser_until_ctrl_c(bag: recording.Recording, process: StartProcess) -> None:
    port, web_port = free_port(), free_port()
    serving = process(
        "replay", "view", str(bag.path), "--serve", "--port", str(port), "--web-port", str(web_port)
    )
    serving.wait_for("Ctrl-C ends it")
    url = serving.stdout.split()[0]
    assert url.startswith(f"http://127.0.0.1:{web_port}/?url=")
    with urllib.request.urlopen(url, timeout=10.0) as page:
        assert b"Rerun" in page.read()
    serving.signal(signal.SIGINT)
    assert serving.wait() == 0
