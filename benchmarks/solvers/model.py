"""The model as a smooth right-hand side between events, compiled by numba, for general solvers.

It shares no compiled code with the kernel. The contact flags stand still inside a step; ``values`` tells when
they must change and ``apply`` changes them. Symbols are those of docs/model.md; SI units throughout.

State (12): x1 y1 x2 y2, u, theta1 (never wrapped), vx1 vy1 vx2 vy2, omega1 omega2.
Mode (8): the flags that are frozen between events, and the impact speeds they latched.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from math import acos, atan, atan2, cos, pi, sin, sqrt, tan, tanh
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.restitution import damping_factor
from gear_dynamics_ros.physics.surface import fractal_surface

Floats: TypeAlias = NDArray[np.float64]
compiled = njit(error_model="numpy")

STATE_SIZE = 12
FLANK, MESH_CLAMPED, CONTACT, CLAMPED, IMPACT_SPEED, MODE_SIZE = 0, 1, 2, 4, 6, 8
# Switching surfaces: each value is positive where the mode holds and turns negative at its event.
DRIVE_FLANK, BACK_FLANK, MESH_CLAMP, BEARING_GAP, BEARING_CLAMP, EVENT_COUNT = 0, 1, 2, 3, 5, 7
INACTIVE = 1.0


class Model(NamedTuple):
    """Compiled functions of one set of parameters, and its start.

    ``derivative(t, y, rate, mode)`` and ``values(t, y, value, mode)`` fill their third argument;
    ``apply(t, y, event, mode)`` changes the mode at an event; ``dte(t, y)`` is in m.
    """

    derivative: Callable[[float, Floats, Floats, Floats], None]
    values: Callable[[float, Floats, Floats, Floats], None]
    apply: Callable[[float, Floats, int, Floats], None]
    dte: Callable[[float, Floats], float]
    state: Floats
    mode: Floats
    scale: Floats  # sizes of the state's vibration, for tolerances


def build(parameters: Parameters) -> Model:
    """Functions of the model with ``parameters`` frozen into them."""
    mesh = _mesh(parameters)
    mesh_force = _mesh_force(parameters)
    gap, push, contact_force = _bearings(parameters)
    film = _film(parameters)
    gears, operation = parameters.gears, parameters.operation
    r1, r2 = _base_radii(parameters)
    m1, m2 = gears.driving.mass, gears.driven.mass
    j1, j2 = gears.driving.inertia, gears.driven.inertia
    drive, load, viscous = operation.drive_torque, operation.load_torque, operation.load_viscous
    brake = operation.load_law == "brake"
    exact = parameters.mesh_geometry == "exact"
    contact_damping = parameters.mesh_damping == "contact"
    minimum_impact_speed = parameters.bearings.minimum_impact_speed

    @compiled
    def derivative(t: float, y: Floats, rate: Floats, mode: Floats) -> None:
        q, q_rate, b1, b1_rate, k1, alpha, beta = mesh(t, y)
        force = 0.0 if mode[MESH_CLAMPED] else mesh_force(q, q_rate, b1, b1_rate, k1, mode[FLANK])
        if exact and mode[FLANK] < 0.0:
            along_x, along_y = -sin(alpha + beta), cos(alpha + beta)
        else:
            along_x, along_y = sin(alpha - beta), cos(alpha - beta)
        contact_x1, contact_y1 = contact_force(0, y, mode)
        contact_x2, contact_y2 = contact_force(1, y, mode)
        film_x1, film_y1 = film(0, y)
        film_x2, film_y2 = film(1, y)
        resisting = (load * tanh(y[11]) if brake else load) + viscous * y[11]
        rate[0:4] = y[6:10]
        rate[4] = r1 * y[10] - r2 * y[11]
        rate[5] = y[10]
        rate[6] = (contact_x1 + film_x1 - force * along_x) / m1
        rate[7] = (contact_y1 + film_y1 - force * along_y) / m1
        rate[8] = (contact_x2 + film_x2 + force * along_x) / m2
        rate[9] = (contact_y2 + film_y2 + force * along_y) / m2
        rate[10] = (drive - force * r1) / j1
        rate[11] = (force * r2 - resisting) / j2

    @compiled
    def values(t: float, y: Floats, value: Floats, mode: Floats) -> None:
        q, q_rate, b1, b1_rate, k1, _, _ = mesh(t, y)
        flank = mode[FLANK]
        value[:] = INACTIVE
        if flank == 0.0:
            value[DRIVE_FLANK] = b1 - q
            value[BACK_FLANK] = b1 + q
        else:
            value[DRIVE_FLANK if flank > 0.0 else BACK_FLANK] = flank * q - b1
            if contact_damping:
                pressing = flank * mesh_force(q, q_rate, b1, b1_rate, k1, flank)
                value[MESH_CLAMP] = -pressing if mode[MESH_CLAMPED] else pressing
        for i in range(2):
            penetration, speed, _, _ = gap(i, y)
            if mode[CONTACT + i]:
                pressing = push(i, penetration, speed, mode)
                value[BEARING_GAP + i] = penetration
                value[BEARING_CLAMP + i] = -pressing if mode[CLAMPED + i] else pressing
            else:
                value[BEARING_GAP + i] = -penetration

    @compiled
    def strike(i: int, y: Floats, mode: Floats) -> None:
        mode[CONTACT + i], mode[CLAMPED + i] = 1.0, 0.0
        mode[IMPACT_SPEED + i] = max(gap(i, y)[1], minimum_impact_speed)

    @compiled
    def apply(t: float, y: Floats, event: int, mode: Floats) -> None:
        if event == MESH_CLAMP:
            mode[MESH_CLAMPED] = 1.0 - mode[MESH_CLAMPED]
        elif event in (DRIVE_FLANK, BACK_FLANK):
            side = 1.0 if event == DRIVE_FLANK else -1.0
            mode[FLANK] = side if mode[FLANK] == 0.0 else 0.0
            mode[MESH_CLAMPED] = 0.0
        elif event >= BEARING_CLAMP:
            i = event - BEARING_CLAMP
            mode[CLAMPED + i] = 1.0 - mode[CLAMPED + i]
        else:
            i = event - BEARING_GAP
            if mode[CONTACT + i]:
                mode[CONTACT + i] = mode[CLAMPED + i] = 0.0
            else:
                strike(i, y, mode)
        for i in range(2):  # equal gears strike at one instant: the other gap is closed already
            penetration, speed, _, _ = gap(i, y)
            if not mode[CONTACT + i] and penetration > 0.0 and speed > 0.0:
                strike(i, y, mode)

    @compiled
    def dte(t: float, y: Floats) -> float:
        q: float = mesh(t, y)[0]
        return q

    state, mode = _start(parameters, mesh)
    return Model(derivative, values, apply, dte, state, mode, _vibration(parameters))


def _base_radii(parameters: Parameters) -> tuple[float, float]:
    gears = parameters.gears
    half = 0.5 * gears.module * cos(gears.pressure_angle)
    return half * gears.driving.teeth, half * gears.driven.teeth


def _effective_mass(parameters: Parameters) -> float:
    """Mass of both gears' rotation along the line of action, kg."""
    (r1, r2), gears = _base_radii(parameters), parameters.gears
    j1, j2 = gears.driving.inertia, gears.driven.inertia
    return j1 * j2 / (r1**2 * j2 + r2**2 * j1)


def _roughness(parameters: Parameters) -> tuple[Floats, Floats, Floats]:
    """z_1 + z_2 over the mesh phase: waves a tooth, cosine and sine amplitudes in m; equal waves are one."""
    surface, gears = parameters.surface, parameters.gears
    waves: dict[float, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for own, teeth in ((surface.driving, gears.driving.teeth), (surface.driven, gears.driven.teeth)):
        profile = fractal_surface(
            teeth=teeth,
            roughness=own.roughness,
            fractal_dimension=own.fractal_dimension,
            offset=own.offset,
            scale=surface.scale,
            waves=surface.waves,
        )
        for order, cosine, sine in zip(profile.orders, profile.cosine, profile.sine, strict=True):
            waves[order / teeth][0] += cosine
            waves[order / teeth][1] += sine
    table = np.array(list(waves.values()))
    return np.array(list(waves)), table[:, 0].copy(), table[:, 1].copy()


def _harmonics(cosine: Sequence[float], sine: Sequence[float]) -> tuple[Floats, Floats]:
    """Both parts at 1, 2, ... times mesh frequency, of one length."""
    size = max(len(cosine), len(sine))
    return np.pad(cosine, (0, size - len(cosine))), np.pad(sine, (0, size - len(sine)))


def _series(orders: Floats, cosine: Floats, sine: Floats) -> Any:
    """Compiled (value, slope) of sum_k cosine_k cos(orders_k phi) + sine_k sin(orders_k phi)."""
    count = len(orders)

    @compiled
    def series(phi: float) -> tuple[float, float]:
        value = slope = 0.0
        for k in range(count):
            c, s = cos(orders[k] * phi), sin(orders[k] * phi)
            value += cosine[k] * c + sine[k] * s
            slope += orders[k] * (sine[k] * c - cosine[k] * s)
        return value, slope

    return series


def _mesh(parameters: Parameters) -> Any:
    """Compiled (t, y) -> q, dq/dt, b1, db1/dt, k1, alpha, beta: (21)-(28)."""
    gears, mesh = parameters.gears, parameters.mesh
    r1, r2 = _base_radii(parameters)
    radii = r1 + r2
    centres = 0.5 * gears.module * (gears.driving.teeth + gears.driven.teeth)
    involute0 = tan(gears.pressure_angle) - gears.pressure_angle
    half_backlash = 0.5 * gears.backlash
    teeth = float(gears.driving.teeth)
    stiffness, error_mean = mesh.stiffness, mesh.error_mean
    nominal, speed = parameters.mesh_phase == "nominal", parameters.operation.speed
    exact = parameters.mesh_geometry == "exact"
    roughness = _series(*_roughness(parameters))
    cosine, sine = _harmonics(mesh.stiffness_cos, mesh.stiffness_sin)
    modulation = _series(np.arange(1.0, len(cosine) + 1.0), cosine, sine)
    cosine, sine = _harmonics(mesh.error_cos, mesh.error_sin)
    error = _series(np.arange(1.0, len(cosine) + 1.0), cosine, sine)

    @compiled
    def at(t: float, y: Floats) -> tuple[float, float, float, float, float, float, float]:
        phi, phi_rate = teeth * y[5], teeth * y[10]
        if nominal:
            phi, phi_rate = teeth * speed * t, teeth * speed
        dx, dy, vx, vy = centres + y[2] - y[0], y[3] - y[1], y[8] - y[6], y[9] - y[7]
        a = sqrt(dx * dx + dy * dy)
        a_rate = (dx * vx + dy * vy) / a
        alpha, beta = acos(radii / a), atan2(dy, dx)
        tan_alpha = tan(alpha)
        alpha_rate = a_rate / (a * tan_alpha)
        beta_rate = (dx * vy - dy * vx) / (a * a)
        z, z_slope = roughness(phi)
        b1 = radii * (tan_alpha - alpha - involute0) + half_backlash - 0.5 * z
        b1_rate = radii * tan_alpha * tan_alpha * alpha_rate - 0.5 * z_slope * phi_rate
        e, e_slope = error(phi)
        k1 = stiffness * (1.0 + modulation(phi)[0])
        q = y[4] - error_mean - e
        q_rate = r1 * y[10] - r2 * y[11] - e_slope * phi_rate
        if exact:
            return q - radii * beta, q_rate - radii * beta_rate, b1, b1_rate, k1, alpha, beta
        s, c = sin(alpha - beta), cos(alpha - beta)
        lever = (y[0] - y[2]) * c - (y[1] - y[3]) * s
        q += (y[0] - y[2]) * s + (y[1] - y[3]) * c
        q_rate += lever * (alpha_rate - beta_rate) - vx * s - vy * c
        return q, q_rate, b1, b1_rate, k1, alpha, beta

    return at


def _mesh_force(parameters: Parameters) -> Any:
    """Compiled F_p of (30) before its clamp."""
    mesh = parameters.mesh
    damping = 2.0 * mesh.damping_ratio * sqrt(mesh.stiffness * _effective_mass(parameters))  # (26)
    contact_damping = parameters.mesh_damping == "contact"

    @compiled
    def force(q: float, q_rate: float, b1: float, b1_rate: float, k1: float, flank: float) -> float:
        elastic = k1 * (q - flank * b1) if flank != 0.0 else 0.0
        if not contact_damping:
            return elastic + damping * q_rate
        return elastic + damping * (q_rate - flank * b1_rate) if flank != 0.0 else 0.0

    return force


def _bearings(parameters: Parameters) -> tuple[Any, Any, Any]:
    """Compiled bearing contacts: Kelvin, or Hertz with restitution, (2)-(6).

    ``gap(i, y)`` is the penetration, its rate and the unit vector outward;
    ``push(i, penetration, rate, mode)`` is negative where the contact would pull; ``force(i, y, mode)`` is
    x and y in N.
    """
    bearings = parameters.bearings
    both = (bearings.driving, bearings.driven)
    clearance = np.array([bearing.clearance for bearing in both])
    kelvin_stiffness = np.array([bearing.kelvin_stiffness for bearing in both])
    kelvin_damping = np.array([bearing.kelvin_damping for bearing in both])
    factor = np.array([damping_factor(bearing.restitution, parameters.restitution_law) for bearing in both])
    kelvin = parameters.model == "traditional"
    compliance = sum(
        (1.0 - material.poissons_ratio**2) / material.youngs_modulus
        for material in (bearings.shaft, bearings.sleeve)
    )
    hertz = np.array([pi * bearing.length / (2.0 * compliance) for bearing in both])

    @compiled
    def gap(i: int, y: Floats) -> tuple[float, float, float, float]:
        x, z, vx, vz = y[2 * i], y[2 * i + 1], y[6 + 2 * i], y[7 + 2 * i]
        d = sqrt(x * x + z * z)
        if d == 0.0:
            return -clearance[i], 0.0, 0.0, 0.0
        return d - clearance[i], (x * vx + z * vz) / d, x / d, z / d

    @compiled
    def push(i: int, penetration: float, rate: float, mode: Floats) -> float:
        if kelvin:
            return kelvin_stiffness[i] * penetration + kelvin_damping[i] * rate
        return 1.0 + factor[i] * rate / mode[IMPACT_SPEED + i]

    @compiled
    def force(i: int, y: Floats, mode: Floats) -> tuple[float, float]:
        if not mode[CONTACT + i] or mode[CLAMPED + i]:
            return 0.0, 0.0
        penetration, rate, nx, ny = gap(i, y)
        size = push(i, penetration, rate, mode)
        if not kelvin:
            depth = max(penetration, 0.0)
            size *= hertz[i] * sqrt(0.5 / (clearance[i] + depth)) * depth * sqrt(depth)
        return -size * nx, -size * ny

    return gap, push, force


def _film(parameters: Parameters) -> Any:
    """Compiled oil film of bearing i after Capone: (i, y) -> x and y, N."""
    oil, operation = parameters.oil, parameters.operation
    both = (parameters.bearings.driving, parameters.bearings.driven)
    clearance = np.array([bearing.oil_clearance for bearing in both])
    unit = np.array(
        [oil.viscosity * 0.5 * b.diameter * b.length**3 / (4.0 * b.oil_clearance**2) for b in both]
    )
    present = parameters.model == "improved"
    limit = oil.eccentricity_limit
    nominal = parameters.mesh_phase == "nominal"
    r1, r2 = _base_radii(parameters)
    set_points = np.array([operation.speed, -operation.speed * r1 / r2])

    @compiled
    def force(i: int, y: Floats) -> tuple[float, float]:
        if not present:
            return 0.0, 0.0
        w = set_points[i] if nominal else (y[10] if i == 0 else -y[11])
        ex, ey = y[2 * i] / clearance[i], y[2 * i + 1] / clearance[i]
        ux, uy = y[6 + 2 * i] / clearance[i], y[7 + 2 * i] / clearance[i]
        eps = sqrt(ex * ex + ey * ey)
        if eps > limit:
            ex, ey, eps = ex * limit / eps, ey * limit / eps, limit
        s = 1.0 - eps * eps
        a, b = w * ex - 2.0 * uy, w * ey + 2.0 * ux
        m = sqrt(a * a + b * b)
        if m == 0.0:
            return 0.0, 0.0
        cos_al, sin_al = -a / m, -b / m
        h, c = ey * cos_al - ex * sin_al, ex * cos_al + ey * sin_al
        g = 2.0 / sqrt(s) * (0.5 * pi + atan(h / sqrt(s)))
        v = (2.0 + h * g) / s
        side = c / (1.0 - c * c)
        size = -unit[i] * m / s
        fx: float = size * (3.0 * ex * v - sin_al * g - 2.0 * cos_al * side)
        fy: float = size * (3.0 * ey * v + cos_al * g - 2.0 * sin_al * side)
        return fx, fy

    return force


def _start(parameters: Parameters, mesh: Any) -> tuple[Floats, Floats]:
    """State and mode with the drive flank just touching, q = b1, and the centres at rest in the middle."""
    r1, r2 = _base_radii(parameters)
    speed = 0.0 if parameters.operation.initial == "rest" else parameters.operation.speed
    y, mode = np.zeros(STATE_SIZE), np.zeros(MODE_SIZE)
    y[10], y[11] = speed, speed * r1 / r2
    q, q_rate, b1, b1_rate, *_ = mesh(0.0, y)
    y[4] = b1 - q
    mode[FLANK] = 1.0 if q_rate > b1_rate else 0.0
    mode[IMPACT_SPEED : IMPACT_SPEED + 2] = parameters.bearings.minimum_impact_speed
    return y, mode


def _vibration(parameters: Parameters) -> Floats:
    """Size of the vibration in each state: half the backlash, at the frequency of the mesh."""
    r1, r2 = _base_radii(parameters)
    length = 0.5 * parameters.gears.backlash
    rate = sqrt(parameters.mesh.stiffness / _effective_mass(parameters))
    return length * np.array([1.0] * 5 + [1.0 / r1] + [rate] * 4 + [rate / r1, rate / r2])
