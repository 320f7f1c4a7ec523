"""Error against time: the engine beside general solvers, in one run on the same problems.

    python benchmarks/general_solvers.py [--plot docs/work_precision.png]

The error is the largest deviation of DTE at 100 kHz samples from test/support/referee.py over the first
millisecond. The engine's time includes its other channels, that of the others only DTE. Compilation is
excluded. A time at the error aimed at lies between those of neighbouring settings, on a straight line in the
logarithms; ratios are made repeat by repeat, and their median is quoted.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.palette import BLUE, DIM, GREEN, GREY, ORANGE, PURPLE, SKY
from gear_dynamics_ros.parameters import Parameters, load_parameters
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine

SOURCE = Path(__file__).resolve().parent.parent
PROBLEMS = {
    "published model, 15500 rpm": SOURCE / "config" / "paper.yaml",
    "refined model, 9000 rpm": SOURCE / "test" / "cases" / "refined_9000.yaml",
}
ENGINE = "this engine"
STEPS = ("2e-6", "1e-6", "5e-7", "2.5e-7", "1.25e-7")  # s
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
SAMPLES = 101
ERROR_AIMED_AT = 0.01  # nm
RATIO_AIMED_AT = 100
REPEATS = 5
ENGINE_RUNS = 9  # in one repeat: a run of the engine is a fraction of a millisecond
LINES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (DIM, "v"), (PURPLE, "D"), (SKY, "P"), (GREY, "X"))
PICTURE_COLOURS = 64

Run = Callable[[], NDArray[np.float64]]


class Result(NamedTuple):
    """One solver on one problem, from its coarsest setting to its finest."""

    solver: str
    settings: list[str]
    errors: list[float]  # nm
    seconds: NDArray[np.float64]  # (repeats, settings)

    def seconds_at(self, error: float) -> list[float]:
        """Time at ``error`` (nm) in each repeat; infinite if it is never reached."""
        return [interpolated(error, self.errors, row) for row in self.seconds]


def compare(repeats: int = REPEATS, plot: Path | None = None) -> list[str]:
    """Lines of Markdown: a table for each problem and the ratios; ``plot`` is a PNG to write."""
    lines, results = [], {}
    for name, path in PROBLEMS.items():
        results[name] = measure(path, repeats)
        lines += [*table(name, results[name]), ""]
    lines += [verdict(name, found) for name, found in results.items()]
    if plot is not None:
        draw(results, plot)
    return lines


def measure(path: Path, repeats: int) -> list[Result]:
    """Every solver at every setting on the parameters of one file, in turn, ``repeats`` times."""
    parameters = load_parameters(path)
    reference = referee_dte(path)
    runs = {ENGINE: engine_runs(path), **solver_runs(parameters)}
    errors = {
        solver: [float(np.abs(run() - reference).max() * 1e9) for run in settings.values()]
        for solver, settings in runs.items()
    }
    times: dict[str, list[list[float]]] = {solver: [] for solver in runs}
    for _ in range(repeats):
        for solver, settings in runs.items():
            inner = ENGINE_RUNS if solver == ENGINE else 1
            times[solver].append([seconds(run, inner) for run in settings.values()])
    return [
        Result(solver, list(settings), errors[solver], np.array(times[solver]))
        for solver, settings in runs.items()
    ]


def referee_dte(path: Path) -> NDArray[np.float64]:
    """DTE in m by the independent program of the tests."""
    sys.path.append(str(SOURCE / "test"))
    from support.referee import CHANNELS, Referee, load_case

    rows: NDArray[np.float64] = Referee(load_case(path)).run(SAMPLES)
    return rows[:, CHANNELS.index("dte")]


def engine_runs(path: Path) -> dict[str, Run]:
    """A run at each step; it goes one sample interval further than those of the other solvers."""
    engines = {step: Engine(load_parameters(path, [f"solver.step={step}"])) for step in STEPS}
    return {step: partial(rerun, engine, engine.checkpoint()) for step, engine in engines.items()}


def rerun(engine: Engine, start: Checkpoint) -> NDArray[np.float64]:
    """DTE in m from ``start`` on."""
    engine.restore(start)
    return engine.advance(SAMPLES)["dte"]


def solver_runs(parameters: Parameters) -> dict[str, dict[str, Run]]:
    """A run of each general solver at each tolerance."""
    try:
        from solvers.drivers import drivers
    except ModuleNotFoundError as error:
        raise SystemExit(f"{error}: pip install '.[bench]'") from error
    from solvers.model import build

    times = parameters.solver.sample_interval * np.arange(SAMPLES, dtype=np.float64)
    return {
        solver: {f"{tolerance:g}": partial(driver, tolerance, times) for tolerance in TOLERANCES}
        for solver, driver in drivers(build(parameters)).items()
    }


def seconds(run: Run, count: int) -> float:
    """Median processor time of ``count`` runs; on a busy machine wall time would favour the short ones."""
    found = []
    for _ in range(count):
        began = time.process_time()
        run()
        found.append(time.process_time() - began)
    return statistics.median(found)


def interpolated(error: float, errors: Sequence[float], times: Sequence[float]) -> float:
    """Time at which ``error`` is first reached, the settings running from coarse to fine."""
    if errors[0] <= error:
        return float(times[0])
    for k in range(1, len(errors)):
        if errors[k] <= error < errors[k - 1]:
            part = math.log(error / errors[k - 1]) / math.log(errors[k] / errors[k - 1])
            return float(times[k - 1] * (times[k] / times[k - 1]) ** part)
    return math.inf


def ratios(result: Result, engine: Result) -> list[float]:
    """Time at the error aimed at against the engine's, repeat by repeat."""
    pairs = zip(result.seconds_at(ERROR_AIMED_AT), engine.seconds_at(ERROR_AIMED_AT), strict=True)
    return [other / ours for other, ours in pairs]


def table(name: str, results: Sequence[Result]) -> list[str]:
    """One row for each solver: each time with its error, and the time at the error aimed at."""
    engine, *others = results
    steps = ", ".join(f"{float(step) * 1e6:g}" for step in engine.settings)
    lines = [
        f"{name[0].upper()}{name[1:]}, {SAMPLES} samples; engine at steps of {steps} us, the others at "
        f"tolerances of {', '.join(others[0].settings)} of the vibration:",
        "",
        f"| solver | ms (error of DTE, nm), from coarse to fine | ms at {ERROR_AIMED_AT:g} nm | times ours |",
        "|---|---|---|---|",
    ]
    for result in results:
        medians = 1e3 * np.median(result.seconds, axis=0)
        pairs = zip(medians, result.errors, strict=True)
        cells = ", ".join(f"{milliseconds:.3g} ({error:.2g})" for milliseconds, error in pairs)
        at = 1e3 * statistics.median(result.seconds_at(ERROR_AIMED_AT))
        ratio = statistics.median(ratios(result, engine))
        lines.append(f"| {result.solver} | {cells} | {at:.3g} | {ratio:.3g} |")
    return lines


def verdict(name: str, results: Sequence[Result]) -> str:
    """The best of the others beside the engine, in one line."""
    engine, *others = results
    medians = {result.solver: statistics.median(ratios(result, engine)) for result in others}
    best = min(medians, key=medians.__getitem__)
    met = "met" if medians[best] >= RATIO_AIMED_AT else "missed"
    return (
        f"{name[0].upper()}{name[1:]}, at {ERROR_AIMED_AT:g} nm: the best of the others, {best}, takes "
        f"{medians[best]:.3g} times the engine's time, the slowest {max(medians.values()):.3g} times "
        f"(goal: {RATIO_AIMED_AT}; {met})."
    )


def draw(results: dict[str, list[Result]], path: Path) -> None:
    """Time against error for every solver, one panel a problem."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from PIL import Image

    figure, panels = plt.subplots(
        1, len(results), figsize=(9.6, 4.8), sharex=True, sharey=True, layout="constrained"
    )
    for panel, (name, found) in zip(panels, results.items(), strict=True):
        for result, (colour, marker) in zip(found, LINES, strict=True):
            ours = result.solver == ENGINE
            panel.loglog(
                result.errors,
                1e3 * np.median(result.seconds, axis=0),
                color=colour,
                marker=marker,
                markersize=6 if ours else 4.5,
                linewidth=2.5 if ours else 1.2,
                label=result.solver,
            )
        panel.axvline(ERROR_AIMED_AT, color=GREY, linewidth=0.8, linestyle="--")
        panel.set(title=name, xlabel="largest error of DTE, nm")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("processor time for 1 ms, ms")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=100)
    plt.close(figure)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(PICTURE_COLOURS).save(path, optimize=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--plot", type=Path, help="also draw time against error to this PNG")
    parser.add_argument("--repeats", type=int, default=REPEATS)
    options = parser.parse_args()
    print("\n".join(compare(options.repeats, options.plot)))


if __name__ == "__main__":
    main()
