"""The engine and the node beside those of an earlier commit, in turns on this machine."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

import latency
import numpy as np
from live_node import SOURCE, Arrival, Client, free_port, running

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.parameters import Parameters, load_parameters
from gear_dynamics_ros.topics import TOPICS

# The last commit whose default step was 1 us; BEFORE=... of make bench takes another.
COMMIT: Final = "251eeaa"
MODELS: Final = ("traditional", "compared", "improved")
TURNS = 5
WATCHED = 6  # reports of the pacing, one a second of wall time
COMMANDS = 400
PATIENCE = 120.0  # s of wall time; a first start compiles the kernel
# Of the earlier node's processor time, by whether there are recording and Rerun.
AIMED_AT: Final = {"off": 0.60, "on": 0.65}
COMPUTE = """
import sys, time
from pathlib import Path
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.simulation.engine import Engine

parameters = load_parameters(Path("config/gearbox.yaml"), ["model=" + sys.argv[1]])
engine = Engine(parameters)
costs = []
for _ in range(round(0.4 / parameters.solver.chunk)):
    began = time.thread_time()
    engine.advance()
    costs.append(time.thread_time() - began)
costs = sorted(costs[len(costs) // 2 :])
print(costs[len(costs) // 2] / parameters.solver.chunk)
"""


class Report(NamedTuple):
    """How a node stood when it reported its pacing; s."""

    simulated: float
    worked: float  # processor time of the process


@contextmanager
def sources(commit: str) -> Iterator[dict[str, Path]]:
    """Folders with the package of ``commit`` and of today. Raises GearboxError if git has no such commit."""
    with tempfile.TemporaryDirectory(prefix="earlier") as folder:
        done = subprocess.run(["git", "archive", commit], cwd=SOURCE, capture_output=True)
        if done.returncode:
            reason = done.stderr.decode(errors="replace").strip()
            raise GearboxError(f"git archive {commit} failed ({reason}): name a commit that git log shows")
        with tarfile.open(fileobj=BytesIO(done.stdout)) as archive:
            archive.extractall(folder, filter="data")
        yield {commit[:7]: Path(folder), "today": SOURCE}


def beside(commit: str) -> list[str]:
    """Rows of engine, node and latency: the earlier one, today's, and the ratio."""
    lines = [f"| | {commit[:7]} | today | ratio | goal |", "|---|---|---|---|---|"]
    with sources(commit) as found:
        for model in MODELS:
            measured = in_turns(found, lambda source, model=model: compute(source, model))
            lines.append(row(f"engine, {model}, processor time for 1 s", measured, 1.0, "s"))
        for state, goal in AIMED_AT.items():
            measured = in_turns(found, lambda source, state=state: node_share(source, state))
            name = f"node, recording and Rerun {state}, processor time for 1 s"
            lines.append(row(name, measured, goal, "s"))
        parameters = load_parameters(SOURCE / "config" / "gearbox.yaml", [])
        measured = in_turns(found, lambda source: late_response(source, parameters))
        lines.append(row("node, latency of a command, p99", measured, 1.0, "s"))
    return lines


def in_turns(found: Mapping[str, Path], measure: Callable[[Path], float]) -> list[list[float]]:
    """What ``measure`` gives of each source in each turn, (TURNS, sources)."""
    return [[measure(source) for source in found.values()] for _ in range(TURNS)]


def row(name: str, measured: list[list[float]], goal: float, unit: str) -> str:
    """Medians, and the median of the ratios turn by turn."""
    values = np.array(measured)
    before, today = np.median(values, axis=0)
    ratio = float(np.median(values[:, 1] / values[:, 0]))
    asked = latency.verdict(f"{goal:g}", ratio / goal) if goal < 1.0 else ""
    return f"| {name} | {before:.4f} {unit} | {today:.4f} {unit} | {ratio:.2f} | {asked} |"


def compute(source: Path, model: str) -> float:
    """Processor time of the engine of ``source`` for one simulated second, s: the median of its chunks."""
    done = subprocess.run(
        [sys.executable, "-c", COMPUTE, model], cwd=source, capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def node_share(source: Path, state: str) -> float:
    """Processor time of the whole process for one simulated second at factor 1, nobody listening; s."""
    reports: list[Report] = []
    with tempfile.TemporaryDirectory() as folder:
        sinks = {"recording.path": Path(folder) / "bag", "rerun.mode": "serve", "rerun.port": free_port()}
        with running(sinks if state == "on" else {}, source) as node, Client(node) as client:

            def take(arrival: Arrival) -> None:
                pace = deserialize(TOPICS["pacing"].type, arrival.data).data
                reports.append(Report(float(pace[0]), sum(node.thread_seconds().values())))

            client.hear("pacing", take)
            client.until(lambda: len(reports) > WATCHED, PATIENCE)
    first, last = reports[1], reports[-1]
    return (last.worked - first.worked) / (last.simulated - first.simulated)


def late_response(source: Path, parameters: Parameters) -> float:
    """99th percentile of the latency of the node of ``source``, s."""
    return float(np.percentile(latency.responses(parameters, COMMANDS, source).latencies, 99))
