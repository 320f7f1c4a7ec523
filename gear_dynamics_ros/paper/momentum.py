"""Why a bearing without a film carries T_M / r_b at least: the balance of momentum at 16500 rpm.

The centres do not drift, so that the mean over time of the force of bearing and film on a gear is opposite to
the mean of the mesh force on it. The mean mesh force is T_M / r_b, because the speed does not drift either.
And no mean of magnitudes is less than the magnitude of the mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from gear_dynamics_ros.paper.cases import MODELS
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS
from gear_dynamics_ros.paper.results import PaperResults
from gear_dynamics_ros.paper.waveforms import mean_force

ROUNDING: Final = 1e-3  # of the limit: what the mean over a finite time may miss


class MomentumBalance(NamedTuple):
    """Forces on the driving gear of one model at 16500 rpm, N."""

    model: str
    limit: float  # T_M / r_b
    mesh_force: float  # mean
    vector: float  # magnitude of the mean of contact and film force; NaN if the run ended
    contact_force: float  # mean magnitude
    bearing_force: float  # mean magnitude of contact and film together
    printed: float  # the paper's mean bearing force

    @property
    def possible(self) -> bool:
        """Whether a bearing can have the printed mean force; with a film the contact may carry less."""
        return self.model == "improved" or self.printed >= self.limit * (1.0 - ROUNDING)


def momentum_balances(results: PaperResults) -> list[MomentumBalance]:
    """The balance of each model."""
    printed = _printed_forces()
    return [_balance(results, model, printed[model]) for model in MODELS]


def _printed_forces() -> Mapping[str, float]:
    by_id = {number.id: number.printed for number in PRINTED_NUMBERS}
    return {model: by_id[f"6-3/{model}"] for model in MODELS}


def _balance(results: PaperResults, model: str, printed: float) -> MomentumBalance:
    name = f"{model} at 16500 rpm"
    scalars, samples = results.at(name).point.scalars, results.waveforms.get(name)
    return MomentumBalance(
        model,
        results.static_force,
        scalars["mesh_force_mean"],
        math.nan if samples is None else math.hypot(*mean_force(samples, "driving")),
        scalars["driving_contact_force_mean"],
        scalars["driving_bearing_force_mean"],
        printed,
    )
