"""The runs that the paper's section 3 describes: single cases by name, and scans over one quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.parameters.changes import updated
from gear_dynamics_ros.sweeps.point import Measurement

RADIANS_PER_SECOND: Final = math.pi / 30.0  # in a revolution per minute
MODELS: Final = ("traditional", "compared", "improved")
SPEED_RANGE: Final = (2000, 18000)  # rpm, of figure 5
# Speeds that the text names, which a coarse grid could miss, rpm.
NAMED_SPEEDS: Final = (2000, 2520, 3575, 5340, 5350, 5725, 6250, 6750, 8740, 9940, 11640)
FILM_SPEED: Final = 16500.0  # rpm, of section 3.2
RESTITUTION_SPEED: Final = 15000.0  # rpm, of section 3.3
SURFACE_SPEED: Final = 15500.0  # rpm, of section 3.4
RESTITUTIONS: Final = (0.2, 0.6, 1.0)  # of figure 7
ROUGHNESSES: Final = (0.8e-6, 1.6e-6, 3.2e-6)  # m, of figure 9
DIMENSIONS: Final = (1.1, 1.5, 1.9)  # of figure 9
LEAST_RESTITUTION: Final = 0.05  # lower limit of the parameter
# Sections of the paper that name no restitution for the runs they describe.
SECTIONS_WITHOUT_RESTITUTION: Final = ("3.1", "3.2", "3.4")


class Case(NamedTuple):
    """One run: what the paper names of it. Where it names nothing, the parameter file stands."""

    section: str  # of the paper
    model: str
    speed: float  # rpm, as printed
    restitution: float | None = None
    roughness: float | None = None  # m
    fractal_dimension: float | None = None


@dataclass(frozen=True)
class ParameterSet:
    """Parameters under which all cases are run."""

    name: str
    title: str
    parameters: Parameters
    # By section of the paper; the parameter file's where a section is missing.
    restitution_by_section: Mapping[str, float]

    def of(self, case: Case) -> Parameters:
        """Parameters of ``case``."""
        values: dict[str, object] = {
            "model": case.model,
            "operation.speed": case.speed * RADIANS_PER_SECOND,
        }
        restitution = case.restitution
        if restitution is None:
            restitution = self.restitution_by_section.get(case.section)
        for gear in GEARS:
            if restitution is not None:
                values[f"bearings.{gear}.restitution"] = restitution
            if case.roughness is not None:
                values[f"surface.{gear}.roughness"] = case.roughness
            if case.fractal_dimension is not None:
                values[f"surface.{gear}.fractal_dimension"] = case.fractal_dimension
        return updated(self.parameters, values)


class Effort(NamedTuple):
    """How finely the scans are run, and for how long each case."""

    name: str
    speed_step: int  # rpm
    restitution_step: float
    measurement: Measurement


QUICK: Final = Effort("quick", 200, 0.05, Measurement(transient=600, keep=400))
FULL: Final = Effort("full", 20, 0.01, Measurement(transient=3000, keep=1000))

NAMED_CASES: Final[Mapping[str, Case]] = {
    **{f"{model} at {speed} rpm": Case("3.1", model, speed) for model in MODELS for speed in NAMED_SPEEDS},
    **{f"{model} at 16500 rpm": Case("3.2", model, FILM_SPEED) for model in MODELS},
    **{
        f"restitution {eta:g}": Case("3.3", "improved", RESTITUTION_SPEED, restitution=eta)
        for eta in RESTITUTIONS
    },
    **{
        f"roughness {1e6 * roughness:g} um": Case(
            "3.4", "improved", SURFACE_SPEED, None, roughness, DIMENSIONS[0]
        )
        for roughness in ROUGHNESSES
    },
    **{
        f"dimension {dimension:g}": Case("3.4", "improved", SURFACE_SPEED, None, ROUGHNESSES[0], dimension)
        for dimension in DIMENSIONS
    },
}
# Cases whose waveforms are drawn, or needed for a claim.
WAVEFORM_CASES: Final = tuple(
    name for name, case in NAMED_CASES.items() if case.section in ("3.2", "3.3", "3.4")
)
RESTITUTION_SCAN: Final = "restitution"
SCANS: Final = (*(f"{model} over speed" for model in MODELS), RESTITUTION_SCAN)


def speed_scan(model: str) -> str:
    """Name of the scan of ``model`` over speed."""
    return f"{model} over speed"


def scan_cases(name: str, effort: Effort) -> list[Case]:
    """The cases of the scan ``name``, one of SCANS, in ascending order."""
    if name == RESTITUTION_SCAN:
        return [
            Case("3.3", "improved", RESTITUTION_SPEED, restitution=eta)
            for eta in _restitutions(effort.restitution_step)
        ]
    model = name.split()[0]
    grid = range(SPEED_RANGE[0], SPEED_RANGE[1] + 1, effort.speed_step)
    return [Case("3.1", model, speed) for speed in sorted({*grid, *NAMED_SPEEDS})]


def _restitutions(step: float) -> Sequence[float]:
    count = round(1.0 / step)
    grid = {round(number * step, 6) for number in range(1, count + 1)}
    return sorted({eta for eta in grid if eta >= LEAST_RESTITUTION} | set(RESTITUTIONS) | {0.08})


def needed_cases(effort: Effort) -> list[Case]:
    """Every case that a named case or a scan asks for, once."""
    scans = (case for name in SCANS for case in scan_cases(name, effort))
    return list(dict.fromkeys([*NAMED_CASES.values(), *scans]))
