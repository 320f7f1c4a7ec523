"""A short soak, the real thing: nothing may be lost; being in time is asked of an idle machine only."""

from __future__ import annotations

import importlib
import re
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.messages.cdr import serialize
from gear_dynamics_ros.messages.encoder import waveform_message
from gear_dynamics_ros.topics import ARRAY
from support.paths import ROOT
from support.processes import StartProcess, until

BENCHMARKS = ROOT / "benchmarks"
SOAK = BENCHMARKS / "soak.py"
SAMPLE_RATE = 100_000
INTERVAL_NS = 10_000


@pytest.fixture
def soak(monkeypatch: pytest.MonkeyPatch, ros_domain: int) -> ModuleType:
    """The program as a module; it runs its node in a domain of its own."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("soak")


def waveform(*numbers: int) -> bytes:
    """Message of the samples with these numbers."""
    rows = np.zeros((len(numbers), len(CHANNEL_NAMES)))
    rows[:, 0] = np.array(numbers) * INTERVAL_NS * 1e-9
    return serialize(ARRAY, waveform_message(CHANNEL_NAMES, rows))


def samples_of(soak: ModuleType, *messages: tuple[int, ...]) -> Any:
    """What the listener makes of messages with these samples."""
    samples = soak.Samples(INTERVAL_NS)
    for numbers in messages:
        samples.take(sys.modules["live_node"].Arrival(waveform(*numbers), 0))
    return samples


def test_the_listener_counts_what_is_lost_and_doubled(soak: ModuleType) -> None:
    samples = samples_of(soak, (7, 8, 9), (10, 11), (14, 15), (15, 16), (17, 19, 20))
    assert (samples.heard, samples.lost, samples.doubled) == (12, 3, 1)


def found(
    soak: ModuleType,
    messages: Sequence[tuple[int, ...]] = ((0, 1), (2, 3)),
    bare_overruns: int = 0,
    **last: float,
) -> Any:
    """What a soak of 600 s found that is as it should be, but for ``last``: entries of its last look.

    ``bare_overruns`` are those of the bare loop in 30 000 chunks, a tenth of the node's.
    """
    good = soak.Look(time=0.0, memory=500.0, overruns=2, lateness=0.1, queued=0.0, lost=0, dropped=0)
    looks = [good._replace(time=float(second)) for second in range(600)]
    looks.append(good._replace(**{"time": 600.0, **last}))
    bare = soak.Bare(30_000, bare_overruns, 0.001)
    samples = samples_of(soak, *messages)
    return soak.Found(looks, samples, 600.0, 600.0, 0.002, 12_000, 29, 0.5, 0.0006, bare)


@pytest.mark.parametrize(
    ("messages", "last", "missed"),
    [
        (((0, 1), (2, 3)), {}, []),
        (((0, 1), (2, 3)), {"overruns": 32.0}, []),  # 30 in 300 000 chunks
        (((0, 1), (2, 3)), {"overruns": 33.0}, ["overruns"]),
        (((0, 1), (2, 3)), {"overruns": 52.0, "bare_overruns": 2}, []),  # 20 that the machine explains
        (((0, 1), (2, 3)), {"overruns": 53.0, "bare_overruns": 2}, ["overruns"]),
        (((0, 1), (2, 3)), {"lost": 1.0}, ["messages the recorder lost"]),
        (((0, 1), (3, 4)), {}, ["samples lost"]),
        (((0, 1), (1, 2)), {}, ["samples doubled"]),
    ],
)
def test_the_exit_code_is_1_for_each_figure_that_is_missed(
    soak: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    messages: Sequence[tuple[int, ...]],
    last: dict[str, Any],
    missed: list[str],
) -> None:
    code = soak.report(found(soak, messages, **last), tmp_path / "soak.md")
    page = (tmp_path / "soak.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() == page.strip()
    verdicts = {name: verdict for name, _, verdict in table(page)}
    assert [name for name, verdict in verdicts.items() if verdict == "missed"] == missed
    assert code == (1 if missed else 0)
    assert (tmp_path / "soak.png").stat().st_size > 0


@pytest.mark.parametrize(("slope", "verdict"), [(0.04, "met"), (0.06, "missed")])  # MiB/s over 300 s
def test_memory_is_judged_by_what_it_gains_once_settled(soak: ModuleType, slope: float, verdict: str) -> None:
    first = soak.Look(0.0, 500.0, 0, 0.1, 0.0, 0, 0)
    looks = [first._replace(time=float(t), memory=500.0 + slope * t) for t in range(601)]
    row = soak.memory_row(looks)
    assert (float(row.value), soak.verdict(row.met)) == (pytest.approx(300.0 * slope), verdict)
    assert soak.memory_row(looks[:350]).met is None


def table(page: str) -> list[tuple[str, str, str]]:
    """Name, value and verdict of each line."""
    return [
        (name, value, verdict) for name, value, _, verdict in re.findall(r"\| (.*) " * 4 + r"\|", page)[1:]
    ]


def test_every_sample_of_a_real_node_arrives(
    soak: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(soak, "BARE_INTERVAL", 2.0)
    made = soak.soak(5.0)
    rows = {row.name: row for row in soak.rows(made)}
    for name in ("samples lost", "samples doubled", "messages the recorder lost"):
        assert (rows[name].value, rows[name].met) == ("0", True)
    assert int(rows["samples heard"].value) > SAMPLE_RATE
    assert made.commands > 0 and made.looks[-1].memory > 50.0 and made.processor_share > 0.0
    assert made.bare.chunks > 0 and made.bare.latest > 0.0
    assert list(tmp_path.iterdir()) == []


def test_a_duration_too_short_to_tell_anything_is_refused(process: StartProcess) -> None:
    soak = process(sys.executable, SOAK, "--duration", "0.5")
    assert soak.wait() == 2
    assert soak.stderr == "soak: error: --duration 0.5: it takes at least 3 s, and an end\n"


def test_ctrl_c_ends_the_node_and_leaves_nothing(process: StartProcess, tmp_path: Path) -> None:
    soak = process(sys.executable, SOAK, TMPDIR=str(tmp_path))
    until(lambda: list(tmp_path.glob("soak*/bag/*.mcap")), "the node records", 120.0)
    (node,) = Path(f"/proc/{soak.pid}/task/{soak.pid}/children").read_text().split()
    soak.signal(signal.SIGINT)
    assert soak.wait() == 130
    assert not Path(f"/proc/{node}").exists()
    assert list(tmp_path.iterdir()) == []
