"""A short soak, the real thing: nothing may be lost; being in time is asked of an idle machine only."""

from __future__ import annotations

import re
import signal
import sys
import time
from pathlib import Path

import numpy as np

from gear_dynamics_ros.messages import serialize, waveform_message
from gear_dynamics_ros.signals import CHANNEL_NAMES
from gear_dynamics_ros.topics import ARRAY
from support.paths import ROOT

SOAK = ROOT / "benchmarks" / "soak.py"
SAMPLE_RATE = 100_000
INTERVAL_NS = 10_000


def waveform(*numbers):
    """Message of the samples with these numbers."""
    rows = np.zeros((len(numbers), len(CHANNEL_NAMES)))
    rows[:, 0] = np.array(numbers) * INTERVAL_NS * 1e-9
    return serialize(ARRAY, waveform_message(CHANNEL_NAMES, rows))


def test_the_listener_counts_what_is_lost_and_doubled(monkeypatch):
    monkeypatch.syspath_prepend(SOAK.parent)
    from live_node import Arrival, Samples

    samples = Samples(INTERVAL_NS)
    for numbers in [(7, 8, 9), (10, 11), (14, 15), (15, 16), (17, 19, 20)]:
        samples.take(Arrival(waveform(*numbers), 0))
    assert (samples.heard, samples.lost, samples.doubled) == (12, 3, 1)


def test_every_sample_arrives_and_the_page_says_so(process, tmp_path):
    page = tmp_path / "soak.md"
    soak = process(sys.executable, SOAK, "--duration", "5", "--output", page, TMPDIR=str(tmp_path))
    code = soak.wait(180.0)
    text = page.read_text(encoding="utf-8")
    assert text.strip() == soak.stdout.strip()
    rows = {name: (value, verdict) for name, value, _, verdict in re.findall(r"\| (.*) " * 4 + r"\|", text)}
    for name in ("samples lost", "samples doubled", "messages the recorder lost"):
        assert rows[name] == ("0", "met")
    assert int(rows["samples heard"][0]) > SAMPLE_RATE
    late = rows["overruns"][1] == "missed"
    assert code == (1 if late else 0), soak.output
    assert [path.name for path in tmp_path.iterdir() if path != page] == ["soak.png"]


def test_a_duration_too_short_to_tell_anything_is_refused(process):
    soak = process(sys.executable, SOAK, "--duration", "0.5")
    assert soak.wait() == 2
    assert soak.stderr == "soak: error: --duration 0.5: it takes at least 3 s, and an end\n"


def test_ctrl_c_ends_the_node_and_leaves_nothing(process, tmp_path):
    soak = process(sys.executable, SOAK, TMPDIR=str(tmp_path))
    deadline = time.monotonic() + 120.0
    while not list(tmp_path.glob("soak*/bag/*.mcap")):
        assert time.monotonic() < deadline, soak.output
        time.sleep(0.05)
    (node,) = Path(f"/proc/{soak.pid}/task/{soak.pid}/children").read_text().split()
    soak.signal(signal.SIGINT)
    assert soak.wait() == 130
    assert not Path(f"/proc/{node}").exists()
    assert list(tmp_path.iterdir()) == []
