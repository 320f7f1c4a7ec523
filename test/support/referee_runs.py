"""Runs that engine and referee both make, and how far apart they are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import Parameters
from support.measurements import PUBLISHED
from support.referee import CHANNELS

SAMPLES = 101  # the first millisecond
NANOMETRE = 1e-9
ANGLES = ("driving_angle", "mesh_phase")

ROUGH: dict[str, Any] = {
    "operation.control": "torque",
    "operation.speed": 1000.0,
    "mesh.stiffness_cos": [0.12],
    "mesh.error_cos": [1.0e-5],
    "bearings.driving.clearance": 3.6e-5,
    "bearings.driven.clearance": 3.6e-5,
}
UNEQUAL: dict[str, Any] = {
    "gears.driving.teeth": 23,
    "gears.driven.teeth": 41,
    "gears.driving.mass": 0.6,
    "gears.driven.mass": 1.9,
    "gears.driving.inertia": 4.0e-4,
    "gears.driven.inertia": 4.1e-3,
    "operation.drive_torque": 20.0,
    "operation.load_torque": 20.0 * 41 / 23,
    "mesh.stiffness_cos": [0.1, 0.03],
    "mesh.stiffness_sin": [0.02, 0.0, 0.01],
    "mesh.error_mean": 2.0e-6,
    "mesh.error_cos": [6.0e-6, 0.0, 1.0e-6],
    "mesh.error_sin": [2.0e-6, 1.5e-6],
    "surface.driven.offset": 0.7,
    "surface.driving.roughness": 1.6e-6,
}
LOPSIDED: dict[str, Any] = {
    "bearings.driving.clearance": 1.5e-5,
    "bearings.driving.restitution": 0.7,
    "bearings.driving.length": 0.02,
    "bearings.driven.oil_clearance": 1.0e-4,
    "bearings.driven.kelvin_stiffness": 3.0e8,
    "bearings.driven.kelvin_damping": 800.0,
    "bearings.driven.restitution": 0.35,
}
BACK: dict[str, Any] = {"operation.drive_torque": -40.0, "operation.load_torque": -40.0}
# The default gearbox at speeds where the surface's highest waves last three steps of 2 us and fewer.
FAST: dict[str, Any] = {name: Parameters.from_flat({}).to_flat()[name] for name in ROUGH}
FAST |= {"operation.control": "torque", "operation.speed": 15500.0 * math.pi / 30.0}
FASTER: dict[str, Any] = {**FAST, "operation.speed": 18000.0 * math.pi / 30.0}
RUNS: dict[str, dict[str, Any]] = {
    "traditional, refined, 15500 rpm": {"model": "traditional", **FAST},
    "compared, refined, 15500 rpm": {"model": "compared", **FAST},
    "improved, refined, 15500 rpm": {"model": "improved", **FAST},
    "traditional, refined, 18000 rpm": {"model": "traditional", **FASTER},
    "compared, refined, 18000 rpm": {"model": "compared", **FASTER},
    "improved, refined, 18000 rpm": {"model": "improved", **FASTER},
    "traditional, published, 15500 rpm": {"model": "traditional", **PUBLISHED, **FAST},
    "compared, published, 15500 rpm": {"model": "compared", **PUBLISHED, **FAST},
    "improved, published, 15500 rpm": {"model": "improved", **PUBLISHED, **FAST},
    "traditional, published, 18000 rpm": {"model": "traditional", **PUBLISHED, **FASTER},
    "compared, published, 18000 rpm": {"model": "compared", **PUBLISHED, **FASTER},
    "improved, published, 18000 rpm": {"model": "improved", **PUBLISHED, **FASTER},
    "improved, back flank, unbalanced": {
        "model": "improved",
        "operation.drive_torque": -30.0,
        "operation.load_torque": -20.0,
    },
    "traditional, published": {"model": "traditional", **PUBLISHED},
    "compared, published": {"model": "compared", **PUBLISHED},
    "improved, published": {"model": "improved", **PUBLISHED},
    "compared, always damped": {"model": "compared", "mesh_damping": "always"},
    "improved, always damped, nominal phase": {
        "model": "improved",
        "mesh_damping": "always",
        "mesh_phase": "nominal",
    },
    "improved, published geometry": {"model": "improved", "mesh_geometry": "published"},
    "traditional, refined": {"model": "traditional"},
    "compared, refined": {"model": "compared"},
    "improved, refined": {"model": "improved"},
    "improved, unequal gears, harmonics": {"model": "improved", **UNEQUAL},
    "compared, published, unequal gears and bearings": {
        "model": "compared",
        **PUBLISHED,
        **UNEQUAL,
        **LOPSIDED,
    },
    "traditional, unequal bearings": {"model": "traditional", **LOPSIDED},
    "improved, back flank": {"model": "improved", "operation.speed": 628.0, **BACK},
    "traditional, published, back flank": {"model": "traditional", **PUBLISHED, **BACK},
    "improved, from rest, governed": {
        "model": "improved",
        "operation.initial": "rest",
        "operation.control": "speed",
        "operation.speed": 50.0,
    },
    "compared, backwards against a brake": {
        "model": "compared",
        "operation.speed": -300.0,
        "operation.load_law": "brake",
        "operation.load_viscous": 0.02,
    },
    "improved, reversal through zero": {
        "model": "improved",
        "operation.speed": 3.0,
        "operation.drive_torque": -60.0,
        "operation.load_torque": 30.0,
    },
    "improved, reversal through zero under load": {
        "model": "improved",
        "operation.speed": 8.0,
        "operation.drive_torque": 20.0,
        "operation.load_torque": 120.0,
    },
}


def spread(channel: str, values: NDArray[np.float64]) -> float:
    """What a channel's error is measured against: its range over the run, angles unwrapped.

    A channel that stands still has to agree to rounding.
    """
    if channel in ANGLES:
        values = np.unwrap(values)
    return max(float(np.ptp(values)), 1e-9 * float(np.abs(values).max()), 1e-30)


def disagreement(
    samples: NDArray[np.float64], expected: NDArray[np.float64], channels: int
) -> dict[str, float]:
    """Largest difference of each channel, as a fraction of its range; angles on the circle."""
    found = {}
    for column, channel in enumerate(CHANNELS[:channels]):
        difference = samples[:, column] - expected[:, column]
        if channel in ANGLES:
            difference = (difference + np.pi) % (2.0 * np.pi) - np.pi
        found[channel] = float(np.abs(difference).max()) / spread(channel, expected[:, column])
    return found


def dte_error(samples: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Largest difference in DTE, m."""
    return float(np.abs(samples[:, 1] - expected[:, 1]).max())
