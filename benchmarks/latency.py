"""Latency, jitter and processor time of the real node at real-time factor 1, heard over DDS."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import speed
from live_node import Arrival, Client, Samples, running
from numpy.typing import NDArray
from std_msgs.msg import Float64

from gear_dynamics_ros.channels import PACE
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.topics import ARRAY, JOINT_STATE

COMMANDS = {"5e-4": 1000, "2e-3": 1000, "1e-2": 250}  # by chunk in s
LATENCY_CHUNK = "2e-3"
ALLOWANCE = 0.5e-3  # s of latency beyond chunk and computing
SHARES_AIMED_AT = {"off": 0.60, "on": 0.90}  # of one core, by whether there are recording and Rerun
BUSY_LOOPS = 2 * len(os.sched_getaffinity(0))
SCHEDULINGS: Final[Sequence[Mapping[str, object]]] = (
    {},
    {"pacing.processors": "'0'"},
    {"pacing.priority": 50},
    {"pacing.priority": 50, "pacing.processors": "'0'"},
    {"pacing.priority": 50, "pacing.lock_memory": "true"},
)
_TIME, _OVERRUNS, _LATENESS = (
    [entry.name for entry in PACE].index(name) for name in ("time", "overruns", "worst_lateness")
)
THREADS = ("engine", "main", "recorder", "viewer", "dds")

SETTLE = 1.5  # s of wall time in which caches fill and discovery ends
WATCHED = 6.0  # s of wall time
COMPUTED = 0.2  # s of simulated time
BARE = 4.0  # s of wall time
PATIENCE = 60.0
ANSWER_PATIENCE = 1.0


class Responses(NamedTuple):
    """What one run of the node showed; s."""

    latencies: NDArray[np.float64]  # from publishing a command to having its first effect
    periods: NDArray[np.float64]  # between arrivals
    unanswered: int
    samples: Samples
    overruns: float  # share of the chunks
    latest: float  # begin of a chunk after it was due


class Shares(NamedTuple):
    """Processor time of the node's threads in cores, by name."""

    threads: Mapping[str, float]
    samples: Samples


def latency() -> list[str]:
    """Rows for each length of chunk."""
    lines = [
        "| chunk, ms | commands | unanswered | computing, ms | latency, ms: median | p99 | largest "
        "| goal for p99 | bare loop late, ms: p99 | largest "
        "| period less chunk, us: median | p99 | largest | samples heard | lost | doubled |",
        "|---" * 16 + "|",
    ]
    for chunk, count in COMMANDS.items():
        parameters = speed.parameters_of("gearbox", f"solver.chunk={chunk}")
        computing = computing_time(parameters)
        bare = 1e3 * np.percentile(bare_loop(parameters.solver.chunk, computing), (99, 100))
        found = responses(parameters, count)
        middle, late, latest = 1e3 * np.percentile(found.latencies, (50, 99, 100))
        jitter = 1e6 * np.percentile(np.abs(found.periods - parameters.solver.chunk), (50, 99, 100))
        limit = 1e3 * (parameters.solver.chunk + computing + ALLOWANCE)
        goal = verdict(f"{limit:.2f}", late / limit) if chunk == LATENCY_CHUNK else ""
        lines.append(
            f"| {1e3 * parameters.solver.chunk:g} | {count} | {found.unanswered} | {1e3 * computing:.2f} "
            f"| {middle:.2f} | {late:.2f} | {latest:.2f} | {goal} | {bare[0]:.2f} | {bare[1]:.2f} "
            f"| {jitter[0]:.0f} | {jitter[1]:.0f} | {jitter[2]:.0f} | {cells(found.samples)} |"
        )
    return lines


def processor_time() -> list[str]:
    """Rows without and with recording and Rerun."""
    lines = [
        "| recording and Rerun | " + " | ".join(THREADS) + " | others | whole process | goal "
        "| samples heard | lost | doubled |",
        "|---" * (len(THREADS) + 7) + "|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        sinks = {
            "recording.path": Path(folder) / "bag",
            "rerun.mode": "save",
            "rerun.path": Path(folder) / "gearbox.rrd",
        }
        for state, parameters in {"off": {}, "on": sinks}.items():
            found = shares(parameters)
            total, limit = sum(found.threads.values()), SHARES_AIMED_AT[state]
            named = [found.threads.get(name, 0.0) for name in THREADS]
            others = total - sum(named)
            parts = [f"{100 * share:.1f} %" for share in (*named, others, total)]
            goal = verdict(f"{100 * limit:.0f} %", total / limit)
            lines.append(f"| {state} | {' | '.join(parts)} | {goal} | {cells(found.samples)} |")
    return lines


def computing_time(parameters: Parameters) -> float:
    """Wall time of the engine for a chunk, s: the median, nothing else at work."""
    engine = Engine(parameters)
    engine.advance(round(speed.WARM / parameters.solver.sample_interval))
    times = []
    for _ in range(round(COMPUTED / parameters.solver.chunk)):
        began = time.perf_counter()
        engine.advance()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def bare_loop(chunk: float, computing: float) -> NDArray[np.float64]:
    """By how much a loop is late that sleeps to each edge and then computes, with nothing else at work; s."""
    late = []
    edge = time.perf_counter()
    for _ in range(round(BARE / chunk)):
        edge += chunk
        time.sleep(max(0.0, edge - time.perf_counter()))
        compute(computing)
        late.append(time.perf_counter() - edge - computing)
    return np.array(late)


def compute(seconds: float) -> None:
    """Take so much time of the processor."""
    done = time.thread_time() + seconds
    while time.thread_time() < done:
        pass


def responses(
    parameters: Parameters,
    count: int,
    source: Path = speed.SOURCE,
    settings: Mapping[str, object] = MappingProxyType({}),
) -> Responses:
    """``count`` commands to the node of ``source``, one after another, each at any phase of the chunk.

    ``settings`` are further parameters of the node. Raises GearboxError if it does not serve.
    """
    chunk = parameters.solver.chunk
    pace: list[NDArray[np.float64]] = []
    samples = Samples(parameters.solver.sample_interval_ns)
    arrivals: list[int] = []
    with running({"solver.chunk": chunk, **settings}, source) as node, Client(node) as client:
        commander = _Commander(client, chunk)

        def take(arrival: Arrival) -> None:
            arrivals.append(arrival.time_ns)
            commander.take(arrival)

        client.hear("joint_states", take)
        client.hear("waveform", samples.take)
        client.until(lambda: samples.heard, PATIENCE)
        client.hear("pacing", lambda arrival: pace.append(deserialize(ARRAY, arrival.data).data))
        client.until(lambda: len(pace) > 1, PATIENCE)
        arrivals.clear()
        # A thread of its own, so that nothing that arrives decides the phase.
        thread = threading.Thread(target=commander.command, args=[count], daemon=True)
        thread.start()
        client.until(lambda: not thread.is_alive(), PATIENCE + count * ANSWER_PATIENCE)
        told = len(pace)
        client.until(lambda: len(pace) > told, PATIENCE)
    overruns = pace[-1][_OVERRUNS] - pace[1][_OVERRUNS]
    return Responses(
        np.array(commander.latencies),
        np.diff(np.array(arrivals) * 1e-9),
        commander.unanswered,
        samples,
        overruns * chunk / (pace[-1][_TIME] - pace[1][_TIME]),
        max(row[_LATENESS] for row in pace[2:]),
    )


class _Commander:
    """Commands one load torque after another and waits for the first output that shows it."""

    def __init__(self, client: Client, chunk: float) -> None:
        self._publisher = client.publisher("load_torque_command")
        self._chunk = chunk
        self._wanted = 0.0
        self._sent_ns = 0
        self._seen = threading.Event()
        self.latencies: list[float] = []
        self.unanswered = 0

    def take(self, arrival: Arrival) -> None:
        """A message of joint_states; its second effort is the load torque at the chunk's last sample."""
        if not self._seen.is_set() and deserialize(JOINT_STATE, arrival.data).effort[1] == self._wanted:
            self.latencies.append((arrival.time_ns - self._sent_ns) * 1e-9)
            self._seen.set()

    def command(self, count: int) -> None:
        for number in range(1, count + 1):
            time.sleep(self._chunk * random.uniform(1.0, 2.0))
            self._wanted = 30.0 + 0.001 * number
            self._sent_ns = time.monotonic_ns()
            self._seen.clear()
            self._publisher.publish(Float64(data=self._wanted))
            if not self._seen.wait(ANSWER_PATIENCE):
                self.unanswered += 1
                self._seen.set()


def shares(parameters: Mapping[str, object]) -> Shares:
    """Processor time of a node with a listener to its waveform."""
    samples = Samples(Parameters().solver.sample_interval_ns)
    with running(parameters) as node, Client(node) as client:
        client.hear("waveform", samples.take)
        client.until(lambda: samples.heard, PATIENCE)
        client.listen(SETTLE)
        before, began = node.thread_seconds(), time.monotonic()
        client.listen(WATCHED)
        after, elapsed = node.thread_seconds(), time.monotonic() - began
    threads: defaultdict[str, float] = defaultdict(float)
    for (number, name), seconds in after.items():
        # Fast DDS names its threads dds. and something more.
        threads[name.partition(".")[0]] += (seconds - before.get((number, name), 0.0)) / elapsed
    return Shares(threads, samples)


def scheduling() -> list[str]:
    """Rows for each setting of the scheduler, beside busy loops."""
    lines = [
        "| parameters | latency, ms: median | p99 | largest | overruns, share of chunks "
        "| latest begin of a chunk, ms |",
        "|---" * 6 + "|",
    ]
    parameters = speed.parameters_of("gearbox")
    for settings in SCHEDULINGS:
        name = ", ".join(f"`{key}: {value}`" for key, value in settings.items()) or "as shipped"
        try:
            with busy_loops(BUSY_LOOPS):
                found = responses(parameters, COMMANDS[LATENCY_CHUNK] // 2, settings=settings)
        except GearboxError as error:
            lines.append(f"| {name} | not measured: {error} | | | | |")
            continue
        middle, late, latest = 1e3 * np.percentile(found.latencies, (50, 99, 100))
        lines.append(
            f"| {name} | {middle:.2f} | {late:.2f} | {latest:.2f} | {100 * found.overruns:.2f} % "
            f"| {1e3 * found.latest:.2f} |"
        )
    return lines


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """``count`` processes that take all the time they get."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def cells(samples: Samples) -> str:
    """What became of the samples."""
    return f"{samples.heard} | {samples.lost} | {samples.doubled}"


def verdict(limit: str, ratio: float) -> str:
    """The goal, and whether it is met or by how much it is missed, by the ratio of value to limit."""
    return f"below {limit}, " + ("met" if ratio < 1.0 else f"missed by {100 * (ratio - 1):.0f} %")
