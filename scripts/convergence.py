"""Order of the engine, events located: its error against the referee over the first millisecond, by step.

Prints the table of docs/validation.md and draws docs/convergence.png.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

from gear_dynamics_ros import palette  # noqa: E402
from gear_dynamics_ros.parameters import Parameters  # noqa: E402
from gear_dynamics_ros.simulation.engine import Engine  # noqa: E402
from support.measurements import PUBLISHED  # noqa: E402
from support.referee import Referee, nested  # noqa: E402

MODELS = ("traditional", "compared", "improved")
SWITCHES: dict[str, dict[str, Any]] = {"refined": {}, "published": PUBLISHED}
STEPS = tuple(4.0 / 2**k for k in range(7))  # us
INTERVAL = 4.0  # us, of the samples compared: a whole number of every step
DURATION = 1000.0  # us
SAMPLES = round(DURATION / INTERVAL) + 1

COLOURS = {"traditional": palette.BLUE, "compared": palette.ORANGE, "improved": palette.GREEN}
MARKERS = {"traditional": "o", "compared": "s", "improved": "^"}


class Study(NamedTuple):
    """Errors of one model, nm, one for each of STEPS."""

    model: str
    switches: str
    events: int
    errors: tuple[float, ...]

    @property
    def orders(self) -> tuple[float, ...]:
        """Observed order from each step to its half."""
        return tuple(math.log2(a / b) for a, b in zip(self.errors, self.errors[1:], strict=False))


def parameters(model: str, switches: str, rpm: float, step: float) -> Parameters:
    """Default parameters, hence rough surfaces, with torques in force and ``step`` in us."""
    return Parameters.from_flat(
        {
            "model": model,
            **SWITCHES[switches],
            "operation.control": "torque",
            "operation.speed": rpm * math.pi / 30.0,
            "solver.step": step * 1e-6,
            "solver.sample_interval": INTERVAL * 1e-6,
        }
    )


def dte(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """DTE in nm."""
    column: NDArray[np.float64] = samples[:, 1] * 1e9
    return column


def study(model: str, switches: str, rpm: float) -> Study:
    """Run referee and engine."""
    referee = Referee(nested(parameters(model, switches, rpm, STEPS[-1]).to_flat()))
    expected = dte(referee.run(SAMPLES))
    errors = []
    for step in STEPS:
        samples = Engine(parameters(model, switches, rpm, step)).advance(SAMPLES).samples
        errors.append(float(np.abs(dte(samples) - expected[: len(samples)]).max()))
    return Study(model, switches, len(referee.events), tuple(errors))


def table(studies: Sequence[Study]) -> str:
    """Markdown: error in nm at each step and, in brackets, the order reached since the step before."""
    lines = [
        "| model | switches | events | " + " | ".join(f"{step:g} us" for step in STEPS) + " |",
        "|---|---|---|" + "---|" * len(STEPS),
    ]
    for s in studies:
        cells = [f"{s.errors[0]:.1e}"]
        cells += [f"{error:.1e} ({order:.1f})" for error, order in zip(s.errors[1:], s.orders, strict=True)]
        lines.append(f"| {s.model} | {s.switches} | {s.events} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(studies: Sequence[Study]) -> Figure:
    """Error against step, a marker for each model, a panel for each set of switches."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(1, len(SWITCHES), sharex=True, sharey=True)
    for ax, switches in zip(axes, SWITCHES, strict=True):
        draw_panel(ax, [s for s in studies if s.switches == switches])
        ax.set_title(f"{switches} switches", fontsize=10)
    axes[0].set_ylabel("largest error in DTE over 1 ms, nm")
    axes[0].legend(frameon=False, loc="upper left")
    return figure


def draw_panel(ax: Axes, studies: Sequence[Study]) -> None:
    """The models of one set of switches, with a guide of fourth order below them."""
    for s in studies:
        ax.loglog(STEPS, s.errors, color=COLOURS[s.model], marker=MARKERS[s.model], ms=6, label=s.model)
    at_one = min(s.errors[STEPS.index(1.0)] for s in studies) / 3.0
    ax.loglog(STEPS, [at_one * step**4 for step in STEPS], "--", color=palette.GREY, label="fourth order")
    ax.set_xticks(STEPS, [f"{step:g}" for step in STEPS], fontsize=8)
    ax.minorticks_off()
    ax.set_xlabel("step, us")
    ax.grid(True, color="0.9")
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rpm", type=float, default=15500.0, help="speed (default: %(default)g)")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "convergence.png", help="the plot")
    arguments = parser.parse_args()
    studies = [study(model, switches, arguments.rpm) for switches in SWITCHES for model in MODELS]
    print(table(studies))
    draw(studies).savefig(arguments.output, dpi=80)


if __name__ == "__main__":
    main()
