"""Find the clearance of both bearings from a recording.

Without ``--recording`` it first makes one, as a stand-in for a test rig: a gearbox whose clearance is another
one, with noise of the sensors on the displacements of the shafts.

    python examples/identify_clearance.py --output clearance
    python examples/identify_clearance.py --recording BAG --output clearance
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gear_dynamics_ros import recording
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.identification.fit import request_of, run_fit
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Problem
from gear_dynamics_ros.identification.recorded_motion import (
    MotionObjective,
    parameters_as_recorded,
    read_motion,
)
from gear_dynamics_ros.identification.report import fit_text, write_fit
from gear_dynamics_ros.identification.search import SearchSettings
from gear_dynamics_ros.identification.unknowns import read_unknowns
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.recording.offline import simulate_to_recording
from gear_dynamics_ros.simulation.engine import Engine

CLEARANCE = 31.0e-6  # m, of the stand-in; the default parameters have 27 um
NOISE = 0.05e-6  # m, standard deviation of each sample
DISPLACEMENTS = ["driving_x", "driving_y", "driven_x", "driven_y"]


class Rig(Engine):
    """The gearbox of the stand-in: its sensors see the displacements with noise."""

    def advance(self, samples=None):
        chunk = super().advance(samples)
        rows = chunk.samples.copy()
        noise = np.random.default_rng(chunk.first_sample).normal(0.0, NOISE, (len(rows), len(DISPLACEMENTS)))
        rows[:, [COLUMN[name] for name in DISPLACEMENTS]] += noise
        return replace(chunk, samples=rows)


def record_rig(path):
    parameters = {f"bearings.{gear}.clearance": CLEARANCE for gear in ("driving", "driven")}
    rig = Rig(updated(Parameters(), parameters))
    simulate_to_recording(rig, path, 0.02, lambda samples: None, lambda: "")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recording", type=Path, metavar="BAG")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    arguments = parser.parse_args()
    if arguments.recording is None:
        arguments.recording = arguments.output.with_name(f"{arguments.output.name}_recording")
        record_rig(arguments.recording)

    # The data: the first 20 periods of the mesh, 1.94 ms at 15500 rpm. The longer the window, the smaller the
    # errors, until the trajectories of a chaotic motion part.
    motion = read_motion(recording.open(arguments.recording), DISPLACEMENTS, end=0.00194)
    # Where the search starts, and everything that is not varied.
    base = parameters_as_recorded(Parameters(), motion)
    unknowns = read_unknowns(["bearings.*.clearance=20e-6:40e-6", "oil.viscosity=0.01:0.05"], base)
    problem = Problem(base, unknowns, MotionObjective(motion, base))

    settings = SearchSettings(generations=15, population=10, seed=1)
    journal = FitJournal.create(arguments.output, request_of(problem, settings))
    fit = run_fit(problem, settings, journal, workers=2)
    write_fit(fit, arguments.output, f"recording {arguments.recording}")
    print(fit_text(fit, f"recording {arguments.recording}"))


if __name__ == "__main__":
    main()
