"""Files of a recording that are lost, doubled, swapped, foreign or joined: all readers say so, or refuse."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.analyze import analyze_main
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.recording.mcap.index import read_index
from gear_dynamics_ros.replay.verify import verify_recording
from support.terminal import error_line

READERS = ("info", "verify", "export", "diff", "publish", "recover", "analyze")


def simulated(path: Path, *settings: str) -> Path:
    """A recording of 0.05 s in three files."""
    words = ["--duration", "0.05", "--output", str(path)]
    for setting in ("recording.split_duration=0.02", *settings):
        words += ["--set", setting]
    assert simulate_main(words) == 0
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("whole") / "bag")


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("other") / "bag", "operation.load_torque=31.0")


def part(folder: Path, number: int) -> Path:
    return folder / f"bag_{number}.mcap"


def changed(bag: Path, tmp_path: Path, change: Callable[[Path], object]) -> Path:
    copy = shutil.copytree(bag, tmp_path / "bag")
    change(copy)
    return copy


def run(reader: str, bag: Path) -> int:
    """Exit code of a tool on ``bag``."""
    outputs = {
        "export": ["--output", str(bag.parent / "x.csv")],
        "diff": [str(bag)],
        "recover": ["--output", str(bag.parent / "recovered")],
        "analyze": ["--output", str(bag.parent / "figures")],
    }
    words = [str(bag), *outputs.get(reader, [])]
    return analyze_main(words) if reader == "analyze" else replay_main([reader, *words])


def refused(reader: str) -> int:
    """Exit code of a tool that refuses a recording: what can't be published is bad usage."""
    return 2 if reader == "publish" else 1


def swap(folder: Path) -> None:
    part(folder, 0).rename(folder / "x")
    part(folder, 1).rename(part(folder, 0))
    (folder / "x").rename(part(folder, 1))


def join(folder: Path) -> None:
    part(folder, 0).write_bytes(part(folder, 0).read_bytes() + part(folder, 1).read_bytes())
    part(folder, 1).unlink()


@pytest.mark.parametrize("reader", READERS)
def test_a_file_that_is_there_twice_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], reader: str
) -> None:
    copy = changed(bag, tmp_path, lambda folder: shutil.copy(part(folder, 1), part(folder, 3)))
    assert run(reader, copy) == refused(reader)
    told = error_line(capsys, "analyze" if reader == "analyze" else "replay")
    assert "bag_3.mcap has the samples 2000 to 3999 (0.020000 s to 0.039990 s), which another file" in told
    assert not (tmp_path / "recovered").exists() and not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("number", [1, 3])
@pytest.mark.parametrize("reader", READERS)
def test_a_file_of_another_run_is_refused(
    bag: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], reader: str, number: int
) -> None:
    copy = changed(bag, tmp_path, lambda folder: shutil.copy(part(other, 1), part(folder, number)))
    assert run(reader, copy) == refused(reader)
    told = error_line(capsys, "analyze" if reader == "analyze" else "replay")
    assert f"bag_{number}.mcap is of another run than bag_0.mcap" in told


@pytest.mark.parametrize(
    ("number", "times", "gaps"),
    [
        (0, "(0.000000 s to 0.019990 s)", []),
        (1, "(0.020000 s to 0.039990 s)", [(2000, 4000)]),
        (2, "(0.040000 s to 0.050000 s)", []),
    ],
)
def test_a_lost_file_is_named_with_its_time_and_not_counted(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    number: int,
    times: str,
    gaps: list[tuple[int, int]],
) -> None:
    copy = changed(bag, tmp_path, lambda folder: part(folder, number).unlink())
    found = recording.open(copy)
    held = 5000 - (1000 if number == 2 else 2000)
    assert found.samples == held and list(found.coverage.gaps) == gaps and not found.complete
    lost = f"metadata.yaml lists bag_{number}.mcap {times}, which is missing: put it back"
    assert run("info", copy) == 0
    shown = capsys.readouterr().out
    assert lost in shown and "complete\n" not in shown.splitlines()[0]
    assert f"{held} samples of 28 channels" in shown
    assert run("export", copy) == (1 if gaps else 0)
    error = capsys.readouterr().err
    if gaps:
        assert "the samples 2000 to 3999 (0.020000 s to 0.039990 s) are missing" in error
        assert replay_main(["export", str(copy), "--to", "0.02", "--output", str(tmp_path / "y.csv")]) == 0
    else:
        assert f"replay: warning: {copy}: {lost}\n" in error
    capsys.readouterr()
    assert run("verify", copy) == 1 and lost in capsys.readouterr().err
    assert run("recover", copy) == 0
    shown = capsys.readouterr().out
    assert f"missing: bag_{number}.mcap {times}, which metadata.yaml lists" in shown
    assert "nothing was lost" not in shown and "missing files: 1" in shown


def test_files_that_changed_places_are_read_in_order_and_put_back(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = changed(bag, tmp_path, swap)
    assert run("info", copy) == 0
    assert "bag_1.mcap and bag_0.mcap have each other's place" in capsys.readouterr().out
    found = recording.open(copy)
    assert found.samples == 5000 and found.waveform().tobytes() == recording.open(bag).waveform().tobytes()
    assert verify_recording(found).difference is None
    assert run("recover", copy) == 0
    assert recording.open(tmp_path / "recovered").complete


@pytest.mark.parametrize("change", [join, lambda folder: _append(folder)])
def test_bytes_behind_the_end_are_told(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Path], object],
) -> None:
    copy = changed(bag, tmp_path, change)
    behind = part(copy, 0).stat().st_size - part(bag, 0).stat().st_size
    assert behind > 0
    (note,) = [line for line in recording.open(copy).coverage.notes if "behind its end" in line]
    assert note.startswith(f"bag_0.mcap has {behind} bytes") and note.endswith("which are not read")
    assert run("info", copy) == 0 and note in capsys.readouterr().out
    assert run("recover", copy) == 0
    shown = capsys.readouterr().out
    assert "bytes behind the end of files" in shown.splitlines()[-1] and "nothing was lost" not in shown


def _append(folder: Path) -> None:
    with part(folder, 0).open("ab") as stream:
        stream.write(b"\x00" * 5000)


def test_a_part_alone_is_a_recording_of_its_own(bag: Path) -> None:
    found = recording.open(part(bag, 1))
    assert found.complete and (found.first_sample, found.samples) == (2000, 2000)


def test_a_damaged_metadata_file_is_told_and_written_again(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = changed(bag, tmp_path, lambda folder: (folder / "metadata.yaml").write_text("rosbag2: ["))
    assert run("info", copy) == 0 and "metadata.yaml is damaged" in capsys.readouterr().out
    with pytest.raises(GearboxError, match=r"metadata\.yaml is damaged"):
        verify_recording(recording.open(copy))
    assert run("recover", copy) == 0
    assert "metadata.yaml was missing or damaged: written again" in capsys.readouterr().out


def test_a_file_without_messages_is_left_out_where_others_have_some(bag: Path, tmp_path: Path) -> None:
    def cut(folder: Path) -> None:
        with part(folder, 1).open("rb") as stream:
            first_chunk = read_index(stream).chunks[0].chunk_start_offset
        os.truncate(part(folder, 1), first_chunk)

    copy = changed(bag, tmp_path, cut)
    assert run("recover", copy) == 0
    recovered = tmp_path / "recovered"
    assert sorted(path.name for path in recovered.glob("*.mcap")) == ["recovered_0.mcap", "recovered_2.mcap"]
    with AnyReader([recovered]) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count
    found = recording.open(recovered)
    assert found.coverage.lost_files == () and list(found.coverage.gaps) == [(2000, 4000)]
