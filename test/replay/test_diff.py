"""replay diff: what it tells of two recordings is what whole arrays of them tell."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.figure import Figure
from PIL import Image

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis import figures
from gear_dynamics_ros.analysis.comparison import ChannelDifference, Comparison
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Commands, Samples
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.replay.diff import compare_recordings
from gear_dynamics_ros.replay.diff_files import channels_to_draw, write_difference
from gear_dynamics_ros.replay.pairing import BY_START, BY_TIME, equal_blocks, pair
from gear_dynamics_ros.simulation.engine import Engine
from support.chunks import record_odd
from support.recordings import SHORT, following, record
from support.terminal import error_line

NAMES = ("dte", "mesh_phase", "load_torque")
CHANGED = {"oil.viscosity": 0.0229}


def perform(path: Path, deeds: Sequence[Any], chosen: dict[str, Any], late: int = 0) -> Path:
    """A run with commands and changes of parameters between its chunks, recorded after ``late`` of them."""
    return record(path, Parameters.from_flat(SHORT | chosen), len(deeds), following(deeds), late).path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs: plain, again (the same), changed (a parameter from sample 90 on), and others."""
    path = tmp_path_factory.mktemp("runs")
    plain = [None] * 8
    perform(path / "plain", plain, {})
    perform(path / "again", plain, {})
    perform(path / "changed", [None, None, None, CHANGED, *plain[4:]], {})
    perform(path / "commanded", [None, None, Commands(30.0, 45.0, 1623.156), *plain[3:]], {})
    perform(path / "shorter", plain[:5], {})
    perform(path / "late", plain, {}, late=3)
    perform(path / "few", plain, {"waveform_channels": ["time", "mesh_force", "dte"]})
    perform(path / "slow", plain, {"solver.sample_interval": 2e-5, "solver.chunk": 2e-4})
    perform(path / "long_chunks", plain[:2], {"solver.chunk": 1.2e-3})
    return path


def told(folder: Path, capsys: pytest.CaptureFixture[str], code: int, *words: str) -> str:
    command = [str(folder / word) if (folder / word).exists() else word for word in words]
    assert replay_main(["diff", *command]) == code
    shown = capsys.readouterr()
    assert not shown.err
    return shown.out


def expected(name: str, a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]) -> ChannelDifference:
    """The difference of whole columns (n,), said once more in the plainest way."""
    gaps, unlike, undefined = [], [], []
    for n, (x, y) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        if math.isnan(x) and math.isnan(y):
            gap = 0.0
        else:
            if np.float64(x).tobytes() != np.float64(y).tobytes():
                unlike.append(n)
            gap = 0.0 if x == y else abs(x - y)
            if name == "mesh_phase" and math.isfinite(gap) and gap:
                gap = abs(math.remainder(x - y, 2.0 * math.pi))
        if math.isfinite(gap):
            gaps.append((n, gap))
        else:
            undefined.append(n)
    greatest = max((gap for _, gap in gaps), default=0.0)
    finite = a[np.isfinite(a)]
    return ChannelDifference(
        first_difference=unlike[0] if unlike else None,
        differing_samples=len(unlike),
        maximum=greatest,
        maximum_at=next((n for n, gap in gaps if gap == greatest), None) if greatest > 0.0 else None,
        rms=math.sqrt(math.fsum(gap * gap for _, gap in gaps) / max(len(gaps), 1)),
        rms_a=math.sqrt(math.fsum((finite * finite).tolist()) / max(len(finite), 1)),
        undefined_samples=len(undefined),
    )


def assert_like(found: ChannelDifference, right: ChannelDifference) -> None:
    assert found.first_difference == right.first_difference
    assert found.differing_samples == right.differing_samples
    assert found.undefined_samples == right.undefined_samples
    assert found.maximum == pytest.approx(right.maximum, rel=1e-12, abs=1e-15)
    assert found.rms == pytest.approx(right.rms, rel=1e-12, abs=1e-15)
    assert found.rms_a == pytest.approx(right.rms_a, rel=1e-12)


ODD = st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 6.28, 1e-300, 1.0])
NUMBERS = st.one_of(ODD, st.floats(0.0, 6.283), st.floats(-1e9, 1e9))


def columns(rows: int, elements: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    """Rows of NAMES with a mesh phase within a turn."""
    return arrays(np.float64, (rows, len(NAMES)), elements=elements).map(within_a_turn)


def within_a_turn(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    phase = values[:, 1]
    np.fmod(phase, 2.0 * np.pi, out=phase, where=np.isfinite(phase))
    return values


@given(st.integers(1, 12), st.data())
@settings(max_examples=80)
def test_stretches_add_up_to_the_whole(rows: int, data: st.DataObject) -> None:
    a = data.draw(columns(rows, NUMBERS))
    b = np.where(data.draw(arrays(np.bool_, a.shape)), a, data.draw(columns(rows, NUMBERS)))
    cuts = sorted(data.draw(st.sets(st.integers(1, len(a)), max_size=5)) - {len(a)})
    comparison = Comparison(NAMES)
    for begin, end in zip([0, *cuts], [*cuts, len(a)], strict=True):
        comparison.add(100 + begin, a[begin:end], b[begin:end])
    assert comparison.samples == len(a)
    for column, name in enumerate(NAMES):
        right = expected(name, a[:, column], b[:, column])
        found = comparison.differences()[name]
        first = right.first_difference
        assert_like(found, right._replace(first_difference=None if first is None else 100 + first))
        if name != "mesh_phase":  # the shorter way around is rounded otherwise
            at = found.maximum_at
            assert (None if at is None else at - 100) == right.maximum_at


def test_a_whole_turn_is_no_difference() -> None:
    comparison = Comparison(NAMES)
    apart = comparison.add(0, np.array([[0.0, 0.01, 0.01]]), np.array([[0.0, 2 * np.pi - 0.02, 6.0]]))
    assert apart.tolist() == [[0.0, pytest.approx(0.03), pytest.approx(5.99)]]


def test_two_runs_against_whole_arrays(folder: Path) -> None:
    both = [recording.open(folder / name) for name in ("plain", "commanded")]
    found = pair(*both, BY_TIME, None, None)
    comparison = Comparison(found.channels)
    for a, b in found.blocks(found.channels):
        comparison.add(a.first, a.values, b.values)
    a, b = (bag.window() for bag in both)
    assert found.channels == CHANNEL_NAMES
    for name in set(CHANNEL_NAMES) - {"driving_angle", "mesh_phase"}:
        assert_like(comparison.differences()[name], expected(name, a[name], b[name]))
    assert comparison.differences()["dte"].maximum == np.abs(a["dte"] - b["dte"]).max()
    assert comparison.differences()["dte"].maximum_at == np.abs(a["dte"] - b["dte"]).argmax()


def test_the_same_run_twice(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = told(folder, capsys, 0, "plain", "again", "--output", str(tmp_path / "out"))
    assert "240 samples of 28 channels" in shown and "the same to the bit" in shown
    assert os.listdir(tmp_path / "out") == ["diff.json"]
    found = json.loads((tmp_path / "out" / "diff.json").read_text())
    assert found["same"] and found["samples"] == 240
    assert found["parameters"] == {} and found["commands"] == []
    assert {entry["differing_samples"] for entry in found["channels"].values()} == {0}


def test_the_length_of_a_chunk_makes_no_difference(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = told(folder, capsys, 0, "plain", "long_chunks")
    assert "solver.chunk: 0.0003 in A, 0.0012 in B" in shown and "the same to the bit" in shown


def test_a_changed_parameter_is_told_with_its_sample(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    shown = told(folder, capsys, 1, "plain", "changed", "--output", str(output))
    assert "only B: parameters at 0.0009 s (sample 90) oil.viscosity = 0.0229" in shown
    assert "differ from 0.0009 s (sample 90) on, first in driving_film_force_x" in shown
    assert shown.splitlines()[-2:] == [str(output / "diff.json"), str(output / "diff.png")]
    found = json.loads((output / "diff.json").read_text())
    firsts = {name: entry["first_difference"] for name, entry in found["channels"].items()}
    assert firsts["driving_film_force_x"] == {"sample": 90, "time": pytest.approx(0.0009)}
    assert firsts["time"] is None and found["channels"]["time"]["max_difference"] == 0.0
    assert firsts["dte"]["sample"] > 90
    assert found["events"]["only_b"][0]["parameters"] == CHANGED and not found["events"]["only_a"]
    a, b = (recording.open(folder / name).window()["dte"] for name in ("plain", "changed"))
    assert found["channels"]["dte"]["max_difference"] == np.abs(a - b).max()
    assert found["channels"]["dte"]["unit"] == "m"


def test_the_figure_shows_growth_and_overlay(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = (recording.open(folder / name) for name in ("plain", "changed"))
    compared = compare_recordings(pair(a, b, BY_TIME, None, None))
    drawn: list[Figure] = []
    monkeypatch.setattr(figures, "write_png", lambda figure, stream: drawn.append(figure))
    write_difference(compared, tmp_path, BY_TIME)
    (figure,) = drawn
    shown = channels_to_draw(compared.differences)
    name = shown[0]
    growth = figure.axes[: len(shown)]
    assert "dte" in shown and len(shown) >= 3
    for axis, channel in zip(growth, shown, strict=True):
        left, right = a.window()[channel], b.window()[channel]
        (curve,) = [line for line in axis.get_lines() if line.get_label() == "|A - B|"]
        apart = np.abs(left - right)
        np.testing.assert_allclose(curve.get_xdata(), np.arange(240) * 1e-5, atol=1e-12)
        np.testing.assert_array_equal(curve.get_ydata(), np.where(apart > 0.0, apart, np.nan))
        marks = {str(line.get_label()).partition("\n")[0]: line for line in axis.get_lines()}
        first = compared.differences[channel].first_difference
        assert first is not None and first >= 90
        assert marks["first differs"].get_xdata()[0] == pytest.approx(first * 1e-5)
        assert marks["RMS of A"].get_ydata()[0] == pytest.approx(np.sqrt(np.mean(left**2)))
        assert axis.get_yscale() == "log" and axis.get_ylabel().startswith(f"{channel}\n(")
    assert growth[-1].get_xlabel() == "simulated time (s)"

    first = compared.differences[name].first_difference
    assert first is not None
    left, right = a.window()[name], b.window()[name]
    scale = 1e6 if name == "dte" else 1.0
    values, apart = (axis for axis in figure.axes[len(shown) :][:2])
    curves = {line.get_label(): line for line in values.get_lines()}
    at = np.rint(np.asarray(curves["A"].get_xdata()) / 1e3 / 1e-5).astype(int) + first
    assert at[0] < first < at[-1] and (np.diff(at) == 1).all()
    np.testing.assert_allclose(curves["A"].get_ydata(), scale * left[at])
    np.testing.assert_allclose(curves["B"].get_ydata(), scale * right[at])
    np.testing.assert_allclose(apart.get_lines()[0].get_ydata(), scale * (left[at] - right[at]))
    assert apart.get_xlabel() == f"time after {first * 1e-5:.9g} s (ms)"


def test_nothing_of_the_figure_is_cut_off(folder: Path, tmp_path: Path) -> None:
    both = [str(folder / name) for name in ("plain", "changed")]
    assert replay_main(["diff", *both, "--output", str(tmp_path)]) == 1
    image = np.asarray(Image.open(tmp_path / "diff.png").convert("RGB")).astype(int)
    assert image.shape[0] > 1200 and image.shape[1] == 1400
    for edge in (image[0], image[-1], image[:, 0], image[:, -1]):
        assert (edge > 240).all()


def test_commands_that_differ(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = told(folder, capsys, 1, "plain", "commanded", "--output", str(tmp_path))
    assert "commands from 0.0006 s on: drive 30 N m, load 30 N m" in shown
    assert "load 45 N m, speed 1623.16 rad/s in B" in shown
    (found,) = json.loads((tmp_path / "diff.json").read_text())["commands"]
    assert (found["sample"], found["b"]["load_torque"]) == (60, 45.0)
    # The window ends before they do.
    assert "the same to the bit" in told(folder, capsys, 0, "plain", "commanded", "--to", "0.0006")


def test_what_one_has_and_the_other_not(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = told(folder, capsys, 1, "plain", "shorter")
    assert "only A: 90 samples from 0.0015 s on" in shown and "but one has more" in shown
    assert "the same to the bit" in told(folder, capsys, 0, "plain", "shorter", "--to", "0.0015")
    shown = told(folder, capsys, 1, "late", "plain")
    assert "only B: 90 samples before 0.0009 s" in shown and "but one has more" in shown
    assert "the same to the bit" in told(folder, capsys, 0, "plain", "late", "--from", "0.0009")
    shown = told(folder, capsys, 1, "plain", "few")
    assert "only A: channels dte_rate, pressure_angle" in shown and "but one has more" in shown
    assert "240 samples of 3 channels" in shown


def test_starts_may_be_aligned(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told(folder, capsys, 1, "plain", "late", "--align", "start", "--output", str(tmp_path))
    found = json.loads((tmp_path / "diff.json").read_text())
    assert (found["shift"], found["samples"]) == (90, 150)
    assert "time" not in found["channels"] and found["a"]["only"]["samples_after"] == 90
    a, b = (recording.open(folder / name).window()["dte"] for name in ("plain", "late"))
    assert found["channels"]["dte"]["max_difference"] == np.abs(a[:150] - b).max()


def test_bits_that_differ_without_a_value_need_no_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, zero in (("a", 0.0), ("b", -0.0)):
        parameters = Parameters.from_flat({"waveform_channels": ["time", "dte"]})
        start = Engine(parameters).checkpoint()
        recorder = Recorder(tmp_path / name, start, 0)
        chunk = Engine(Parameters()).advance(200)
        samples = chunk.samples.copy()
        samples[7, 1] = zero
        recorder.write(Encoder(parameters, 0).chunk(replace(chunk, samples=samples)))
        recorder.close()
    shown = told(tmp_path, capsys, 1, "a", "b", "--output", str(tmp_path / "out"))
    assert "differ from 7e-05 s (sample 7) on, first in dte" in shown
    assert os.listdir(tmp_path / "out") == ["diff.json"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["plain", "slow"], "solver.sample_interval is 1e-05 s in"),
        (["plain", "again", "--from", "3"], "no sample in common from 3 s"),
        (
            ["plain", "again", "--from", "0.002", "--to", "0.001"],
            "no sample in common from 0.002 s to 0.001 s",
        ),
        (["plain", "again", "--to", "inf"], "not finite"),
        (["plain", "nothing"], "no recording at 'nothing'"),
        (["plain", "again", "--output", __file__], "is a file: name a folder"),
    ],
)
def test_what_can_not_be_compared_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    command = [str(folder / word) if (folder / word).exists() else word for word in words]
    assert replay_main(["diff", *command]) == 2
    assert message in error_line(capsys)


def test_runs_of_other_times_can_be_aligned(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    later = perform(tmp_path / "later", [None] * 10, {}, late=9)
    assert replay_main(["diff", str(folder / "plain"), str(later)]) == 2
    assert "align" in capsys.readouterr().err
    both = (recording.open(folder / "plain"), recording.open(later))
    assert pair(*both, BY_START, None, None).end == 30


@pytest.mark.parametrize("lengths", [((5, 5), (3, 7)), ((10,), (1, 2, 3, 4)), ((4, 6), (4, 6))])
def test_pieces_of_any_lengths_become_equal_blocks(
    lengths: tuple[tuple[int, ...], tuple[int, ...]],
) -> None:
    def pieces(counts: tuple[int, ...]) -> Any:
        ends = np.cumsum(counts)
        for count, end in zip(counts, ends, strict=True):
            yield Samples(int(end - count), 1.0, ("dte",), np.arange(end - count, end, dtype=float)[:, None])

    met = [(a["dte"].tolist(), b["dte"].tolist(), a.first) for a, b in equal_blocks(*map(pieces, lengths))]
    assert all(ours == theirs and ours[0] == first for ours, theirs, first in met)
    assert [value for ours, _, _ in met for value in ours] == list(range(10))


GROWTH = """
import resource, sys
from gear_dynamics_ros.cli.replay import replay_main
replay_main(["diff", sys.argv[1], sys.argv[2], "--to", "0.5"])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
replay_main(["diff", sys.argv[1], sys.argv[2]])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_memory_does_not_grow_with_the_recordings(tmp_path: Path) -> None:
    long = record_odd(tmp_path / "long", 600)  # 54 MB
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, str(long), str(long)],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert "240000 samples" in done.stdout
    assert int(done.stdout.splitlines()[-1]) < 24 * 1024  # KiB


def test_a_broken_off_recording_is_compared_as_far_as_it_goes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = record_odd(tmp_path / "whole", 60)
    broken = tmp_path / "broken.mcap"
    content = (whole / "whole_0.mcap").read_bytes()
    broken.write_bytes(content[: len(content) // 2])
    assert replay_main(["diff", str(whole), str(broken)]) == 1
    shown = capsys.readouterr()
    warned = f"replay: warning: {broken}: broken.mcap is broken off: what was flushed is readable, up to "
    assert shown.err.startswith(warned) and shown.err.count("\n") == 1
    assert "what both have is the same to the bit, but one has more" in shown.out
    damaged = bytearray(content)
    damaged[len(content) // 2] ^= 1
    broken.write_bytes(damaged)
    assert replay_main(["diff", str(whole), str(broken)]) == 1
    assert "damaged" in capsys.readouterr().err
