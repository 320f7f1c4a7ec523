"""Hysteresis of lost contact: sweep the speed up, and down again, carrying the vibration on.

    python examples/hysteresis.py OUTPUT_FOLDER

Below its resonance a pair with backlash can vibrate in two ways at the same speed: teeth in contact all the
time, or lost contact in every mesh period. Which one depends on where it comes from.
"""

import sys
from math import pi
from pathlib import Path

import numpy as np

from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.sweeps import Measurement, SweepPlan, parse_axis, run
from gear_dynamics_ros.sweeps.pictures import draw_figures

GEARBOX = Path(__file__).parent.parent / "config" / "gearbox.yaml"
# Lightly damped, also between the teeth that are apart, and smooth: the two motions are far apart.
SETTINGS = [
    "operation.control=torque",
    "mesh_damping=always",
    "mesh.damping_ratio=0.03",
    "mesh.error_cos=[2e-6]",
    "surface.driving.roughness=1e-7",
    "surface.driven.roughness=1e-7",
]


def main(folder: Path, speeds: str = "operation.speed=5200:7400:45rpm") -> None:
    plan = SweepPlan(
        parameters=load_parameters(GEARBOX, SETTINGS),
        axes=(parse_axis(speeds),),
        models=("traditional",),
        measurement=Measurement(transient=150, keep=100),
        direction="both",
    )
    dataset = run(plan)
    folder.mkdir(parents=True, exist_ok=True)
    for path in draw_figures(dataset, folder):
        print(path)
    largest = dataset["dte_max"].sel(model="traditional")
    apart = largest.sel(direction="down") - largest.sel(direction="up")
    both = dataset["operation.speed"].values[np.asarray(apart) > 1e-6] * 30.0 / pi
    print(f"two motions from {both.min():.0f} to {both.max():.0f} rpm")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
