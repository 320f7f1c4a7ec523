"""replay export: what other programs read is what was recorded, to the bit, or there is no file."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import CHANNEL_NAMES, CHANNELS, ENERGIES, IMPACTS
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, change_values, dump_parameters
from gear_dynamics_ros.recording.export.formats import ROW_GROUP
from gear_dynamics_ros.recording.export.write import export_table as export
from gear_dynamics_ros.recording.reader import BLOCK_SAMPLES
from gear_dynamics_ros.simulation.run import Run
from support.chunks import ROWS, record_odd
from support.processes import Process, StartProcess, until
from support.recordings import record
from support.terminal import error_line

FORMATS = ("parquet", "csv", "npy")
Rows = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """22 MB: several blocks and row groups."""
    return record_odd(tmp_path_factory.mktemp("recorded") / "bag", 250)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with commands, a changed parameter, a reset and impacts."""
    path = tmp_path_factory.mktemp("simulated") / "run"

    def act(run: Run, chunk: int) -> Commands | None:
        if chunk == 2:
            run.change(change_values(run.engine.parameters, {"oil.viscosity": 0.03}))
        if chunk == 3:
            run.reset("to begin, again")
        return {1: Commands(30.0, 55.0, 1700.0), 3: Commands(30.0, -20.0, 1500.0)}.get(chunk)

    return record(path, Parameters(), 4, act).path


def read_csv(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def read(path: Path) -> dict[str, Rows]:
    """Columns of numbers by name."""
    if path.suffix == ".npy":
        array = np.load(path, mmap_mode="r")
        return {name: array[name] for name in array.dtype.names}
    if path.suffix == ".parquet":
        table = parquet.read_table(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    return {
        name: np.array(entries, dtype=np.int64 if name == "sample" else np.float64)
        for name, entries in read_csv(path).items()
    }


def same_bits(left: Rows, right: Rows) -> bool:
    return left.dtype == right.dtype and left.tobytes() == right.tobytes()


def without_payload(values: Rows) -> Rows:
    return np.where(np.isnan(values), np.nan, values)


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_sample_survives_bit_for_bit(
    bag: Path, tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"whole.{suffix}"
    assert replay_main(["export", str(bag), "--output", str(path)]) == 0
    shown = capsys.readouterr()
    assert f"100000 rows of {1 + len(CHANNEL_NAMES)} columns" in shown.out and not shown.err
    columns = read(path)
    assert tuple(columns) == ("sample", *CHANNEL_NAMES)
    assert same_bits(columns["sample"], np.arange(250 * ROWS))
    whole = recording.open(bag).window()
    kept = without_payload if suffix == "csv" else np.asarray
    for name in CHANNEL_NAMES:
        assert same_bits(columns[name], kept(np.ascontiguousarray(whole[name]))), name
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_window_of_some_channels(bag: Path, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"some.{suffix}"
    words = ["--channels", "mesh_force,dte", "--from", "0.2001", "--to", "0.5"]
    assert replay_main(["export", str(bag), "--output", str(path), *words]) == 0
    columns = read(path)
    assert tuple(columns) == ("sample", "time", "mesh_force", "dte")
    assert same_bits(columns["sample"], np.arange(20_010, 50_000))
    window = recording.open(bag).window(0.2001, 0.5)
    assert same_bits(columns["mesh_force"], np.ascontiguousarray(window["mesh_force"]))
    assert same_bits(columns["time"], np.ascontiguousarray(window["time"]))


def test_the_time_of_a_sample_is_that_of_no_other_days_after_the_start(bag: Path) -> None:
    opened = recording.open(bag)
    for sample in np.random.default_rng(1).integers(10**9, 10**11, 1000).tolist():
        assert opened.sample_at(sample * 1e-5) == sample
        assert opened.sample_at((sample + 0.01) * 1e-5) == sample + 1


def test_parquet_tells_units_and_origin(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / "whole.parquet"
    export(recording.open(bag), path)
    file = parquet.ParquetFile(path)
    fields = {field.name: field.metadata for field in file.schema_arrow}
    for channel in CHANNELS:
        assert fields[channel.name][b"unit"].decode() == channel.unit
        assert fields[channel.name][b"meaning"].decode() == channel.meaning
    opened = recording.open(bag)
    about = {key.decode(): value.decode() for key, value in file.schema_arrow.metadata.items()}
    assert about["version"] == opened.version
    assert about["kernel_hash"] == opened.kernel_hash
    assert about["sample_interval_ns"] == "10000"
    assert about["parameters"] == dump_parameters(Parameters())
    sizes = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
    assert sum(sizes) == 250 * ROWS and len(sizes) > 1
    assert max(sizes) < ROW_GROUP + BLOCK_SAMPLES + ROWS


def test_the_format_may_be_named(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / "whole.dat"
    words = ["--format", "npy", "--channels", "dte", "--to", "0.01"]
    assert replay_main(["export", str(bag), "--output", str(path), *words]) == 0
    assert np.load(path).shape == (1000,)


def test_commands(run: Path, tmp_path: Path) -> None:
    opened = recording.open(run)
    for suffix in FORMATS:
        export(opened, tmp_path / f"x.{suffix}", "commands")
        columns = read(tmp_path / f"x.{suffix}")
        rows = list(zip(*(column.tolist() for column in columns.values()), strict=True))
        assert tuple(columns) == ("sample", "time", *Commands._fields)
        assert rows == [(sample, sample * 1e4 / 1e9, *values) for sample, values in opened.commands]
    export(opened, tmp_path / "later.csv", "commands", start=0.002)
    assert read(tmp_path / "later.csv")["load_torque"].tolist()[0] == 55.0


def test_impacts(run: Path, tmp_path: Path) -> None:
    opened = recording.open(run)
    expected = opened.impacts()
    assert len(expected) > 1
    middle = float(np.sort(expected["end"])[1])
    for suffix in FORMATS:
        export(opened, tmp_path / f"x.{suffix}", "impacts")
        found = np.column_stack(list(read(tmp_path / f"x.{suffix}").values()))
        assert same_bits(found, np.array(expected.tolist()))
        export(opened, tmp_path / f"later.{suffix}", "impacts", start=middle)
        assert len(read(tmp_path / f"later.{suffix}")["begin"]) == len(opened.impacts(middle))
    assert tuple(read(tmp_path / "x.csv")) == tuple(entry.name for entry in IMPACTS)


def test_energy(run: Path, tmp_path: Path) -> None:
    opened = recording.open(run)
    expected = np.concatenate([rows for _, rows in opened.rows("energy")])
    for suffix in FORMATS:
        export(opened, tmp_path / f"x.{suffix}", "energy")
        columns = read(tmp_path / f"x.{suffix}")
        assert tuple(columns) == ("sample", "time", *(energy.name for energy in ENERGIES))
        assert columns["sample"].tolist() == [200, 400, 600, 800]
        assert columns["time"].tolist() == [0.002, 0.004, 0.006, 0.008]
        assert same_bits(np.column_stack(list(columns.values())[2:]), expected)


def test_events(run: Path, tmp_path: Path) -> None:
    opened = recording.open(run)
    export(opened, tmp_path / "x.parquet", "events")
    export(opened, tmp_path / "x.csv", "events")
    rows = parquet.read_table(tmp_path / "x.parquet").to_pylist()
    assert [row["event"] for row in rows] == ["start", "parameters", "reset", "end"]
    assert rows[1]["parameters"] == '{"oil.viscosity": 0.03}'
    assert (rows[2]["sample"], rows[2]["time"], rows[2]["message"]) == (600, 0.006, "to begin, again")
    assert [row["counted_steps"] for row in rows] == [event.counters.steps for event in opened.events]
    text = read_csv(tmp_path / "x.csv")
    assert {name: [str(row[name]) for row in rows] for name in rows[0]} == text
    with pytest.raises(UsageError, match="message, parameters are text: export this table as parquet or csv"):
        export(opened, tmp_path / "x.npy", "events")
    assert sorted(os.listdir(tmp_path)) == ["x.csv", "x.parquet"]


def test_a_table_without_rows_is_a_file_all_the_same(run: Path, tmp_path: Path) -> None:
    for suffix in FORMATS:
        export(recording.open(run), tmp_path / f"x.{suffix}", "impacts", end=1e-5)
        assert [len(column) for column in read(tmp_path / f"x.{suffix}").values()] == [0] * len(IMPACTS)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--channels", "dte,nonsense"], "'nonsense'"),
        (["--channels", "dte,dte"], "'dte' is named 2 times"),
        (["--from", "1.0"], "from 1 s: take from 0 s to 1 s"),
        (["--to", "0"], "to 0 s"),
        (["--from", "0.5", "--to", "0.5"], "from 0.5 s to 0.5 s"),
        (["--from", "nan"], "not finite"),
        (["--table", "impacts", "--from", "3"], "from 3 s"),
        (["--table", "events", "--channels", "dte"], "table waveform, not of events"),
    ],
)
def test_what_can_not_be_meant_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    assert replay_main(["export", str(bag), "--output", str(tmp_path / "x.npy"), *words]) == 2
    assert told in error_line(capsys)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    ("name", "told"),
    [("x.txt", r".parquet, .csv, .npy"), ("x", "suffix"), ("missing/x.npy", "does not exist: make it")],
)
def test_places_and_suffixes_that_can_not_be(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, told: str
) -> None:
    assert replay_main(["export", str(bag), "--output", str(tmp_path / name)]) == 2
    assert told in error_line(capsys)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("kind", ["file", "folder", "broken link", "part"])
def test_nothing_is_overwritten(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = tmp_path / "x.npy"
    if kind == "file":
        path.write_text("mine")
    elif kind == "folder":
        path.mkdir()
    elif kind == "broken link":
        path.symlink_to(tmp_path / "nowhere")
    else:
        (tmp_path / "x.npy.part").write_text("somebody's")
    before = os.listdir(tmp_path)
    assert replay_main(["export", str(bag), "--output", str(path)]) == 2
    assert "x.npy" in error_line(capsys)
    assert os.listdir(tmp_path) == before
    if kind == "part":
        assert (tmp_path / "x.npy.part").read_text() == "somebody's"


def test_a_file_that_came_meanwhile_is_left_alone(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.npy"
    with pytest.raises(UsageError, match="exists already"):
        export(recording.open(bag), path, progress=lambda _: path.write_bytes(b"mine") and None)
    assert path.read_text() == "mine" and os.listdir(tmp_path) == ["x.npy"]


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_damaged_recording_leaves_no_file(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[len(content) * 2 // 3] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(content)
    out = tmp_path / "out"
    out.mkdir()
    assert replay_main(["export", str(tmp_path / "damaged.mcap"), "--output", str(out / f"x.{suffix}")]) == 1
    assert "damaged" in error_line(capsys)
    assert not os.listdir(out)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_broken_off_recording_exports_what_is_readable(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(bag, broken)
    os.truncate(broken / "bag_0.mcap", (bag / "bag_0.mcap").stat().st_size // 3)
    path = tmp_path / f"x.{suffix}"
    assert replay_main(["export", str(broken), "--output", str(path), "--channels", "dte_rate"]) == 0
    shown = capsys.readouterr()
    rows = read(path)["dte_rate"]
    assert 0 < len(rows) < 50_000
    assert same_bits(rows, np.ascontiguousarray(recording.open(bag).window()["dte_rate"][: len(rows)]))
    assert (
        shown.err.count("\n") == 1
        and f"broken off: what was flushed is readable, up to {len(rows) * 1e-5:.9g} s\n" in shown.err
    )


FULL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
from gear_dynamics_ros.cli.replay import replay_main
sys.exit(replay_main(sys.argv[2:]))
"""


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("limit", [100, 10_000_000])
def test_a_full_disk_leaves_no_file(bag: Path, tmp_path: Path, suffix: str, limit: int) -> None:
    words = ["export", str(bag), "--output", str(tmp_path / f"x.{suffix}")]
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(limit), *words], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"replay: error: can't write '{tmp_path}/x.{suffix}': File too large")
    assert done.stderr.count("\n") == 1 and not done.stdout
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("table", ["waveform", "impacts", "energy"])
def test_what_was_not_recorded_is_refused_and_not_told_as_empty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str
) -> None:
    record(tmp_path / "bag", Parameters.from_flat({"recording.topics": ["dte"]}), 4)
    output = tmp_path / f"{table}.csv"
    words = ["export", str(tmp_path / "bag"), "--table", table, "--output", str(output)]
    assert replay_main(words) == 2
    assert f"has no {table}, which was not among recording.topics" in error_line(capsys)
    assert not output.exists()


def begin_export(process: StartProcess, bag: Path, path: Path) -> Process:
    """An export that is under way."""
    exporting = process("replay", "export", bag, "--output", path)
    part = path.with_name(path.name + ".part")
    until(lambda: part.exists() and part.stat().st_size, "something is exported")
    assert exporting.returncode is None, exporting.output
    return exporting


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_export_leaves_no_file(
    process: StartProcess, bag: Path, tmp_path: Path, number: signal.Signals
) -> None:
    exporting = begin_export(process, bag, tmp_path / "x.csv")
    exporting.signal(number)
    exporting.signal(number)
    assert exporting.wait() == 128 + number
    assert exporting.output == f"replay: interrupted by {number.name}\n"
    assert not os.listdir(tmp_path)


def test_a_killed_export_leaves_nothing_that_passes_for_whole(
    process: StartProcess, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exporting = begin_export(process, bag, tmp_path / "x.csv")
    exporting.signal(signal.SIGKILL)
    exporting.wait()
    assert os.listdir(tmp_path) == ["x.csv.part"]
    assert replay_main(["export", str(bag), "--output", str(tmp_path / "x.csv")]) == 2
    assert "x.csv.part" in error_line(capsys)


def test_parquet_without_pyarrow_is_one_clear_line(run: Path, tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules.update(pyarrow=None); from gear_dynamics_ros.cli.replay import replay_main; "
    )
    for suffix, expected in (("parquet", 2), ("csv", 0), ("npy", 0)):
        words = ["export", str(run), "--output", str(tmp_path / f"x.{suffix}")]
        done = subprocess.run(
            [sys.executable, "-c", code + "sys.exit(replay_main(sys.argv[1:]))", *words],
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == expected
        if expected:
            assert "pip install pyarrow" in done.stderr and done.stderr.count("\n") == 1
    assert sorted(os.listdir(tmp_path)) == ["x.csv", "x.npy"]


GROWTH = """
import resource, sys
from pathlib import Path
from gear_dynamics_ros import recording
from gear_dynamics_ros.recording.export.write import export_table as export
bag, folder, suffix = recording.open(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
export(bag, folder / f"short.{suffix}", end=0.7)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
export(bag, folder / f"long.{suffix}")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.parametrize("suffix", FORMATS)
def test_memory_does_not_grow_with_the_recording(tmp_path: Path, suffix: str) -> None:
    long = record_odd(tmp_path / "long", 600)  # 54 MB, of which a third is exported to warm up
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, str(long), str(tmp_path), suffix],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert int(done.stdout) < 24 * 1024  # KiB
    assert (tmp_path / f"long.{suffix}").stat().st_size > 40_000_000


def test_arrow_keeps_no_null(bag: Path, tmp_path: Path) -> None:
    export(recording.open(bag), tmp_path / "x.parquet", channels=["dte"], end=0.01)
    column = parquet.read_table(tmp_path / "x.parquet")["dte"]
    assert column.null_count == 0 and column.type == pa.float64()
