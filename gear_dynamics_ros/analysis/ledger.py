"""Energy balance and totals of the bearing impacts of a run, collected row by row; SI units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import ENERGIES, GEARS, IMPACTS
from gear_dynamics_ros.parameters import Parameters

ENERGY_NAMES: Final = tuple(energy.name for energy in ENERGIES)
STORED: Final = ("kinetic_energy", "elastic_energy")
LOSSES: Final = ("mesh_loss", "driving_contact_loss", "driven_contact_loss")
# Sign of each entry in the residual: stored energies + losses - works.
RESIDUAL_SIGNS: Final = np.array([1.0 if name in STORED + LOSSES else -1.0 for name in ENERGY_NAMES])
RESIDUALS: Final = {
    "exact": "error of integration",
    "published": "work from no source that the published mesh force does, and error of integration: "
    "docs/model.md, Energy ledger",
}
IMPACT_COLUMN: Final = {entry.name: i for i, entry in enumerate(IMPACTS)}
CSV_HEADER: Final = "begin,end,bearing,impact_speed,rebound_speed,restitution,peak_force"


class EnergyLedger:
    """Adds up the changes of the energies from chunk to chunk; a change across a reset is left out."""

    def __init__(self, resets: Sequence[int]) -> None:
        """``resets`` are the indices of the samples before which the run was reset, in any order."""
        self._resets = np.array(sorted(resets), dtype=np.int64)
        self._first: int | None = None
        self._last = 0
        self._latest = np.zeros(len(ENERGY_NAMES))
        self._changes = np.zeros(len(ENERGY_NAMES))
        self._exchanged = 0.0

    def add(self, sample: int, energies: NDArray[np.float64]) -> None:
        """Take in the energies before ``sample``: ``energies`` in J, shape (9,), one for each of ENERGIES."""
        if self._first is None:
            self._first = sample
        elif not self._reset_between(self._last, sample):
            change = energies - self._latest
            self._changes += change
            self._exchanged += float(np.abs(change[: -len(STORED)]).sum())
        self._last, self._latest = sample, energies

    def to_json(self, interval: float, parameters: Parameters) -> dict[str, Any] | None:
        """Changes in J from ``from`` to ``to`` s and their residual; None if nothing was added.

        ``interval`` is the sample interval in s. ``exchanged`` is the sum of the magnitudes of all works and
        losses, chunk by chunk: the scale to compare ``residual`` with.
        """
        if self._first is None:
            return None
        changes = dict(zip(ENERGY_NAMES, self._changes.tolist(), strict=True))
        return {
            "from": self._first * interval,
            "to": self._last * interval,
            **changes,
            "stored": sum(changes[name] for name in STORED),
            "exchanged": self._exchanged,
            "residual": float(RESIDUAL_SIGNS @ self._changes),
            "residual_is": RESIDUALS[parameters.mesh_geometry],
        }

    def _reset_between(self, before: int, sample: int) -> bool:
        """Whether a reset came after the energies of ``before`` and ahead of those of ``sample``."""
        low, high = np.searchsorted(self._resets, (before, sample))
        return bool(low < high)


class ImpactTotals:
    """Totals of the impacts of each bearing."""

    def __init__(self, minimum_speed: float) -> None:
        """Only impacts faster than ``minimum_speed`` (m/s) count for the mean restitution.

        Below it the model computes the contact damping with this speed.
        """
        self._minimum_speed = minimum_speed
        self._bearings = {gear: _BearingTotals() for gear in GEARS}

    def add(self, rows: NDArray[np.float64]) -> None:
        """Take in more impacts: ``rows`` has shape (n, 6), one column for each of IMPACTS."""
        for number, bearing in enumerate(self._bearings.values()):
            bearing.add(rows[rows[:, IMPACT_COLUMN["bearing"]] == number], self._minimum_speed)

    def to_json(self) -> dict[str, Any]:
        """Number of impacts, speeds in m/s, mean restitution and greatest force in N, by bearing."""
        return {gear: bearing.to_json() for gear, bearing in self._bearings.items()}


class _BearingTotals:
    def __init__(self) -> None:
        self._count = self._fast_count = 0
        self._speeds = self._fastest = self._restitutions = self._peak = 0.0

    def add(self, rows: NDArray[np.float64], minimum_speed: float) -> None:
        if not len(rows):
            return
        speeds = rows[:, IMPACT_COLUMN["impact_speed"]]
        ratios = restitution_ratios(rows)[speeds > minimum_speed]
        self._count += len(rows)
        self._fast_count += len(ratios)
        self._speeds += float(speeds.sum())
        self._restitutions += float(ratios.sum())
        self._fastest = max(self._fastest, float(speeds.max()))
        self._peak = max(self._peak, float(rows[:, IMPACT_COLUMN["peak_force"]].max()))

    def to_json(self) -> dict[str, Any]:
        some = self._count > 0
        return {
            "count": self._count,
            "mean_impact_speed": self._speeds / self._count if some else None,
            "max_impact_speed": self._fastest if some else None,
            "mean_restitution": self._restitutions / self._fast_count if self._fast_count else None,
            "max_peak_force": self._peak if some else None,
        }


def restitution_ratios(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rebound speed by impact speed, shape (n,), of ``rows`` (n, 6) of IMPACTS; NaN where the latter is 0."""
    impact, rebound = rows[:, IMPACT_COLUMN["impact_speed"]], rows[:, IMPACT_COLUMN["rebound_speed"]]
    ratio: NDArray[np.float64] = np.divide(
        rebound, impact, out=np.full(len(rows), np.nan), where=impact > 0.0
    )
    return ratio


def csv_lines(rows: NDArray[np.float64]) -> list[str]:
    """A line of CSV under CSV_HEADER for each of ``rows`` (n, 6) of IMPACTS, to be read back exactly."""
    lines = []
    for row, ratio in zip(rows.tolist(), restitution_ratios(rows).tolist(), strict=True):
        begin, end, bearing, impact, rebound, peak = row
        lines.append(f"{begin!r},{end!r},{GEARS[int(bearing)]},{impact!r},{rebound!r},{ratio!r},{peak!r}\n")
    return lines
