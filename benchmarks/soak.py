"""The node for a long time with everything on: is every sample there, in time, and does memory stay?

Every now and then the node is paused, and a bare loop that computes as long for each chunk takes its place:
what is late there is the machine's doing.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from latency import compute, computing_time
from live_node import PARAMETERS, Client, NodeProcess, Samples, free_port, running
from matplotlib.figure import Figure
from numpy.typing import NDArray
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from gear_dynamics_ros import palette
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.cdr import deserialize
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.simulation.provenance import processor_name
from gear_dynamics_ros.system.command import FAILURE, run_command
from gear_dynamics_ros.topics import TOPICS
from gear_dynamics_ros.viewer.destinations import LIVE_MEMORY

DURATION = 600.0  # s of wall time, as are the next
SHORTEST = 3.0  # diagnostics come once a second
SETTLE = 2.0
PATIENCE = 120.0  # a first start compiles the kernel
COMMAND_INTERVAL = 0.05
SPLIT_INTERVAL = 20.0
BARE_INTERVAL = 30.0  # from one bare loop to the next
BARE_DURATION = 3.0
# Before Rerun's server is full nothing can be said of memory.
MEMORY_SETTLES = 300.0
MEMORY_JUDGED = 60.0  # at least
LOAD_TORQUE = (20.0, 40.0)  # N m
CHUNKS_PER_OVERRUN = 10_000
MEMORY_GROWTH = 16.0  # MiB
PICTURE = "soak.png"


class Look(NamedTuple):
    """How the node stood when it sent its diagnostics."""

    time: float  # s of a monotonic clock
    memory: float  # resident, MiB
    overruns: int
    lateness: float  # of the latest chunk since the look before, ms
    queued: float  # before the recorder, MB
    lost: int  # messages, by the recorder
    dropped: int  # chunks, by the viewer


class Bare(NamedTuple):
    """How the bare loop kept its edges."""

    chunks: int = 0
    overruns: int = 0
    latest: float = 0.0  # s

    def and_then(self, other: Bare) -> Bare:
        """Both together."""
        latest = max(self.latest, other.latest)
        return Bare(self.chunks + other.chunks, self.overruns + other.overruns, latest)


class Found(NamedTuple):
    """What a soak brought to light."""

    looks: list[Look]
    samples: Samples
    duration: float  # s of wall time
    simulated: float  # s
    chunk: float  # s
    commands: int
    splits: int
    processor_share: float  # of one core
    computing: float  # s for a chunk, by the engine alone
    bare: Bare


class Row(NamedTuple):
    """A figure of the page, and whether it is as it should be; ``met`` is None where nothing is asked."""

    name: str
    value: str
    asked: str = ""
    met: bool | None = None


def main() -> int:
    """Soak, print and write; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="soak",
        description="Run the node at real-time factor 1 with recording, Rerun, commands and a listener that "
        "checks every sample. Exit code 1 if one was lost, too many chunks were late, or memory grew.",
    )
    parser.add_argument(
        "--duration", type=float, default=DURATION, metavar="S", help=f"wall time (default {DURATION:g})"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help=f"write the page there too, and {PICTURE} beside it"
    )
    return run_command(lambda arguments: report(soak(arguments.duration), arguments.output), parser, None)


def soak(duration: float) -> Found:
    """Run the node for ``duration`` s of wall time.

    Raises UsageError if that is too short, GearboxError if the node ends or does not serve.
    """
    if not SHORTEST <= duration < math.inf:
        raise UsageError(f"--duration {duration:g}: it takes at least {SHORTEST:g} s, and an end")
    parameters = load_parameters(PARAMETERS, [])
    samples = Samples(parameters.solver.sample_interval_ns)
    computing = computing_time(parameters)
    looks: list[Look] = []
    bare, commands = Bare(), 0
    with tempfile.TemporaryDirectory(prefix="soak") as folder:
        bag = Path(folder) / "bag"
        sinks = {"recording.path": bag, "rerun.mode": "serve", "rerun.port": free_port(), "rerun.web_port": 0}
        with running(sinks) as node, Client(node) as client, Progress("soaking", round(duration)) as progress:
            client.hear("waveform", samples.take)
            client.hear("diagnostics", lambda arrival: looks.append(look(arrival.data, node)))
            publisher = client.publisher("load_torque_command")
            splitter = _Splitter(client)
            pause = _Pause(client)
            client.until(lambda: samples.heard and looks, PATIENCE)
            client.listen(SETTLE)
            del looks[:-1]
            heard, worked, began = samples.heard, busy(node), time.monotonic()
            elapsed = paused = 0.0
            while elapsed < duration:
                publisher.publish(Float64(data=random.uniform(*LOAD_TORQUE)))
                commands += 1
                splitter.split(elapsed)
                make_room(bag)
                progress(int(elapsed))
                client.listen(COMMAND_INTERVAL)
                if elapsed >= BARE_INTERVAL * (pause.count + 1):
                    since = time.monotonic()
                    pause.switch(True)
                    bare = bare.and_then(bare_loop(parameters.solver.chunk, computing))
                    pause.switch(False)
                    paused += time.monotonic() - since
                elapsed = time.monotonic() - began - paused
            share = (busy(node) - worked) / elapsed
        splitter.check()
    return Found(
        looks,
        samples,
        elapsed,
        (samples.heard - heard) * parameters.solver.sample_interval,
        parameters.solver.chunk,
        commands,
        splitter.count,
        share,
        computing,
        bare,
    )


def bare_loop(chunk: float, computing: float) -> Bare:
    """A loop that sleeps to each edge, computes and slips as the node does; all times in s."""
    overruns, latest = 0, 0.0
    chunks = round(BARE_DURATION / chunk)
    edge = time.monotonic()
    for _ in range(chunks):
        edge += chunk
        time.sleep(max(0.0, edge - time.monotonic()))
        latest = max(latest, time.monotonic() - edge)
        compute(computing)
        late = time.monotonic() - edge - chunk
        if late > 0.0:
            overruns += 1
            edge += late
    return Bare(chunks, overruns, latest)


def look(data: bytes, node: NodeProcess) -> Look:
    """What diagnostics in CDR and the system tell of the node."""
    array = deserialize(TOPICS["diagnostics"].type, data)
    told: dict[str, dict[str, str]] = {
        status.name.rpartition(": ")[2]: {item.key: item.value for item in status.values}
        for status in array.status
    }
    return Look(
        time.monotonic(),
        node.resident() / 2**20,
        int(told["pacing"]["overruns"]),
        1e3 * float(told["pacing"]["worst lateness (s)"]),
        1e-6 * int(told["recorder"]["queued_bytes"]),
        int(told["recorder"]["lost"]),
        int(told["viewer"]["dropped"]),
    )


def busy(node: NodeProcess) -> float:
    """Processor time of the node's living threads, s."""
    return sum(node.thread_seconds().values())


def make_room(bag: Path) -> None:
    """Remove the finished files of the recording."""
    for part in sorted(bag.glob("*.mcap"), key=lambda part: part.stat().st_mtime_ns)[:-1]:
        part.unlink()


class _Splitter:
    """Calls ~/split every now and then."""

    def __init__(self, client: Client) -> None:
        self._service = client.ros.create_client(Trigger, "/gearbox/split")
        client.until(self._service.service_is_ready, PATIENCE)
        self._answers: list[Any] = []

    @property
    def count(self) -> int:
        """Calls so far."""
        return len(self._answers)

    def split(self, elapsed: float) -> None:
        """Call if it is time, ``elapsed`` s after the begin."""
        if elapsed >= SPLIT_INTERVAL * (self.count + 1):
            self._answers.append(self._service.call_async(Trigger.Request()))

    def check(self) -> None:
        """Raise GearboxError if a call, but for the last, has failed or was not answered."""
        for number, answer in enumerate(self._answers[:-1], 1):
            if not answer.done():
                raise GearboxError(f"~/split: call {number} was not answered: see the node's output")
            if not answer.result().success:
                raise GearboxError(f"~/split: call {number} failed: {answer.result().message}")


class _Pause:
    """Calls ~/pause and waits for the answer."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._service = client.ros.create_client(SetBool, "/gearbox/pause")
        client.until(self._service.service_is_ready, PATIENCE)
        self.count = 0  # pauses so far

    def switch(self, paused: bool) -> None:
        """Pause or continue. Raises GearboxError if there is no answer."""
        answer = self._service.call_async(SetBool.Request(data=paused))
        self._client.until(answer.done, PATIENCE)
        self.count += paused


def report(found: Found, output: Path | None) -> int:
    """Print the page, write it and its picture if wanted; returns the exit code."""
    table = rows(found)
    text = "\n".join(page(found, table))
    print(text)
    if output is not None:
        output.write_text(text, encoding="utf-8")
        picture(found.looks).savefig(output.with_name(PICTURE), dpi=80)
    return FAILURE if any(row.met is False for row in table) else 0


def rows(found: Found) -> list[Row]:
    """The figures, judged."""
    first, last = found.looks[0], found.looks[-1]
    samples = found.samples
    overruns = last.overruns - first.overruns
    chunks = round(found.simulated / found.chunk)
    dropped = last.dropped - first.dropped
    bare = found.bare
    expected = math.ceil(chunks * bare.overruns / bare.chunks) if bare.chunks else 0
    return [
        Row("real-time factor", f"{found.simulated / found.duration:.4f}"),
        Row("samples heard", f"{samples.heard}"),
        Row("samples lost", f"{samples.lost}", "0", samples.lost == 0),
        Row("samples doubled", f"{samples.doubled}", "0", samples.doubled == 0),
        Row("messages the recorder lost", f"{last.lost}", "0", last.lost == 0),
        Row("chunks", f"{chunks}"),
        Row(
            "overruns",
            f"{overruns}",
            f"at most {expected} (as often as the bare loop) and 1 in {CHUNKS_PER_OVERRUN} chunks",
            (overruns - expected) * CHUNKS_PER_OVERRUN <= chunks,
        ),
        Row("overruns of the bare loop", f"{bare.overruns} in {bare.chunks} chunks"),
        Row("latest begin of a chunk of the bare loop, ms", f"{1e3 * bare.latest:.2f}"),
        Row("latest begin of a chunk, ms", f"{max(look.lateness for look in found.looks[1:]):.2f}"),
        Row("longest queue of the recorder, MB", f"{max(look.queued for look in found.looks):.2f}"),
        Row("chunks the viewer dropped", f"{dropped}"),
        Row("memory at the end, MiB", f"{last.memory:.1f}"),
        memory_row(found.looks),
        Row("processor time, share of one core", f"{100 * found.processor_share:.1f} %"),
    ]


def memory_row(looks: list[Look]) -> Row:
    """What a line through the memory gains after it has settled."""
    name, asked = f"memory gained after {MEMORY_SETTLES:g} s, MiB", f"at most {MEMORY_GROWTH:g}"
    times, memory = np.array([(look.time - looks[0].time, look.memory) for look in looks]).T
    settled = times >= MEMORY_SETTLES
    if times[-1] < MEMORY_SETTLES + MEMORY_JUDGED:
        return Row(name, "too short to tell", asked)
    slope = np.polyfit(times[settled], memory[settled], 1)[0]
    gained = float(slope * (times[-1] - MEMORY_SETTLES))
    return Row(name, f"{gained:.2f}", asked, gained <= MEMORY_GROWTH)


def page(found: Found, table: list[Row]) -> list[str]:
    """The page in Markdown."""
    return [
        "# Soak",
        "",
        f"Made by `make soak` on {processor_name()} ({os.cpu_count()} logical processors), "
        f"Python {platform.python_version()}: the node with gearbox.yaml at real-time factor 1 for "
        f"{found.duration:.0f} s, all channels at 100 kHz, recording (`~/split` called {found.splits} times) "
        f"and Rerun (serve) on, {found.commands} commands at {1.0 / COMMAND_INTERVAL:g} Hz. A process beside "
        "it follows the time of every sample of `~/waveform`; the rest is from `/diagnostics`, once a "
        "second, and the system. Memory gained is what a straight line through the resident memory rises, "
        f"once Rerun's server holds all that it may ({LIVE_MEMORY}). "
        f"Every {BARE_INTERVAL:g} s the node was paused for {BARE_DURATION:g} s, and a bare loop took its "
        f"place, which sleeps to each edge and computes for {1e3 * found.computing:.2f} ms, as the engine, "
        "without node, ROS or recording.",
        "",
        "| figure | value | asked | |",
        "|---|---|---|---|",
        *(f"| {row.name} | {row.value} | {row.asked} | {verdict(row.met)} |" for row in table),
        "",
        f"![Resident memory, latest begin of a chunk and queue of the recorder over time]({PICTURE})",
        "",
    ]


def verdict(met: bool | None) -> str:
    """In a word."""
    return "" if met is None else "met" if met else "missed"


def picture(looks: list[Look]) -> Figure:
    """Memory, lateness and queue over wall time."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes: NDArray[Any] = figure.subplots(3, 1, sharex=True)
    times = [look.time - looks[0].time for look in looks]
    curves = {
        "memory, MiB": [look.memory for look in looks],
        "latest begin, ms": [look.lateness for look in looks],
        "queue, MB": [look.queued for look in looks],
    }
    for axis, (label, values) in zip(axes, curves.items(), strict=True):
        axis.plot(times, values, color=palette.BLUE, linewidth=1.0)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("wall time, s")
    return figure


if __name__ == "__main__":
    sys.exit(main())
