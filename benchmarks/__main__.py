"""Every benchmark in one run, as a page of Markdown: python benchmarks [--output FILE] [--docs FOLDER]."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

import after_run
import earlier
import general_solvers
import latency
import numpy as np
import plain_c
import recordings
import speed
import sweep_speed

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.provenance import processor_name

REAL_TIME_AIMED_AT = {"traditional": 5.0, "compared": 5.0, "improved": 3.0}
RATIO_AIMED_AT = 1.2
SOLVER_REPEATS = 3
RECORDINGS = "Recordings: writing, reading, verifying"
AFTER_RUN = "Reports and views of a recording"
SCHEDULING = "Real-time scheduling"
SWEEPS = "Sweeps"
PAGES = {
    RECORDINGS: "recording.md",
    AFTER_RUN: "report.md",
    SCHEDULING: "real_time.md",
    SWEEPS: "sweeps.md",
}  # pages that show a section
MADE = "Made by `make bench` on {machine}."

Lines = list[str]


class Section(NamedTuple):
    """A heading, what the table under it shows, and how to make the table."""

    title: str
    note: str
    table: Callable[[], Lines]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="also write the page to this file")
    parser.add_argument(
        "--before",
        default=earlier.COMMIT,
        metavar="COMMIT",
        help="commit whose figures stand beside today's (default: %(default)s)",
    )
    parser.add_argument(
        "--docs", type=Path, help="folder of pages whose figures, between their marks, are to be replaced"
    )
    arguments = parser.parse_args()
    page: Lines = []
    for part in parts(arguments.before):
        print("\n".join(part), flush=True)
        page += part
        name = PAGES.get(part[0].removeprefix("## "))
        if name and arguments.docs is not None:
            replace_figures(arguments.docs / name, [MADE.format(machine=machine()), "", *part[2:]])
    if arguments.output is not None:
        arguments.output.write_text("\n".join(page).rstrip() + "\n", encoding="utf-8")


def replace_figures(path: Path, lines: Lines) -> None:
    """Put ``lines`` between the marks of a page."""
    before, begin, rest = path.read_text(encoding="utf-8").partition("<!-- figures -->\n")
    _, end, after = rest.partition("<!-- end of figures -->")
    if not (begin and end):
        raise GearboxError(f"{path} has no place for figures: it lacks the marks of their begin and end")
    text = "\n".join(lines).strip()
    path.write_text(f"{before}{begin}{text}\n{end}{after}", encoding="utf-8")


def machine() -> str:
    """What the figures are from."""
    return f"{processor_name()} ({os.cpu_count()} logical processors), Python {platform.python_version()}"


def parts(before: str) -> Iterator[Lines]:
    """The page, piece by piece as it is measured; ``before`` is the commit to compare with."""
    yield [
        "# Benchmarks",
        "",
        f"{MADE.format(machine=machine())} Unless said otherwise: one core, 15500 rpm, steps of 2 us, all "
        "channels at 100 kHz and chunks of 2 ms; medians of turns in one run.",
        "",
    ]
    for section in sections(before):
        yield [f"## {section.title}", "", *([section.note, ""] if section.note else []), *section.table(), ""]


def sections(before: str) -> list[Section]:
    """What is measured."""
    try:
        plain_c.library()
    except GearboxError as error:
        yardsticks = [Section("Speed", f"Without the C program: {error}.", engine_alone)]
    else:
        yardsticks = [
            Section(
                "Speed, beside a plain C program",
                f"`plain/gearbox.c`, compiled by `{plain_c.command()}`: the same RK4, events and "
                "samples; works and losses, the list of impacts and the mesh impulse are the engine's alone. "
                "DTE is compared over the first millisecond. The ratio is that of times, engine to C, turn "
                "by turn.",
                beside_c,
            ),
            Section(
                "One evaluation",
                "ns, each on the result of the one before: a right-hand side with flags frozen; the sum of "
                "all periodic excitations at any phase; and, as the engine's whole steps take it, half a "
                "step on.",
                evaluations,
            ),
        ]
    return [
        *yardsticks,
        Section("Step", "Model improved.", speed.steps),
        Section("Sampling", "Model improved, all 28 channels.", speed.sampling),
        Section("Chunks", "Model improved.", speed.chunks),
        Section(
            "Recording",
            "By the clock on the wall, the files finished.",
            lambda: speed.recording(tuple(REAL_TIME_AIMED_AT)),
        ),
        Section(RECORDINGS, "Model improved, gearbox.yaml, unless said otherwise.", recordings.tables),
        Section(
            AFTER_RUN,
            "Made by `simulate` with gearbox.yaml, all topics; each command is a process of its own.",
            after_run.tables,
        ),
        Section(
            SWEEPS,
            f"config/paper.yaml, {sweep_speed.SPEEDS} speeds from 2000 to 18000 rpm, 4000 mesh periods in "
            "100 steps each. Below: the median over speeds and models of what coarser steps change, beside "
            f"{sweep_speed.FINE} steps per period; chaotic points differ by their statistics too.",
            sweep_speed.tables,
        ),
        Section(
            "Latency",
            "The node in a process of its own with gearbox.yaml at real-time factor 1, this one listening to "
            "its waveform. From publishing a load torque, at any phase of a chunk, to having the first "
            "`joint_states` that shows it; the goal is chunk, computing (the engine alone) and "
            f"{1e3 * latency.ALLOWANCE:g} ms. Bare loop: sleeps to each edge and computes as long, without "
            "node, ROS or listener: the lateness of the machine itself. Period: between two `joint_states`.",
            latency.latency,
        ),
        Section(
            "Processor time of the node",
            "As before, in chunks of 2 ms; shares of one core by thread. `main` serves.",
            latency.processor_time,
        ),
        Section(
            SCHEDULING,
            f"The same node and commands in chunks of 2 ms, beside {latency.BUSY_LOOPS} busy loops on "
            f"{len(os.sched_getaffinity(0))} processors; what each setting of the scheduler gives.",
            latency.scheduling,
        ),
        Section(
            "Beside an earlier commit",
            "Both versions in turns with gearbox.yaml as each has it; medians. The node runs at real-time "
            "factor 1 and nobody listens to its waveform, but for the latency.",
            lambda: beside_earlier(before),
        ),
        Section("Error", "Beside the independent solver of the tests.", speed.referee),
        Section(
            "General solvers",
            "Processor time for the first millisecond of DTE, and its largest error. All have a "
            "compiled right-hand side and compiled switching surfaces. Stepped by hand, LSODA's steps are "
            "watched from Python, with neither solve_ivp's bookkeeping nor its search for events; what is "
            "left of its cost is the call back into Python at each evaluation.",
            lambda: general_solvers.compare(SOLVER_REPEATS),
        ),
    ]


def beside_earlier(before: str) -> Lines:
    """Today's figures beside those of an earlier commit, or why there are none."""
    try:
        return earlier.beside(before)
    except GearboxError as error:
        return [f"Not measured: {error}."]


def cases() -> Iterator[tuple[str, str, Parameters]]:
    """Both files in all models."""
    for name, model in product(speed.FILES, REAL_TIME_AIMED_AT):
        yield name, model, speed.parameters_of(name, model=model)


def beside_c() -> Lines:
    """Engine and C program in turns."""
    lines = [
        "| parameters | model | engine, ns per step | C, ns per step | ratio | goal | times real time | goal "
        "| DTE differs by, m | events, engine and C |",
        "|---" * 10 + "|",
    ]
    reached = {}
    for name, model, parameters in cases():
        of_program, of_engine, ratio = plain_c.step_ns(parameters)
        reached[model] = max(reached.get(model, 0.0), parameters.solver.step * 1e9 / of_program)
        same = plain_c.compare(parameters)
        lines.append(
            f"| {name}.yaml | {model} | {of_engine:.0f} | {of_program:.0f} | {ratio:.2f} "
            f"| {at_most(RATIO_AIMED_AT, ratio)} | {real_time(model, of_engine, parameters)} "
            f"| {same.dte:.1e} | {same.engine_events}, {same.events} |"
        )
    by_c = ", ".join(f"{times:.2f} ({model})" for model, times in reached.items())
    return [
        *lines,
        "",
        "The goals in real time are those of a quiet 3.6 GHz core. The C program, here and with either file, "
        f"reaches at most {by_c} times real time: where the engine misses a goal beside a ratio that is met, "
        "it is for want of a faster core. With gearbox.yaml the compared model's bearing contacts begin "
        "slowly and are stiff: the C program divides its steps, the engine need not.",
    ]


def engine_alone() -> Lines:
    """The engine where there is no C compiler."""
    lines = ["| parameters | model | ns per step | times real time | goal |", "|---" * 5 + "|"]
    for name, model, parameters in cases():
        cost = float(np.median(speed.turns({model: Engine(parameters)})))
        nanoseconds = cost * parameters.solver.step * 1e9
        lines.append(
            f"| {name}.yaml | {model} | {nanoseconds:.0f} | {real_time(model, nanoseconds, parameters)} |"
        )
    return lines


def evaluations() -> Lines:
    """Parts of the engine and of the C program."""
    lines = [
        "| parameters | model | right-hand side, engine | C | excitations, engine | C "
        "| half a step on, engine |",
        "|---" * 7 + "|",
    ]
    for name, model, parameters in cases():
        ours = speed.costs(parameters)
        program = plain_c.PlainC(parameters)
        program.advance(plain_c.WARM_CHUNKS * parameters.solver.samples_per_chunk)
        lines.append(
            f"| {name}.yaml | {model} | {ours.right_hand_side:.1f} | {program.evaluation_ns():.1f} "
            f"| {ours.excitations:.1f} | {program.excitation_ns():.1f} | {ours.excitations_on:.1f} |"
        )
    return lines


def real_time(model: str, nanoseconds: float, parameters: Parameters) -> str:
    """Two cells: times real time, and the goal."""
    times = parameters.solver.step * 1e9 / nanoseconds
    return f"{times:.2f} | {at_least(REAL_TIME_AIMED_AT[model], times)}"


def at_least(goal: float, value: float) -> str:
    """The goal, and whether it is met or by how much it is missed."""
    return f"at least {goal:g}, " + (
        "met" if value >= goal else f"missed by {100 * (1 - value / goal):.0f} %"
    )


def at_most(goal: float, value: float) -> str:
    """The goal, and whether it is met or by how much it is missed."""
    verdict = "met" if value <= goal else f"missed by {100 * (value / goal - 1):.0f} %"
    return f"at most {goal:g}, {verdict}"


if __name__ == "__main__":
    main()
