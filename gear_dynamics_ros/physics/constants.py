"""From parameters to what the kernel works with: constants and the table of periodic excitations."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import BearingParameters, Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.physics.kernel.records import CACHE_LINE, CONSTANTS, EXCITATIONS, SERIES_TERMS
from gear_dynamics_ros.physics.kernel.waves import ERROR, ORDER, ROW_BLOCK, STIFFNESS, SURFACE, WAVE_ROWS
from gear_dynamics_ros.physics.restitution import damping_factor
from gear_dynamics_ros.physics.surface import FractalProfile, fractal_surface


class Excitations(NamedTuple):
    """Every periodic excitation as one trigonometric series over the hunting cycle.

    ``waves`` (WAVE_ROWS, n): waves per cycle in row ORDER, zeros to a whole number of blocks of lanes, and
    room for the kernel. ``amplitudes`` (m, 2, EXCITATIONS), m even, of the cosine and the sine of each wave:
    surface height z1 + z2, its first and second derivative by the mesh phase, stiffness modulation and slope,
    static error with two derivatives; m and rad, stiffness dimensionless.
    """

    waves: NDArray[np.float64]
    amplitudes: NDArray[np.float64]


def hunting_turns(parameters: Parameters) -> int:
    """Turns of the driving gear after which the same teeth meet again, Z2 / gcd(Z1, Z2)."""
    gears = parameters.gears
    return gears.driven.teeth // math.gcd(gears.driving.teeth, gears.driven.teeth)


def mesh_damping(parameters: Parameters) -> float:
    """c_1 of (26) in N s/m."""
    gears = parameters.gears
    r1, r2 = base_radii(parameters)
    j1, j2 = gears.driving.inertia, gears.driven.inertia
    return (
        2.0
        * parameters.mesh.damping_ratio
        * math.sqrt(parameters.mesh.stiffness * j1 * j2 / (r1 * r1 * j2 + r2 * r2 * j1))
    )


def involute_series(tan2: float) -> list[float]:
    """Coefficients of inv alpha - inv alpha0, cos, sin, cot in powers of x; tan^2 alpha = ``tan2`` + x.

    The four of one power stand side by side. With w = tan alpha, d(w - atan w)/dx = w / (2 (1 + w^2)); all
    factors have binomial series.
    """
    terms = SERIES_TERMS
    tangent, cotangent = [math.sqrt(tan2)], [1.0 / math.sqrt(tan2)]
    cosine, square = [1.0 / math.sqrt(1.0 + tan2)], [1.0 / (1.0 + tan2)]
    for k in range(1, terms):
        tangent.append(tangent[-1] * (1.5 - k) / (k * tan2))
        cotangent.append(-cotangent[-1] * (k - 0.5) / (k * tan2))
        cosine.append(-cosine[-1] * (k - 0.5) / (k * (1.0 + tan2)))
        square.append(-square[-1] / (1.0 + tan2))
    involute = [0.0, *(value / (2.0 * k) for k, value in enumerate(_product(tangent, square), start=1))]
    return [
        value
        for power in zip(involute, cosine, _product(tangent, cosine), cotangent, strict=False)
        for value in power
    ]


def _product(left: list[float], right: list[float]) -> list[float]:
    """Coefficients of the product of two power series, as many as each has."""
    return [math.fsum(left[i] * right[k - i] for i in range(k + 1)) for k in range(len(left))]


def surfaces(parameters: Parameters) -> tuple[FractalProfile, FractalProfile]:
    """Tooth surfaces of driving and driven gear."""
    gears, surface = parameters.gears, parameters.surface

    def of(teeth: int, side: str) -> FractalProfile:
        own = getattr(surface, side)
        return fractal_surface(
            teeth=teeth,
            roughness=own.roughness,
            fractal_dimension=own.fractal_dimension,
            offset=own.offset,
            scale=surface.scale,
            waves=surface.waves,
        )

    return of(gears.driving.teeth, "driving"), of(gears.driven.teeth, "driven")


def aligned_zeros(shape: tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """Zeros that begin on a cache line, which numpy doesn't promise."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    aligned: NDArray[Any] = raw[start : start + size].view(dtype).reshape(shape)
    return aligned


def excitation_table(parameters: Parameters) -> Excitations:
    """Table of surfaces, stiffness and static error, (16)-(18), (24), (25); equal orders share a row."""
    turns = hunting_turns(parameters)
    teeth = parameters.gears.driving.teeth
    rows: dict[int, NDArray[np.float64]] = {}

    def add(order: int, value_column: int, derivatives: int, cosine: float, sine: float) -> None:
        row = rows.setdefault(order, np.zeros((2, EXCITATIONS)))
        per_phase = order / (teeth * turns)
        for column in range(value_column, value_column + derivatives + 1):
            row[:, column] += cosine, sine
            cosine, sine = per_phase * sine, -per_phase * cosine

    driving, driven = surfaces(parameters)
    driven_turns = turns * teeth // parameters.gears.driven.teeth
    for surface, own_turns in ((driving, turns), (driven, driven_turns)):
        for order, cosine, sine in zip(surface.orders.tolist(), surface.cosine, surface.sine, strict=True):
            add(order * own_turns, SURFACE, 2, float(cosine), float(sine))
    mesh = parameters.mesh
    for column, derivatives, cosines, sines in (
        (STIFFNESS, 1, mesh.stiffness_cos, mesh.stiffness_sin),
        (ERROR, 2, mesh.error_cos, mesh.error_sin),
    ):
        for h, cosine in enumerate(cosines, start=1):
            add(h * teeth * turns, column, derivatives, cosine, 0.0)
        for h, sine in enumerate(sines, start=1):
            add(h * teeth * turns, column, derivatives, 0.0, sine)

    orders = sorted(rows)
    waves = aligned_zeros((WAVE_ROWS, -(-len(orders) // ROW_BLOCK) * ROW_BLOCK))
    waves[ORDER, : len(orders)] = orders
    amplitudes = aligned_zeros((len(orders) + len(orders) % 2, 2, EXCITATIONS))
    for index, order in enumerate(orders):
        amplitudes[index] = rows[order]
    return Excitations(waves, amplitudes)


def kernel_constants(parameters: Parameters, table: Excitations) -> NDArray[Any]:
    """The kernel's constants; every derived number of the model is computed here."""
    gears, mesh, operation = parameters.gears, parameters.mesh, parameters.operation
    r1, r2 = base_radii(parameters)
    tan_alpha0 = math.tan(gears.pressure_angle)
    pair = ((gears.driving, r1), (gears.driven, r2))
    both = (parameters.bearings.driving, parameters.bearings.driven)
    values = dict(
        kelvin=parameters.model == "traditional",
        film=parameters.model == "improved",
        exact_geometry=parameters.mesh_geometry == "exact",
        # Without damping nothing pulls, and the clamp would be the gap itself.
        contact_damping=parameters.mesh_damping == "contact" and mesh.damping_ratio > 0.0,
        nominal_phase=parameters.mesh_phase == "nominal",
        brake=operation.load_law == "brake",
        governed=operation.control == "speed",
        centre_distance=0.5 * gears.module * (gears.driving.teeth + gears.driven.teeth),
        base_radius=(r1, r2),
        per_radii=1.0 / (r1 + r2),
        tan2_alpha0=tan_alpha0**2,
        involute_alpha0=tan_alpha0 - math.atan(tan_alpha0),
        involute_series=involute_series(tan_alpha0**2),
        half_backlash=0.5 * gears.backlash,
        stiffness=mesh.stiffness,
        damping=mesh_damping(parameters),
        error_mean=mesh.error_mean,
        per_mass=(1.0 / gears.driving.mass, 1.0 / gears.driven.mass),
        per_inertia=(1.0 / gears.driving.inertia, 1.0 / gears.driven.inertia),
        per_mesh_mass=sum(1.0 / gear.mass + r * r / gear.inertia for gear, r in pair),
        teeth1=float(gears.driving.teeth),
        padded_waves=table.waves.shape[1],
        waves=table.amplitudes.shape[0],
        hunting=hunting_turns(parameters),
        clearance=[bearing.clearance for bearing in both],
        kelvin_stiffness=[bearing.kelvin_stiffness for bearing in both],
        kelvin_damping=[bearing.kelvin_damping for bearing in both],
        hertz=[hertz_factor(parameters, bearing.length) for bearing in both],
        damping_factor=[damping_factor(bearing.restitution, parameters.restitution_law) for bearing in both],
        per_oil_clearance=[1.0 / bearing.oil_clearance for bearing in both],
        film_factor=[film_factor(parameters, bearing) for bearing in both],
        minimum_impact_speed=parameters.bearings.minimum_impact_speed,
        eccentricity_limit2=parameters.oil.eccentricity_limit**2,
        load_viscous=operation.load_viscous,
        governor_proportional=operation.governor.proportional,
        governor_integral=operation.governor.integral,
        governor_limit=operation.governor.torque_limit,
        speed_limit=operation.speed_limit,
        step=parameters.solver.step,
        steps_per_sample=parameters.solver.steps_per_sample,
    )
    record = aligned_zeros((1,), CONSTANTS)
    for name in CONSTANTS.names or ():
        record[name] = values[name]
    return record


def hertz_factor(parameters: Parameters, length: float) -> float:
    """k_h sqrt(b_b + delta) of (2) for a bearing of ``length`` in m; N/m."""
    shaft, sleeve = parameters.bearings.shaft, parameters.bearings.sleeve
    compliance = (1.0 - shaft.poissons_ratio**2) / shaft.youngs_modulus
    compliance += (1.0 - sleeve.poissons_ratio**2) / sleeve.youngs_modulus
    return 0.5 * math.pi * length / compliance * math.sqrt(0.5)


def film_factor(parameters: Parameters, bearing: BearingParameters) -> float:
    """mu (D/2) L^3 / (4 C^2) of (14), (15) in N s."""
    return (
        parameters.oil.viscosity
        * 0.5
        * bearing.diameter
        * bearing.length**3
        / (4.0 * bearing.oil_clearance**2)
    )
