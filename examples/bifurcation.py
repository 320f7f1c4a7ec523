"""Bifurcations of your own gear pair over speed: where its vibration is periodic, and where chaotic.

    python examples/bifurcation.py OUTPUT_FOLDER

Put your gears in place of PAIR; docs/parameters.md has all parameters. It writes the dataset and the figures.
"""

import sys
from pathlib import Path

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.sweeps import Measurement, SweepPlan, parse_axis, run
from gear_dynamics_ros.sweeps.pictures import draw_figures

PAIR = {
    "gears.module": 0.004,  # m
    "gears.driving.teeth": 25,
    "gears.driving.mass": 1.6,  # kg
    "gears.driving.inertia": 2.5e-3,  # kg m^2
    "gears.driven.teeth": 32,
    "gears.driven.mass": 2.6,
    "gears.driven.inertia": 6.0e-3,
    "mesh.stiffness": 4.0e8,  # N/m
    "mesh.error_cos": [6.0e-6],  # m, static transmission error at mesh frequency
    "operation.drive_torque": 60.0,  # N m
    "operation.load_torque": 60.0 * 32 / 25,
    "mesh_phase": "nominal",
}
PERIODS = Measurement(transient=1000, keep=400)
SPEEDS = "operation.speed=1000:9000:81rpm"


def main(folder: Path, speeds: str = SPEEDS, periods: Measurement = PERIODS) -> None:
    plan = SweepPlan(Parameters.from_flat(PAIR), (parse_axis(speeds),), ("compared", "improved"), periods)
    dataset = run(plan)
    folder.mkdir(parents=True, exist_ok=True)
    dataset.to_netcdf(folder / "sweep.nc")
    for path in draw_figures(dataset, folder):
        print(path)
    for model in plan.models:
        chaotic = int((dataset["regime"].sel(model=model) == 2).sum())
        print(f"{model}: chaotic at {chaotic} of {dataset.sizes['operation.speed']} speeds")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
