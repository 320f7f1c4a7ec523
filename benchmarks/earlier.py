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
from live_node import Arrival, Client, free_port, running
from speed import SOURCE

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
# Prints the processor time of the engine for one simulated second, s: from the median of its chunks.
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

# Prints what a chunk that nobody hears costs beside the kernel, s: the median, at the pace of the node.
AROUND = """
import time
from pathlib import Path
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.physics.kernel import entry
from gear_dynamics_ros.realtime.condition import ConditionSink
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run

parameters = load_parameters(Path("config/gearbox.yaml"), [])
run = Run(Engine(parameters), Encoder(parameters, 0), [ConditionSink()])
integrate, computing = entry.integrate, 0.0

def timed(*arguments):
    global computing
    began = time.thread_time()
    done = integrate(*arguments)
    computing += time.thread_time() - began
    return done

entry.integrate = timed
costs = []
edge = time.monotonic()
for _ in range(1000):
    edge = max(edge + parameters.solver.chunk, time.monotonic())
    time.sleep(max(0.0, edge - time.monotonic()))
    computing, began = 0.0, time.thread_time()
    run.step()
    costs.append(time.thread_time() - began - computing)
costs = sorted(costs[len(costs) // 2 :])
print(costs[len(costs) // 2])
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
    lines = [f"| ms | {commit[:7]} | today | ratio | goal |", "|---|---|---|---|---|"]
    with sources(commit) as found:
        for model in MODELS:
            engine = in_turns(found, lambda source, model=model: printed(source, COMPUTE, model))
            lines.append(row(f"engine, {model}, processor time for 1 s", engine))
        measured = in_turns(found, lambda source: printed(source, AROUND))
        lines.append(row("a chunk of 2 ms beside the kernel, nobody listening", measured))
        for state, goal in AIMED_AT.items():
            measured = in_turns(found, lambda source, state=state: node_share(source, state))
            name = f"node, recording and Rerun {state}, processor time for 1 s"
            lines.append(row(name, measured, goal))
            lines.append(row(f"of it beside the engine, {model}", beside_engine(measured, engine)))
        parameters = load_parameters(SOURCE / "config" / "gearbox.yaml", [])
        measured = in_turns(found, lambda source: late_response(source, parameters))
        lines.append(row("node, latency of a command, p99", measured))
    return lines


def in_turns(found: Mapping[str, Path], measure: Callable[[Path], float]) -> list[list[float]]:
    """What ``measure`` gives of each source in each turn, (TURNS, sources)."""
    return [[measure(source) for source in found.values()] for _ in range(TURNS)]


def beside_engine(node: list[list[float]], engine: list[list[float]]) -> list[list[float]]:
    """What the node of each source takes in each turn beyond the median of its engine, (TURNS, sources)."""
    return (np.array(node) - np.median(engine, axis=0)).tolist()


def row(name: str, measured: list[list[float]], goal: float | None = None) -> str:
    """Medians of times in s, shown in ms, and the median of the ratios turn by turn."""
    values = np.array(measured)
    before, today = 1e3 * np.median(values, axis=0)
    ratio = float(np.median(values[:, 1] / values[:, 0]))
    asked = "" if goal is None else latency.verdict(f"{goal:g}", ratio / goal)
    return f"| {name} | {before:.3g} | {today:.3g} | {ratio:.2f} | {asked} |"


def printed(source: Path, program: str, *arguments: str) -> float:
    """The number that ``program`` prints with the package of ``source``."""
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], cwd=source, capture_output=True, text=True, check=True
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
