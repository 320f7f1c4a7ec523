"""Where the energy of a run came from and where it went: two lists with the same sum."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.analysis.ledger import LOSSES, STORED

WORKS: Final = ("shaft_work", "excitation_work", "driving_film_work", "driven_film_work")
RESIDUAL: Final = "residual"


class EnergyFlow(NamedTuple):
    """Energies in J by their name in the balance, all > 0; both sides have the sum ``total``."""

    put_in: Mapping[str, float]
    went_to: Mapping[str, float]

    @property
    def total(self) -> float:
        """Energy put in, J."""
        return math.fsum(self.put_in.values())

    def to_json(self) -> dict[str, Any]:
        """Both sides and their sum."""
        return {"put_in": dict(self.put_in), "went_to": dict(self.went_to), "total": self.total}


def energy_flow(balance: Mapping[str, Any]) -> EnergyFlow:
    """The two sides of a ``balance`` as from ``EnergyLedger.to_json``.

    Works > 0, falls of stored energies and a residual > 0 put energy in; works < 0, losses, rises of stored
    energies and a residual < 0 take it out. An entry of 0 is on neither side.
    """
    signed = {name: float(balance[name]) for name in (*WORKS, RESIDUAL)}
    signed.update({name: -float(balance[name]) for name in (*LOSSES, *STORED)})
    return EnergyFlow(
        {name: energy for name, energy in signed.items() if energy > 0.0},
        {name: -energy for name, energy in signed.items() if energy < 0.0},
    )
