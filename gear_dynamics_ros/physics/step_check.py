"""What the integration step must bear, as products of the step with rates of the model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import film_factor, mesh_damping
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.physics.modes import (
    bearing_of,
    contact_depth,
    natural_frequencies,
    radial_factor,
)

# Where RK4 becomes unstable: on an undamped oscillation and on a pure decay.
OSCILLATION_LIMIT = 2.0 * math.sqrt(2.0)
DECAY_LIMIT = 2.785
# RK4 turns an oscillation of z = h w too slowly by z^4/120 and damps it by a ratio of z^5/144: here by 5e-4
# and 2e-4, far below the damping of any gear.
ACCURACY_LIMIT = 0.5
# Waves of the surfaces are integrated from their derivatives, stiffness and static error like the motion.
STEPS_PER_WAVE = 2.0
STEPS_PER_HARMONIC = 4.0
PHASES_PER_HARMONIC = 32


class Check(NamedTuple):
    """One product of the step with a rate of the model, against the most it may be."""

    name: str
    rate: float  # 1/s
    value: float  # rate times step
    limit: float
    consequence: str

    @property
    def holds(self) -> bool:
        """Whether the step bears it."""
        return self.value <= self.limit

    @property
    def message(self) -> str:
        """One line: name, value, limit, and what to do."""
        return (
            f"solver.step times {self.name} ({self.rate:.4g} 1/s) is {self.value:.3g}, more than "
            f"{self.limit:.3g}: {self.consequence}; "
            f"lower solver.step to {self.limit / self.rate:.2g} s or less"
        )


def checks(parameters: Parameters, speed: float | None = None) -> list[Check]:
    """Every rate of the model; ``speed`` of the driving gear in rad/s, by default ``operation.speed``."""
    step = parameters.solver.step
    turning = abs(parameters.operation.speed if speed is None else speed)

    def check(name: str, rate: float, limit: float, consequence: str) -> Check:
        return Check(name, rate, step * rate, limit, consequence)

    frequency = natural_frequency(parameters)
    found = check("the highest natural frequency", frequency, ACCURACY_LIMIT, "it is integrated coarsely")
    if found.value > OSCILLATION_LIMIT:
        found = found._replace(limit=OSCILLATION_LIMIT, consequence="the method is unstable")
    decays = {"the damping rate of the mesh": mesh_damping_rate(parameters)}
    for side in ("driving", "driven"):
        if parameters.model == "traditional":
            decays[f"the damping rate of the {side} bearing"] = kelvin_damping_rate(parameters, side)
        if parameters.model == "improved":
            decays[f"the damping rate of the {side} oil film"] = film_damping_rate(parameters, side)
    return [
        found,
        *(check(name, rate, DECAY_LIMIT, "the method is unstable") for name, rate in decays.items()),
        check(
            "the frequency of the shortest wave",
            waves_per_turn(parameters) * turning / (2.0 * math.pi),
            1.0 / STEPS_PER_WAVE,
            f"fewer than {STEPS_PER_WAVE:g} steps see it pass",
        ),
        check(
            "the frequency of the highest harmonic",
            harmonics_per_turn(parameters) * turning / (2.0 * math.pi),
            1.0 / STEPS_PER_HARMONIC,
            f"fewer than {STEPS_PER_HARMONIC:g} steps see it pass",
        ),
    ]


def natural_frequency(parameters: Parameters) -> float:
    """Highest natural frequency of the undamped gear pair in rad/s, the mesh at its stiffest.

    With both bearings closed by the static load; impacts press Hertz contacts in deeper, whose stiffness
    grows with the cube root of their force.
    """
    stiffest = parameters.mesh.stiffness * stiffness_peak(parameters)
    return natural_frequencies(parameters, static_load(parameters), stiffest)[-1]


def stiffness_peak(parameters: Parameters) -> float:
    """Largest mesh stiffness relative to its mean."""
    mesh = parameters.mesh
    most = max(len(mesh.stiffness_cos), len(mesh.stiffness_sin))
    phase = np.linspace(0.0, 2.0 * math.pi, PHASES_PER_HARMONIC * most, endpoint=False)
    total = np.ones_like(phase)
    for h, amplitude in enumerate(mesh.stiffness_cos, start=1):
        total += amplitude * np.cos(h * phase)
    for h, amplitude in enumerate(mesh.stiffness_sin, start=1):
        total += amplitude * np.sin(h * phase)
    return float(total.max())


def static_load(parameters: Parameters) -> float:
    """Force of the mesh and of each bearing under the torques of the start, N."""
    operation = parameters.operation
    r1, r2 = base_radii(parameters)
    return max(abs(operation.drive_torque) / r1, abs(operation.load_torque) / r2)


def mesh_damping_rate(parameters: Parameters) -> float:
    """Rate at which mesh damping slows the approach of free gears, 1/s."""
    gears = parameters.gears
    r1, r2 = base_radii(parameters)
    per_mass = r1**2 / gears.driving.inertia + r2**2 / gears.driven.inertia
    per_mass += radial_factor(parameters) * (1.0 / gears.driving.mass + 1.0 / gears.driven.mass)
    return mesh_damping(parameters) * per_mass


def kelvin_damping_rate(parameters: Parameters, side: str) -> float:
    """c_b / m of the ``side`` gear, 1/s."""
    damping: float = bearing_of(parameters, side).kelvin_damping / getattr(parameters.gears, side).mass
    return damping


def film_damping_rate(parameters: Parameters, side: str) -> float:
    """Rate at which the film slows the ``side`` gear's motion outward, 1/s.

    Where the bearing carries the static load: the rate grows with the eccentricity, and the gear hardly
    comes farther out.
    """
    bearing = bearing_of(parameters, side)
    reached = (
        bearing.clearance + contact_depth(parameters, side, static_load(parameters))
    ) / bearing.oil_clearance
    eps = min(reached, parameters.oil.eccentricity_limit)
    mass: float = getattr(parameters.gears, side).mass
    return film_damping(film_factor(parameters, bearing) / bearing.oil_clearance, eps) / mass


def film_damping(scale: float, eps: float) -> float:
    """Force of (14), (15) by the speed of an outward motion at eccentricity ``eps``, times ``scale``."""
    s = 1.0 - eps * eps
    g = 2.0 / math.sqrt(s) * (0.5 * math.pi + math.atan(eps / math.sqrt(s)))
    v = (2.0 + eps * g) / s
    return 2.0 * scale * (3.0 * eps * v + g) / s


def waves_per_turn(parameters: Parameters) -> float:
    """Of the shortest wave that rough surfaces have, on the driving gear; 0 if both are smooth."""
    surface = parameters.surface
    rough = max(surface.driving.roughness, surface.driven.roughness) > 0.0
    shortest: float = surface.scale ** (surface.waves - 1) if rough else 0.0
    return parameters.gears.driving.teeth * shortest


def harmonics_per_turn(parameters: Parameters) -> float:
    """Of the highest harmonic that stiffness and static error have, on the driving gear."""
    mesh = parameters.mesh
    series = (mesh.stiffness_cos, mesh.stiffness_sin, mesh.error_cos, mesh.error_sin)
    orders = [h for amplitudes in series for h, a in enumerate(amplitudes, start=1) if a != 0.0]
    return float(parameters.gears.driving.teeth * max(orders, default=0))
