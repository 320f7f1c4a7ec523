"""Print and draw how far the energy of an undamped gear pair drifts, exact against published geometry."""

from __future__ import annotations

import argparse
import io
import math
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

ROOT: Final = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from gear_dynamics_ros import palette  # noqa: E402
from gear_dynamics_ros.parameters import BearingParameters, Parameters  # noqa: E402
from gear_dynamics_ros.physics.constants import base_radii, hertz_factor  # noqa: E402
from gear_dynamics_ros.simulation.engine import Engine  # noqa: E402

Vector = NDArray[np.float64]

DURATION: Final = 20e-3  # s
DEFAULT_STEP: Final = 1e-6  # s
FINE_STEP: Final = DEFAULT_STEP / 8.0
# Nothing dissipates and nothing moves with the phase: all that is left is to conserve energy.
CONSERVATIVE: Final = {
    "model": "compared",
    "mesh.damping_ratio": 0.0,
    "mesh.stiffness_cos": [0.0],
    "mesh.error_cos": [0.0],
    "surface.driving.roughness": 0.0,
    "surface.driven.roughness": 0.0,
    "bearings.driving.restitution": 1.0,
    "bearings.driven.restitution": 1.0,
    "operation.control": "torque",
}
COLOURS: Final = {
    ("published", FINE_STEP): palette.PURPLE,
    ("published", DEFAULT_STEP): palette.ORANGE,
    ("exact", DEFAULT_STEP): palette.BLUE,
    ("exact", FINE_STEP): palette.SKY,
}


class Trace(NamedTuple):
    """One run, sample by sample."""

    geometry: str
    step: float  # s
    time: Vector  # s
    conserved: Vector  # vibration energy less the work of the torques, J
    vibration: Vector  # kinetic and elastic energy without the spin, J

    def drift(self, scale: float) -> Vector:
        """Change of the conserved energy relative to ``scale`` in J."""
        change: Vector = self.conserved - self.conserved[0]
        return change / scale


def contact_energy(p: Parameters, bearing: BearingParameters, depth: float) -> float:
    """Elastic energy of a Hertz contact pressed in by ``depth`` m, J."""
    if depth <= 0.0:
        return 0.0
    b, x = bearing.clearance, depth / bearing.clearance
    bracket = 0.25 * (2.0 * x - 3.0) * math.sqrt(x * (1.0 + x)) + 0.75 * math.asinh(math.sqrt(x))
    return hertz_factor(p, bearing.length) * b * b * bracket


def energies(p: Parameters, state: dict[str, Any], dte: float, half_backlash: float) -> tuple[float, float]:
    """(conserved, vibration) energy in J of a pair with balanced torques."""
    (x1, x2), (y1, y2), u = state["x"], state["y"], state["u"]
    (vx1, vx2), (vy1, vy2), (omega1, omega2) = state["vx"], state["vy"], state["omega"]
    gears, bearings = p.gears, p.bearings
    r1, r2 = base_radii(p)
    mass1, mass2 = gears.driving.inertia / r1**2, gears.driven.inertia / r2**2
    kinetic = 0.5 * mass1 * mass2 / (mass1 + mass2) * (r1 * omega1 - r2 * omega2) ** 2
    kinetic += 0.5 * gears.driving.mass * (vx1**2 + vy1**2) + 0.5 * gears.driven.mass * (vx2**2 + vy2**2)
    pressed = max(abs(dte) - half_backlash, 0.0)
    elastic = 0.5 * p.mesh.stiffness * pressed**2
    elastic += contact_energy(p, bearings.driving, math.hypot(x1, y1) - bearings.driving.clearance)
    elastic += contact_energy(p, bearings.driven, math.hypot(x2, y2) - bearings.driven.clearance)
    return kinetic + elastic - p.operation.drive_torque / r1 * u, kinetic + elastic


def trace(geometry: str, step: float) -> Trace:
    """Run the conservative pair for DURATION."""
    p = Parameters.from_flat({**CONSERVATIVE, "mesh_geometry": geometry, "solver.step": step})
    engine = Engine(p)
    rows = []
    for _ in range(round(DURATION / p.solver.sample_interval) + 1):
        state = engine.checkpoint().state
        sample = engine.advance(1)  # shows the state before its steps
        dte, half_backlash = float(sample["dte"][0]), float(sample["half_backlash"][0])
        rows.append((float(sample["time"][0]), *energies(p, state, dte, half_backlash)))
    time, conserved, vibration = np.array(rows).T
    return Trace(geometry, step, time, conserved, vibration)


def figure(traces: list[Trace], scale: float) -> Figure:
    """Drift on a linear axis, and its magnitude on a logarithmic one."""
    drawn = Figure(figsize=(7.4, 4.6), dpi=100, layout="constrained")
    linear, logarithmic = drawn.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.5])
    for each in traces:
        colour = COLOURS[each.geometry, each.step]
        name = f"{each.geometry} geometry, steps of {each.step * 1e6:g} µs"
        milliseconds, drift = 1e3 * each.time, each.drift(scale)
        if each.step == DEFAULT_STEP:
            linear.plot(milliseconds, 100.0 * drift, color=colour)
        logarithmic.semilogy(milliseconds[1:], np.abs(drift[1:]), color=colour, linewidth=0.9, label=name)
    linear.set_ylabel("drift (%)")
    logarithmic.set_ylabel("magnitude of drift (1)")
    logarithmic.set_xlabel("time (ms)")
    logarithmic.set_ylim(1e-16, 3.0)
    logarithmic.set_xlim(0.0, 1e3 * DURATION)
    logarithmic.legend(loc="lower right", ncols=2, frameon=False, fontsize=8.5)
    linear.set_title("Energy of the undamped pair, relative to its largest vibration energy", fontsize=10.5)
    for axes in (linear, logarithmic):
        axes.grid(color="#E3E3E3", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def save(drawn: Figure, output: Path) -> None:
    """Write a PNG of few colours: a third of the size, and the look is kept."""
    pixels = io.BytesIO()
    drawn.savefig(pixels, format="png")
    Image.open(pixels).convert("RGB").quantize(48).save(output, format="png", optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "energy_drift.png", metavar="PATH")
    output = parser.parse_args().output

    traces = [trace(geometry, step) for geometry, step in COLOURS]
    scale = max(float(each.vibration.max()) for each in traces if each.geometry == "exact")
    print(f"largest vibration energy, exact geometry: {scale:.4g} J")
    print("| geometry | step, us | largest drift | drift after 20 ms |")
    print("|---|---|---|---|")
    for each in traces:
        drift = each.drift(scale)
        largest, last = np.abs(drift).max(), drift[-1]
        print(f"| {each.geometry} | {each.step * 1e6:g} | {largest:.2g} | {last:+.2g} |")
    save(figure(traces, scale), output)
    print(f"drawn to {output}")


if __name__ == "__main__":
    main()
