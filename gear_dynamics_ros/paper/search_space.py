"""What the source paper leaves open, within reason, and how far a set of it is from what the paper says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.objective import Outcome
from gear_dynamics_ros.identification.unknowns import Unknown, read_unknowns, trial_parameters
from gear_dynamics_ros.paper.cases import SECTIONS_WITHOUT_RESTITUTION, Effort, ParameterSet
from gear_dynamics_ros.paper.claims import CLAIMS, ClaimCheck
from gear_dynamics_ros.paper.parameter_sets import one_set, set_by_section
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS, Comparability
from gear_dynamics_ros.paper.results import run_cases
from gear_dynamics_ros.paper.verdicts import AGREEMENT, ComparedNumber, compare
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.sweeps.point import Measurement, measure

# Bounds in SI units. Table 1 of the paper fixes the rest.
OPEN_PARAMETERS: Final = (
    "mesh.error_cos[0]=7e-6:12e-6",
    "mesh.error_cos[1]=-1.5e-6:1.5e-6",
    "mesh.error_cos[2]=-1e-6:1e-6",
    "mesh.error_sin[1]=-1.5e-6:1.5e-6",
    "mesh.error_sin[2]=-1e-6:1e-6",
    "mesh.stiffness_cos[0]=-0.2:0.2",
    "mesh.stiffness_cos[1]=-0.12:0.12",
    "mesh.stiffness_sin[0]=-0.2:0.2",
    "mesh.stiffness_sin[1]=-0.12:0.12",
    "bearings.*.clearance=10e-6:45e-6",
    "bearings.*.length=8e-3:25e-3",
    "bearings.*.diameter=30e-3:65e-3",
    "bearings.*.oil_clearance=60e-6:250e-6",
    "bearings.minimum_impact_speed=1e-4:60e-3",
    "bearings.*.kelvin_stiffness=0.7e8:1.4e8",
    "bearings.*.kelvin_damping=500:3000",
    "surface.scale=1.15:2.0",
    "surface.driving.offset=0:6.283185307179586",
    "surface.driven.offset=0:6.283185307179586",
)
RESTITUTION: Final = "bearings.*.restitution=0.15:1.0"
# No exponents: the 0-1 test alone tells what is chaotic. They would take as long as everything else.
SEARCHED: Final = Effort("search", 400, 0.05, Measurement(transient=200, keep=110, exponent_intervals=0))
COMPARABLE: Final = tuple(number.id for number in PRINTED_NUMBERS if number.comparable is Comparability.YES)
# What is missing of a number that hardly differs, or of a claim of which hardly anything does not hold.
LEAST_MISSING: Final = 0.3
FAR: Final = 0.6  # relative difference beyond AGREEMENT from which on a number is missing wholly


@dataclass(frozen=True)
class PaperSearchSpace:
    """Sets of what the paper leaves open: points between 0 and 1, a coordinate for each unknown.

    ``sections`` are those whose restitution is an unknown of its own; without them all have one.
    """

    base: Parameters
    unknowns: tuple[Unknown, ...]
    sections: tuple[str, ...]
    start: NDArray[np.float64]  # (n,), the coordinates of the set that is known
    effort: Effort = SEARCHED

    def parameter_set(self, coordinates: NDArray[np.float64]) -> ParameterSet:
        """The set at ``coordinates`` (n,). Raises UsageError if its values do not suit each other."""
        own = len(self.sections)
        count = len(self.unknowns) - own
        parameters = trial_parameters(self.base, self.unknowns[:count], coordinates[:count])
        by_section = {
            section: unknown.value(float(coordinate))
            for section, unknown, coordinate in zip(
                self.sections, self.unknowns[count:], coordinates[count:], strict=True
            )
        }
        return ParameterSet("trial", "trial", parameters, by_section)

    def outcome(self, coordinates: NDArray[np.float64]) -> Outcome:
        """Residuals at ``coordinates``: of COMPARABLE, then of CLAIMS; 0 where agreed, for any thread.

        Half the sum of their squares counts what is missing, 1 for each number or claim at most.
        """
        results = run_cases(self.parameter_set(coordinates), self.effort, measure, 1, lambda: None)
        comparison = compare(results)
        numbers = {found.number.id: found for found in comparison.numbers}
        missing = [_missing_of_number(numbers[name]) for name in COMPARABLE]
        missing += [_missing_of_claim(claim.checks(results)) for claim in CLAIMS]
        return Outcome(np.sqrt(2.0 * np.array(missing)), "")


def one_restitution(parameters: Parameters) -> PaperSearchSpace:
    """All sections that name no restitution have the same; it starts with ``one_set``."""
    base = one_set(parameters).parameters
    unknowns = read_unknowns([*OPEN_PARAMETERS, RESTITUTION], base)
    return PaperSearchSpace(base, unknowns, (), _coordinates(unknowns, base))


def own_restitutions(parameters: Parameters) -> PaperSearchSpace:
    """Each section that names no restitution has its own; it starts with ``set_by_section``."""
    known = set_by_section(parameters)
    unknowns = read_unknowns(OPEN_PARAMETERS, known.parameters)
    (restitution,) = read_unknowns([RESTITUTION], known.parameters)
    sections = SECTIONS_WITHOUT_RESTITUTION
    start = [restitution.coordinate(known.restitution_by_section[section]) for section in sections]
    return PaperSearchSpace(
        known.parameters,
        (*unknowns, *(restitution for _ in sections)),
        sections,
        np.array([*_coordinates(unknowns, known.parameters), *start]),
    )


def _coordinates(unknowns: Sequence[Unknown], parameters: Parameters) -> NDArray[np.float64]:
    return np.array([unknown.start(parameters) for unknown in unknowns])


def _missing_of_number(found: ComparedNumber) -> float:
    if found.relative is None:
        return 1.0
    beyond = abs(found.relative) - AGREEMENT
    return 0.0 if beyond <= 0.0 else min(1.0, LEAST_MISSING + (1.0 - LEAST_MISSING) * beyond / FAR)


def _missing_of_claim(checks: Sequence[ClaimCheck]) -> float:
    failed = float(np.mean([not check.passed for check in checks]))
    return 0.0 if failed == 0.0 else LEAST_MISSING + (1.0 - LEAST_MISSING) * failed
