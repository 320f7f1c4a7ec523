"""Results as the source paper describes them, and their opposite, without running anything."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gear_dynamics_ros.analysis.chaos import Regime
from gear_dynamics_ros.channels import CHANNEL_NAMES
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.paper.cases import (
    NAMED_CASES,
    WAVEFORM_CASES,
    Case,
    Effort,
    ParameterSet,
    needed_cases,
)
from gear_dynamics_ros.paper.results import CaseResult, PaperResults
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.sweeps.point import (
    DONE,
    REGIMES,
    SCALARS,
    Measurement,
    PointResult,
    spectrum_orders,
)
from support.paths import ROOT

EFFORT = Effort("world", 500, 0.1, Measurement(transient=10, keep=100))
# First and last chaotic speed, rpm; length of the range of DTE, um; LDMF.
OF_MODEL = {
    "traditional": (5340.0, 9000.0, 15.0, 5.0),
    "compared": (3575.0, 12000.0, 40.0, 8.0),
    "improved": (5725.0, 10000.0, 25.0, 6.0),
}
OPPOSITE_MODEL = {"traditional": "compared", "compared": "traditional", "improved": "improved"}


def as_printed(case: Case) -> Case:
    """The case itself."""
    return case


def opposite(case: Case) -> Case:
    """A case whose results contradict the paper's claims about ``case``."""
    return case._replace(
        model=OPPOSITE_MODEL[case.model],
        restitution=None if case.restitution is None else round(1.2 - case.restitution, 6),
        roughness=None if case.roughness is None else 2.56e-12 / case.roughness,
        fractal_dimension=None if case.fractal_dimension is None else 3.0 - case.fractal_dimension,
    )


def world(of: Callable[[Case], Case] = as_printed) -> PaperResults:
    """Results in which each case gives what the paper says of the case that ``of`` makes of it."""
    parameters = load_parameters(ROOT / "config" / "paper.yaml")
    cases = {case: CaseResult(case, _point(of(case))) for case in needed_cases(EFFORT)}
    waveforms = {name: _waveform(of(NAMED_CASES[name])) for name in WAVEFORM_CASES}
    return PaperResults(
        ParameterSet("world", "world", parameters, {}),
        EFFORT,
        cases,
        waveforms,
    )


def _regime(case: Case) -> Regime:
    if case.section == "3.1":
        first, last, *_ = OF_MODEL[case.model]
        return "chaotic" if first <= case.speed <= last else "periodic"
    if case.section == "3.2":
        return "chaotic" if case.model == "compared" else "periodic"
    return "chaotic" if (case.roughness or 0.0) > 3e-6 else "periodic"


def _point(case: Case) -> PointResult:
    eta, length = case.restitution or 0.0, _dte_length(case)
    shares = _shares(case)
    least, largest, mean = _penetration(case)
    force = 1000.0 - 100.0 * abs(eta - 0.08)
    scalars = dict.fromkeys(SCALARS, 0.0) | {
        "regime": float(REGIMES.index(_regime(case))),
        "drive_share": shares[0],
        "apart_share": 1.0 - sum(shares),
        "back_share": shares[1],
        "ldmf": OF_MODEL[case.model][3],
        "dte_min": 20e-6,
        "dte_max": 20e-6 + length,
        "section_spread": 20e-6 if _regime(case) == "chaotic" else length / 10.0,
        "driving_penetration_min": least,
        "driving_penetration_max": largest,
        "driving_penetration_mean": mean,
        "driving_contact_force_min": 0.0 if eta < 0.5 else 1.0,
        "driving_contact_force_max": force,
        "driving_contact_force_mean": force / 2.0,
    }
    if case.section == "3.4":
        scalars["section_spread"] = 1e-6 * (case.fractal_dimension or 1.0)
    orders = spectrum_orders(EFFORT.measurement.keep)
    spectrum = np.where(orders < 1.0, length / 10.0, 0.0)
    if case.section == "3.2":
        spectrum *= {"traditional": 0.1, "compared": 1.0, "improved": 0.2}[case.model]
    section = np.full(EFFORT.measurement.keep, 20e-6)
    arrays = {"section_dte": section, "section_dte_rate": 0.0 * section, "dte_spectrum": spectrum}
    return PointResult(scalars, arrays, DONE)


def _dte_length(case: Case) -> float:
    """Length of the range of DTE, m."""
    if case.section == "3.3":
        return 1e-6 * (20.0 + 10.0 * (case.restitution or 0.0))
    if case.section == "3.4":
        rough = 1e6 * (case.roughness or 0.0)
        return 1e-6 * (20.0 + rough - 0.1 * (case.fractal_dimension or 0.0))
    return 1e-6 * OF_MODEL[case.model][2]


def _shares(case: Case) -> tuple[float, float]:
    """On the drive flank and on the back flank."""
    odd = round(case.speed / EFFORT.speed_step) % 2
    if case.model == "traditional":
        return 0.9, 2.66e-4 if case.speed == 8740.0 else 0.0
    if case.model == "compared":
        return 0.5 + 0.2 * odd, 0.016718 if 5350.0 <= case.speed <= 12000.0 else 0.0
    return 0.5 + 0.1 * odd, 0.007406 if case.speed == 6750.0 else 0.0


def _penetration(case: Case) -> tuple[float, float, float]:
    """Least, largest and mean, m; a negative least one is a gap."""
    return {
        "traditional": (4.3875e-6, 6.0145e-6, 5.2e-6),
        "compared": (-1e-6, 2.3108e-6, 1.2e-6),
        "improved": (-2e-6, 1.7165e-6, 1.1e-6),
    }[case.model]


def _waveform(case: Case) -> Samples:
    """Twenty mesh periods: a force loop whose width falls with the restitution, and a pressure angle that
    differs from period to period with the roughness."""
    turns = np.arange(2000) / 100.0 + 0.005
    eta, rough = case.restitution or 0.0, case.roughness or 0.0
    values = np.zeros((len(turns), len(CHANNEL_NAMES)))

    def put(name: str, column: np.ndarray) -> None:
        values[:, CHANNEL_NAMES.index(name)] = column

    phase = 2.0 * math.pi * turns
    put("mesh_phase", np.mod(phase, 2.0 * math.pi))
    put("driving_penetration", 1e-6 * np.sin(phase))
    put("driving_contact_force_x", 500.0 + 100.0 * np.sin(phase) + 50.0 * (1.0 - eta) * np.cos(phase))
    put("pressure_angle", 0.35 + rough * np.sin(0.3 * phase))
    return Samples(0, 1e-6, CHANNEL_NAMES, values)
