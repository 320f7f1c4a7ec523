"""A short soak, the real thing: nothing may be lost; being in time is asked of an idle machine only."""

from __future__ import annotations

import re
import signal
import sys
import time
from pathlib import Path

SOAK = Path(__file__).resolve().parent.parent / "benchmarks" / "soak.py"
SAMPLE_RATE = 100_000


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
