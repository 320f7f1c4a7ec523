"""Energy that the bearing contacts dissipate: areas of the loops of force over penetration."""

from __future__ import annotations

from typing import Final

import numpy as np

from gear_dynamics_ros.analysis.summary import observed_mesh_frequency
from gear_dynamics_ros.channels import contact_channels
from gear_dynamics_ros.chunk import Samples

# Derivative of the sixth order at the middle of seven samples.
SIXTH_ORDER: Final = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
LEAST_SAMPLES: Final = 100


def has_loops(samples: Samples, gear: str) -> bool:
    """Whether penetration and contact force of ``gear``, one of GEARS, were recorded."""
    return samples.has(f"{gear}_penetration", *contact_channels(gear))


def loss_per_period(samples: Samples, gear: str) -> float | None:
    """Mean area in J of the loop of a mesh period: what the contact of ``gear``'s bearing dissipates.

    None if the mesh frequency isn't known, or the samples are too few. The area is too small by some per cent
    where the contact oscillates with fewer than about eight samples a period.
    """
    mesh = observed_mesh_frequency(samples)
    if mesh is None or len(samples) < LEAST_SAMPLES:
        return None
    change = np.convolve(samples[f"{gear}_penetration"], SIXTH_ORDER[::-1], mode="valid")
    margin = len(SIXTH_ORDER) // 2
    work = float(samples.contact_force(gear)[margin:-margin] @ change)
    return work / (abs(mesh) * len(change) * samples.interval)
