"""Print the tables of docs/validation.md: what validates the physics, and the distance from the referee."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]


def print_measurements() -> int:
    """The validation table; returns how many tolerances were missed."""
    from support.measurements import GROUPS

    print("| what | measured | reference | error | tolerance |")
    print("|---|---|---|---|---|")
    missed = 0
    for group in GROUPS.values():
        for m in group():
            missed += not m.holds
            unit = f" {m.unit}" if m.unit else ""
            error = f"{m.error:.1e}" if m.holds else f"**{m.error:.1e}, missed**"
            numbers = f"{m.measured:.9g}{unit} | {m.reference:.9g}{unit}"
            print(f"| {m.what} | {numbers} | {error} | {m.tolerance:g} |")
    return missed


def print_agreement() -> None:
    """Engine against referee over the first millisecond."""
    import numpy as np

    from gear_dynamics_ros.parameters import Parameters
    from gear_dynamics_ros.simulation.engine import Engine
    from support.referee import CHANNELS, Referee, nested
    from support.referee_runs import ROUGH, RUNS, SAMPLES, disagreement

    steps = (2e-6, 1e-6, 0.5e-6, 0.25e-6, 0.125e-6)
    columns = " | ".join(f"{step * 1e6:g} us, nm" for step in steps)
    print(f"| run | events | {columns} | worst channel at 2 us, of its range |")
    print("|---|---|" + "---|" * len(steps) + "---|")
    for name, changes in RUNS.items():
        values = {**ROUGH, **changes}
        referee = Referee(nested(Parameters.from_flat(values).to_flat()))
        expected = referee.run(SAMPLES)
        errors, worst = [], ""
        for step in steps:
            samples = Engine(Parameters.from_flat({**values, "solver.step": step})).advance(SAMPLES).samples
            errors.append(f"{1e9 * np.abs(samples[:, 1] - expected[:, 1]).max():.1e}")
            off = disagreement(samples, expected, len(CHANNELS))
            channel = max(off, key=lambda key: off[key])
            worst = worst or f"{channel} {off[channel]:.1e}"
        print(f"| {name} | {len(referee.events)} | " + " | ".join(errors) + f" | {worst} |")


def main() -> int:
    missed = print_measurements()
    print()
    print_agreement()
    print(f"{missed} missed" if missed else "all within tolerance", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
