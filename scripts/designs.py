"""Designs of the integrator side by side: error of every referee case and time of a step, in one run.

Prints the tables of docs/validation.md. Each design is compiled in a process of its own, from the kernel with
some of its functions or limits replaced. Times are the processor's; the designs take turns.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from gear_dynamics_ros.parameters import Parameters, load_parameters  # noqa: E402
from gear_dynamics_ros.physics.kernel import impulse, step, substeps  # noqa: E402
from gear_dynamics_ros.physics.kernel.bearing import BearingForces  # noqa: E402
from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined  # noqa: E402
from gear_dynamics_ros.physics.kernel.lanes import both, load2, store  # noqa: E402
from gear_dynamics_ros.physics.kernel.mesh import rolling_rate  # noqa: E402
from gear_dynamics_ros.physics.kernel.waves import surface_at  # noqa: E402
from gear_dynamics_ros.simulation.engine import Engine  # noqa: E402
from support.referee import Referee, nested  # noqa: E402
from support.referee_runs import ROUGH, RUNS, SAMPLES, dte_error  # noqa: E402

STEP: Final = 2e-6  # s
FINE_STEP: Final = STEP / 16.0  # what a settled run is compared with
MODELS: Final = ("traditional", "compared", "improved")
WARM_CHUNKS: Final = 100
TIMED_CHUNKS: Final = 25
TURNS: Final = 11
WINDOWS: Final = 8

whole_mesh_impulse: Any = impulse.add_mesh_impulse
rule_of_substeps: Any = substeps.longest_substep


@inlined
def no_impulse(
    constants: Any,
    state: Any,
    here: Any,
    end: Any,
    h: Any,
    taken: Any,
    shifted: Any,
    mesh: Any,
    contacts: Any,
    last: Any,
) -> Any:
    """RK4 alone."""
    return 0.0


@inlined
def surface_impulse(
    constants: Any,
    state: Any,
    here: Any,
    end: Any,
    h: Any,
    taken: Any,
    shifted: Any,
    mesh: Any,
    contacts: Any,
    last: Any,
) -> Any:
    """The surfaces alone, their integral of sixth order from three values and two rates."""
    phase = impulse.phase_over(constants, state, here, end, h, last.rates)
    z0, s0 = here.surface, here.surface_rate
    zm, sm = surface_at(end.middle, phase.lead_middle, phase.rate_middle)
    z1, s1 = surface_at(end.excitation, phase.lead_end, phase.rate_end)
    integral = h * (7.0 * (z0 + z1) + 16.0 * zm) / 30.0 + h * h * (s0 - s1) / 60.0
    damping = constants.damping if constants.contact_damping else 0.0
    answered = h / 6.0 * (4.0 * (zm - z0) + (z1 - z0) - h * (s0 + 2.0 * sm))
    push = (
        0.5
        * state.flank
        * (
            damping * ((z1 - z0) - h / 6.0 * (s0 + 4.0 * sm + s1))
            + mesh.stiffness * (integral - h / 6.0 * (z0 + 4.0 * zm + z1))
            - damping * damping * constants.per_mesh_mass * answered
        )
    )
    shift = 0.5 * state.flank * damping * (integral - h * z0 - h * h / 6.0 * (s0 + 2.0 * sm))
    per_mass = load2(constants.per_mass, 0)
    per_inertia = load2(constants.base_radius, 0) * load2(constants.per_inertia, 0)
    speed_change, displacement = both(-push, push) * per_mass, both(-shift, shift) * per_mass
    rotation = both(-shift, shift) * per_inertia
    store(end.vx, 0, load2(end.vx, 0) + speed_change * mesh.along_x)
    store(end.vy, 0, load2(end.vy, 0) + speed_change * mesh.along_y)
    store(end.omega, 0, load2(end.omega, 0) + both(-push, push) * per_inertia)
    store(end.x, 0, load2(end.x, 0) + displacement * mesh.along_x)
    store(end.y, 0, load2(end.y, 0) + displacement * mesh.along_y)
    end.u += rolling_rate(constants, rotation)
    end.theta1 += rotation[0]
    end.mesh_impulse += push
    return rotation[0]


@inlined
def unanswered_impulse(
    constants: Any,
    state: Any,
    here: Any,
    end: Any,
    h: Any,
    taken: Any,
    shifted: Any,
    mesh: Any,
    contacts: Any,
    last: Any,
) -> Any:
    """The whole mesh force, but the bearing contacts don't answer."""
    free = BearingForces(
        force_x=contacts.force_x,
        force_y=contacts.force_y,
        normal_x=contacts.normal_x,
        normal_y=contacts.normal_y,
        penetration=contacts.penetration,
        penetration_rate=contacts.penetration_rate,
        damping=both(0.0, 0.0),
        clamp=contacts.clamp,
        loss_rate=contacts.loss_rate,
    )
    return whole_mesh_impulse(constants, state, here, end, h, taken, shifted, mesh, free, last)


@compiled
def halved_in_mesh(constants: Any, state: Any, here: Any) -> Any:
    """Half the step while the teeth touch."""
    longest = rule_of_substeps(constants, state, here)
    if state.flank != 0.0:
        longest = min(longest, 0.5 * constants.step)
    return longest


class Design(NamedTuple):
    """A column of the tables: what replaces names of the modules ``step`` and ``substeps``."""

    name: str
    step: dict[str, Any]
    substeps: dict[str, Any]


FINE: Final = {"SETTLED_STIFFNESS_LIMIT": 0.25, "SHARE_OF_AGE": 1.0}
DESIGNS: Final = (
    Design("RK4 alone", {"add_mesh_impulse": no_impulse}, FINE),
    Design("surface impulse", {"add_mesh_impulse": surface_impulse}, FINE),
    Design(
        "the same, half steps in mesh",
        {"add_mesh_impulse": surface_impulse},
        {**FINE, "longest_substep": halved_in_mesh},
    ),
    Design("mesh impulse", {"add_mesh_impulse": unanswered_impulse}, FINE),
    Design("the same, contacts answer", {}, FINE),
    Design("adopted", {}, {}),
)
BASE: Final = 1  # whose times the others are compared with


def run_design(index: int, folder: Path) -> None:
    """Worker: writes the error of every case in nm, then the seconds that a model takes whenever asked."""
    design = DESIGNS[index]
    for module, changes in ((step, design.step), (substeps, design.substeps)):
        for name, value in changes.items():
            getattr(module, name)  # a name that it doesn't have would replace nothing
            setattr(module, name, value)
    expected = np.load(folder / "expected.npz")
    errors = {}
    for name, changes in RUNS.items():
        engine = Engine(Parameters.from_flat({**ROUGH, **changes, "solver.step": STEP}))
        errors[name] = 1e9 * dte_error(engine.advance(SAMPLES).samples, expected[name])
    engines = {model: gearbox(model, STEP) for model in MODELS}
    for model, engine in engines.items():
        advance(engine, WARM_CHUNKS)
        errors[f"{model}, gearbox.yaml, settled"] = settled_error(engine, gearbox(model, FINE_STEP))
    print(json.dumps(errors), flush=True)
    for line in sys.stdin:
        print(json.dumps(advance(engines[line.strip()], TIMED_CHUNKS)), flush=True)


def gearbox(model: str, step: float) -> Engine:
    """Engine with the parameters of config/gearbox.yaml."""
    path = ROOT / "config" / "gearbox.yaml"
    return Engine(replace(load_parameters(path, [f"solver.step={step}"]), model=model))


def settled_error(engine: Engine, fine: Engine) -> float:
    """Largest difference in DTE in nm over a millisecond, of several, from a fine run of the same start."""
    found = []
    for _ in range(WINDOWS):
        fine._state[:] = engine._state
        found.append(dte_error(engine.advance(SAMPLES).samples, fine.advance(SAMPLES).samples))
    return 1e9 * max(found)


def advance(engine: Engine, chunks: int) -> float:
    """Processor time in ns a step of ``chunks``."""
    began = time.thread_time_ns()
    for _ in range(chunks):
        engine.advance()
    taken = time.thread_time_ns() - began
    solver = engine.parameters.solver
    return taken / (chunks * solver.samples_per_chunk * solver.steps_per_sample)


class Worker:
    """Process of one design, with a cache of compiled functions of its own."""

    def __init__(self, index: int, folder: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--design", str(index), "--folder", str(folder)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(folder / f"cache_{index}")},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def answer(self) -> Any:
        """The next line that it writes."""
        output: IO[str] = self.process.stdout  # type: ignore[assignment]
        line = output.readline()
        if not line:
            raise SystemExit(f"the process of a design ended with exit code {self.process.wait()}")
        return json.loads(line)

    def ask(self, model: str) -> float:
        """Time of a step of ``model``, ns."""
        requests: IO[str] = self.process.stdin  # type: ignore[assignment]
        requests.write(model + "\n")
        requests.flush()
        return float(self.answer())

    def close(self) -> None:
        """End the process."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait()


def table(head: str, rows: dict[str, list[str]]) -> str:
    """Markdown with a column for each design."""
    lines = [f"| {head} | " + " | ".join(design.name for design in DESIGNS) + " |"]
    lines.append("|---" * (1 + len(DESIGNS)) + "|")
    lines += [f"| {name} | " + " | ".join(cells) + " |" for name, cells in rows.items()]
    return "\n".join(lines)


def timed(workers: list[Worker], model: str) -> list[str]:
    """Median time of each design and, in brackets, the median of its ratio to the base in the same turn."""
    turns: NDArray[np.float64] = np.array([[worker.ask(model) for worker in workers] for _ in range(TURNS)])
    return [
        f"{statistics.median(column):.0f} ({statistics.median(column / turns[:, BASE]):.2f})"
        for column in turns.T
    ]


def compare(folder: Path) -> None:
    """Print both tables."""
    expected = {
        name: Referee(nested(Parameters.from_flat({**ROUGH, **changes}).to_flat())).run(SAMPLES)
        for name, changes in RUNS.items()
    }
    save: Callable[..., None] = np.savez
    save(folder / "expected.npz", **expected)
    workers = [Worker(index, folder) for index in range(len(DESIGNS))]
    try:
        errors = [worker.answer() for worker in workers]
        print(table("error in nm", {name: [f"{found[name]:.1e}" for found in errors] for name in errors[0]}))
        print()
        print(table("ns per step", {model: timed(workers, model) for model in MODELS}))
    finally:
        for worker in workers:
            worker.close()


def main() -> None:
    """The tables, or one design's share of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--design", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.design is not None:
        run_design(arguments.design, arguments.folder)
        return
    with tempfile.TemporaryDirectory() as folder:
        compare(Path(folder))


if __name__ == "__main__":
    main()
