"""The numbers of a recording as one tree that JSON holds; SI units, null where a channel wasn't recorded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from gear_dynamics_ros.analysis.sections import mesh_frequency, poincare_points
from gear_dynamics_ros.analysis.spectra import SHORTEST, amplitude_spectrum, strongest_lines
from gear_dynamics_ros.analysis.statistics import Statistics, bearing_force_name, quantities
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import base_radii
from gear_dynamics_ros.samples import GEARS, Samples
from gear_dynamics_ros.signals import CHANNELS, ENERGIES

WINDOW: Final = 0.2  # s
SETTLING: Final = 0.1  # s after a change before which nothing counts as steady
LINES: Final = 8
UNITS: Final = {
    **{channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)},
    **{bearing_force_name(gear): "N" for gear in GEARS},
}


class Span(NamedTuple):
    """Simulated time from ``start`` to before ``end``, s."""

    start: float
    end: float


def steady_window(whole: Span, changes: Iterable[float], length: float = WINDOW) -> Span:
    """The latest ``length`` seconds in which nothing changes, nor did shortly before; else the last ones.

    ``changes`` are the times in s of commands and events; a change at the very start of ``whole`` is none.
    """
    inside = sorted(time for time in changes if whole.start < time < whole.end)
    ends = [*inside, whole.end]
    begins = [whole.start, *(time + SETTLING for time in inside)]
    for begin, end in reversed(list(zip(begins, ends, strict=True))):
        if end - begin >= length:
            return Span(end - length, end)
    return Span(max(whole.start, whole.end - length), whole.end)


def statistics_block(statistics: Statistics, span: Span, parameters: Parameters) -> dict[str, Any]:
    """Totals of a stretch.

    ``static_mesh_force`` is mean |load torque| / r_b2 (T_M/r_b for balanced constant torques), ``ldmf`` the
    greatest mesh force over it; ``mean_bearing_force`` is the mean magnitude of contact and film force.
    """
    totals, shares, load = statistics.totals, statistics.shares, statistics.mean_load_torque
    static = load / base_radii(parameters)[1] if load else None
    force = totals.get("mesh_force")
    penetrations = {gear: totals.get(f"{gear}_penetration") for gear in GEARS}
    forces = {gear: totals.get(bearing_force_name(gear)) for gear in GEARS}
    return {
        "from": span.start,
        "to": span.end,
        "samples": statistics.samples,
        "meshing_shares": shares._asdict() if shares else None,
        "static_mesh_force": static,
        "ldmf": force.maximum / static if force and static else None,
        "mean_bearing_force": {gear: total.mean if total else None for gear, total in forces.items()},
        "max_penetration": {gear: total.maximum if total else None for gear, total in penetrations.items()},
        "channels": {
            name: {"unit": UNITS[name], "min": t.minimum, "max": t.maximum, "mean": t.mean, "rms": t.rms}
            for name, t in totals.items()
            if name != "time"
        },
    }


def window_block(samples: Samples, parameters: Parameters) -> dict[str, Any]:
    """Totals, strongest lines of the DTE and its Poincaré section for one window held in memory."""
    statistics = Statistics()
    statistics.add(samples, quantities(samples))
    start = samples.first * samples.interval
    block = statistics_block(statistics, Span(start, start + len(samples) * samples.interval), parameters)
    frequency = mesh_rate(samples)
    return block | {
        "mesh_frequency": frequency,
        "dte_spectrum": spectrum_block(samples, frequency),
        "poincare": poincare_block(samples),
    }


def mesh_rate(samples: Samples) -> float | None:
    """Mean mesh frequency in Hz; None if the mesh phase wasn't recorded or the gears all but stand."""
    if not samples.has("mesh_phase") or len(samples) < 2:
        return None
    frequency = mesh_frequency(samples["mesh_phase"], samples.interval)
    return frequency if abs(frequency) * len(samples) * samples.interval >= 1.0 else None


def spectrum_block(samples: Samples, mesh: float | None) -> dict[str, Any] | None:
    """The strongest lines, with their order of the mesh frequency ``mesh``."""
    if not samples.has("dte") or len(samples) < SHORTEST:
        return None
    spectrum = amplitude_spectrum(samples["dte"], samples.interval)
    return {
        "resolution": spectrum.resolution,
        "lines": [
            line._asdict() | {"order": line.frequency / abs(mesh) if mesh else None}
            for line in strongest_lines(spectrum, LINES)
        ],
    }


def poincare_block(samples: Samples) -> dict[str, Any] | None:
    """How far the section at mesh phase 0 spreads: 0 for a motion that repeats with the mesh."""
    if not samples.has("dte", "dte_rate", "mesh_phase"):
        return None
    points = section(samples)
    if not len(points):
        return None
    spread = np.ptp(points, axis=0)
    return {"points": len(points), "dte_spread": float(spread[0]), "dte_rate_spread": float(spread[1])}


def section(samples: Samples) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """DTE and its rate where the mesh phase wraps, m and m/s, shape (points, 2)."""
    motion = np.column_stack([samples["dte"], samples["dte_rate"]])
    return poincare_points(samples["mesh_phase"], motion)


def changes(sample_numbers: Sequence[int], interval: float) -> list[float]:
    """Times in s of samples, each once, in order."""
    return [number * interval for number in sorted(set(sample_numbers))]
