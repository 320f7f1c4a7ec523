"""The numbers of a run as mappings for JSON; SI units, None where a channel wasn't recorded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from gear_dynamics_ros.analysis.sections import mesh_frequency, poincare_points
from gear_dynamics_ros.analysis.spectra import MIN_SAMPLES, amplitude_spectrum, strongest_lines
from gear_dynamics_ros.analysis.statistics import Statistics, bearing_force_name, derived_quantities
from gear_dynamics_ros.channels import CHANNELS, ENERGIES, GEARS
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii

WINDOW_LENGTH: Final = 0.2  # s
SETTLING_TIME: Final = 0.1  # s after a change that do not count as steady
LINE_COUNT: Final = 8
QUANTITY_UNITS: Final = {
    **{channel.name: channel.unit for channel in (*CHANNELS, *ENERGIES)},
    **{bearing_force_name(gear): "N" for gear in GEARS},
}


class TimeSpan(NamedTuple):
    """Simulated times with start <= time < end, in s."""

    start: float
    end: float


def steady_window(whole: TimeSpan, changes: Iterable[float], length: float = WINDOW_LENGTH) -> TimeSpan:
    """The latest of ``steady_windows``; the last ``length`` s of ``whole`` if there are none."""
    found = steady_windows(whole, changes, length)
    return found[-1] if found else TimeSpan(max(whole.start, whole.end - length), whole.end)


def steady_windows(
    whole: TimeSpan, changes: Iterable[float], length: float = WINDOW_LENGTH
) -> list[TimeSpan]:
    """The last ``length`` s of each time without a change in them or in the SETTLING_TIME before them.

    ``changes`` are the times in s of commands and events; one at the start of ``whole`` does not count. The
    windows come in the order of time.
    """
    inside = sorted(time for time in changes if whole.start < time < whole.end)
    ends = [*inside, whole.end]
    begins = [whole.start, *(time + SETTLING_TIME for time in inside)]
    return [
        TimeSpan(end - length, end) for begin, end in zip(begins, ends, strict=True) if end - begin >= length
    ]


def summarize_statistics(statistics: Statistics, span: TimeSpan, parameters: Parameters) -> dict[str, Any]:
    """Totals of the samples in ``span``.

    ``static_mesh_force`` is mean |load torque| / r_b2 (T_M/r_b for balanced constant torques), ``ldmf`` the
    greatest mesh force divided by it; ``mean_bearing_force`` is the mean of |contact force + film force|.
    """
    totals, shares, load = statistics.totals(), statistics.meshing_shares(), statistics.mean_load_torque()
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
            name: {
                "unit": QUANTITY_UNITS[name],
                "min": total.minimum,
                "max": total.maximum,
                "mean": total.mean,
                "rms": total.rms,
            }
            for name, total in totals.items()
            if name != "time"
        },
    }


def summarize_window(samples: Samples, parameters: Parameters) -> dict[str, Any]:
    """Totals, the strongest lines of the DTE and the spread of its Poincaré section in one window."""
    statistics = Statistics()
    statistics.add(samples, derived_quantities(samples))
    start = samples.first * samples.interval
    totals = summarize_statistics(
        statistics, TimeSpan(start, start + len(samples) * samples.interval), parameters
    )
    frequency = observed_mesh_frequency(samples)
    return totals | {
        "mesh_frequency": frequency,
        "dte_spectrum": summarize_spectrum(samples, frequency),
        "poincare": summarize_poincare(samples),
    }


def observed_mesh_frequency(samples: Samples) -> float | None:
    """Mean mesh frequency in Hz; None if the mesh phase wasn't recorded or passes less than one period."""
    if not samples.has("mesh_phase") or len(samples) < 2:
        return None
    frequency = mesh_frequency(samples["mesh_phase"], samples.interval)
    return frequency if abs(frequency) * len(samples) * samples.interval >= 1.0 else None


def summarize_spectrum(samples: Samples, mesh: float | None) -> dict[str, Any] | None:
    """The strongest lines of the DTE, with their order of the mesh frequency ``mesh`` (Hz)."""
    if not samples.has("dte") or len(samples) < MIN_SAMPLES:
        return None
    spectrum = amplitude_spectrum(samples["dte"], samples.interval)
    return {
        "resolution": spectrum.resolution,
        "lines": [
            line._asdict() | {"order": line.frequency / abs(mesh) if mesh else None}
            for line in strongest_lines(spectrum, LINE_COUNT)
        ],
    }


def summarize_poincare(samples: Samples) -> dict[str, Any] | None:
    """Spread of the Poincaré section at mesh phase 0; 0 for a motion of the mesh period."""
    if not samples.has("dte", "dte_rate", "mesh_phase"):
        return None
    points = poincare_section(samples)
    if not len(points):
        return None
    spread = np.ptp(points, axis=0)
    return {"points": len(points), "dte_spread": float(spread[0]), "dte_rate_spread": float(spread[1])}


def poincare_section(samples: Samples) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """DTE in m and its rate in m/s where the mesh phase wraps, shape (points, 2)."""
    motion = np.column_stack([samples["dte"], samples["dte_rate"]])
    return poincare_points(samples["mesh_phase"], motion)


def distinct_times(samples: Sequence[int], interval: float) -> list[float]:
    """Times in s of the sample indices ``samples``, each once, in ascending order."""
    return [sample * interval for sample in sorted(set(samples))]
