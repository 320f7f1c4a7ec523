"""Energy balance and bearing impacts of a recording, collected message by message; SI units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import ENERGIES, GEARS, IMPACTS
from gear_dynamics_ros.parameters import Parameters

NAMES: Final = tuple(energy.name for energy in ENERGIES)
STORED: Final = ("kinetic_energy", "elastic_energy")
LOSSES: Final = ("mesh_loss", "driving_contact_loss", "driven_contact_loss")
# Of each entry in what the balance leaves over: stored + losses - works.
SHARES: Final = np.array([1.0 if name in STORED + LOSSES else -1.0 for name in NAMES])
RESIDUALS: Final = {
    "exact": "error of integration",
    "published": "work from no source that the published mesh force does, and error of integration: "
    "docs/model.md, Energy ledger",
}
COLUMN: Final = {entry.name: i for i, entry in enumerate(IMPACTS)}
CSV_HEADER: Final = "begin,end,bearing,impact_speed,rebound_speed,restitution,peak_force"


class Ledger:
    """Adds up what the energies change by between the ends of chunks; a change across a reset is left out."""

    def __init__(self, resets: Sequence[int]) -> None:
        """``resets`` are the samples before which the run was reset."""
        self._resets = np.array(sorted(resets), dtype=np.int64)
        self._first: int | None = None
        self._last = 0
        self._latest = np.zeros(len(NAMES))
        self._changes = np.zeros(len(NAMES))
        self._exchanged = 0.0

    def add(self, sample: int, energies: NDArray[np.float64]) -> None:
        """``energies`` (9,), an entry of ENERGIES each, as they were when ``sample`` was about to be made."""
        if self._first is None:
            self._first = sample
        elif not self._reset_between(self._last, sample):
            change = energies - self._latest
            self._changes += change
            self._exchanged += float(np.abs(change[: -len(STORED)]).sum())
        self._last, self._latest = sample, energies

    def block(self, interval: float, parameters: Parameters) -> dict[str, Any] | None:
        """Changes in J over the recording and what they leave unexplained; None if nothing was recorded.

        ``exchanged`` adds up the sizes of all works and losses chunk by chunk, to hold the residual against.
        """
        if self._first is None:
            return None
        changes = dict(zip(NAMES, self._changes.tolist(), strict=True))
        return {
            "from": self._first * interval,
            "to": self._last * interval,
            **changes,
            "stored": sum(changes[name] for name in STORED),
            "exchanged": self._exchanged,
            "residual": float(SHARES @ self._changes),
            "residual_is": RESIDUALS[parameters.mesh_geometry],
        }

    def _reset_between(self, before: int, sample: int) -> bool:
        """Whether a reset came after the energies of ``before`` and ahead of those of ``sample``."""
        low, high = np.searchsorted(self._resets, (before, sample))
        return bool(low < high)


class Impacts:
    """Totals of the impacts of each bearing."""

    def __init__(self, minimum_speed: float) -> None:
        """Restitution counts above ``minimum_speed`` in m/s, below which damping is that of this speed."""
        self._minimum_speed = minimum_speed
        self._bearings = {gear: _Bearing() for gear in GEARS}

    def add(self, rows: NDArray[np.float64]) -> None:
        """More ``rows`` (n, 6), an entry of IMPACTS each."""
        for number, bearing in enumerate(self._bearings.values()):
            bearing.add(rows[rows[:, COLUMN["bearing"]] == number], self._minimum_speed)

    def block(self) -> dict[str, Any]:
        """Number, speeds in m/s, mean delivered restitution and greatest force in N, by bearing."""
        return {gear: bearing.block() for gear, bearing in self._bearings.items()}


class _Bearing:
    def __init__(self) -> None:
        self._count = self._counting = 0
        self._speeds = self._fastest = self._restitutions = self._peak = 0.0

    def add(self, rows: NDArray[np.float64], minimum_speed: float) -> None:
        if not len(rows):
            return
        speeds = rows[:, COLUMN["impact_speed"]]
        delivered = restitution(rows)[speeds > minimum_speed]
        self._count += len(rows)
        self._counting += len(delivered)
        self._speeds += float(speeds.sum())
        self._restitutions += float(delivered.sum())
        self._fastest = max(self._fastest, float(speeds.max()))
        self._peak = max(self._peak, float(rows[:, COLUMN["peak_force"]].max()))

    def block(self) -> dict[str, Any]:
        some = self._count > 0
        return {
            "count": self._count,
            "mean_impact_speed": self._speeds / self._count if some else None,
            "max_impact_speed": self._fastest if some else None,
            "mean_restitution": self._restitutions / self._counting if self._counting else None,
            "max_peak_force": self._peak if some else None,
        }


def restitution(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rebound over impact speed of IMPACTS ``rows`` (n, 6); NaN where a contact began without any speed."""
    impact, rebound = rows[:, COLUMN["impact_speed"]], rows[:, COLUMN["rebound_speed"]]
    ratio: NDArray[np.float64] = np.divide(
        rebound, impact, out=np.full(len(rows), np.nan), where=impact > 0.0
    )
    return ratio


def csv_lines(rows: NDArray[np.float64]) -> list[str]:
    """``rows`` (n, 6) of IMPACTS under CSV_HEADER, every number in full."""
    lines = []
    for row, ratio in zip(rows.tolist(), restitution(rows).tolist(), strict=True):
        begin, end, bearing, impact, rebound, peak = row
        lines.append(f"{begin!r},{end!r},{GEARS[int(bearing)]},{impact!r},{rebound!r},{ratio!r},{peak!r}\n")
    return lines
