"""What is measured to validate the physics, each number beside its reference and its tolerance.

Used by the tests, which hold the tolerances, and by scripts/validation_table.py, which prints them. The
references are closed forms, quadratures or printed numbers; none is computed by the code that is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq, root

from gear_dynamics_ros.analysis.chaos import largest_exponent, zero_one_test
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import aligned_zeros, base_radii, excitation_table, kernel_constants
from gear_dynamics_ros.physics.kernel.entry import evaluate_state
from gear_dynamics_ros.physics.kernel.film import capone_film
from gear_dynamics_ros.physics.kernel.records import HERE, POINT, STATE
from gear_dynamics_ros.physics.restitution import damping_factor
from gear_dynamics_ros.physics.surface import fractal_surface
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.separated_pair import SeparatedPair
from support.chaotic_systems import LorenzPair, logistic
from support.linearised import settled, slowest_mode

Vector = NDArray[np.float64]

QUIET = {
    "surface.driving.roughness": 0.0,
    "surface.driven.roughness": 0.0,
    "mesh.stiffness_cos": [0.0],
    "mesh.error_cos": [0.0],
    "operation.control": "torque",
}
PUBLISHED = {
    "mesh_geometry": "published",
    "mesh_damping": "always",
    "restitution_law": "lankarani_nikravesh",
    "mesh_phase": "nominal",
}


class Measurement(NamedTuple):
    """One line of the table."""

    what: str
    measured: float
    reference: float
    error: float
    tolerance: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        return self.error <= self.tolerance


def relative(what: str, measured: float, reference: float, tolerance: float, unit: str = "") -> Measurement:
    return Measurement(what, measured, reference, abs(measured / reference - 1.0), tolerance, unit)


def absolute(what: str, measured: float, reference: float, tolerance: float, unit: str = "") -> Measurement:
    return Measurement(what, measured, reference, abs(measured - reference), tolerance, unit)


def flat(base: dict[str, Any], changes: dict[str, Any]) -> Parameters:
    return Parameters.from_flat({**base, **changes})


# Oil film


def ocvirk(eps: float) -> tuple[float, float]:
    """Magnitude of the film force in units of mu w (D/2) L^3 / (4 C^2), and attitude angle in rad."""
    magnitude = eps * math.sqrt(16.0 * eps**2 + math.pi**2 * (1.0 - eps**2)) / (1.0 - eps**2) ** 2
    return magnitude, math.atan2(math.pi * math.sqrt(1.0 - eps**2), 4.0 * eps)


def film_by_quadrature(ex: float, ey: float, ux: float, uy: float) -> tuple[float, float]:
    """Pressure of the short bearing integrated over the half where it is positive; shaft speed 1."""
    a, b = ex - 2.0 * uy, ey + 2.0 * ux  # N = a sin t - b cos t
    start = math.atan2(b, a) - math.pi  # N < 0 from here over half a turn

    def pressure(t: float) -> float:
        film = 1.0 - ex * math.cos(t) - ey * math.sin(t)
        return (a * math.sin(t) - b * math.cos(t)) / film**3

    thinnest = math.atan2(ey, ex)
    candidates = (thinnest + 2.0 * math.pi * k for k in (-2, -1, 0, 1))
    inside = [t for t in candidates if start < t < start + math.pi]
    options = {"epsabs": 1e-13, "epsrel": 1e-10, "limit": 400, "points": inside or None}
    fx = quad(lambda t: pressure(t) * math.cos(t), start, start + math.pi, **options)[0]
    fy = quad(lambda t: pressure(t) * math.sin(t), start, start + math.pi, **options)[0]
    return 2.0 * fx, 2.0 * fy


def film_steady() -> Iterator[Measurement]:
    printed = {0.1: (0.32153, 82.708), 0.3: (1.16950, 68.178), 0.5: (3.00152, 53.680), 0.7: (9.65619, 38.704)}
    printed[0.9] = (96.0246, 20.826)
    for eps, (force, attitude) in printed.items():
        fx, fy = capone_film(1.0, 1.0, eps, 0.0, 0.0, 0.0)
        magnitude, angle = math.hypot(fx, fy), math.atan2(abs(fy), -fx)
        formula, formula_angle = ocvirk(eps)
        yield relative(f"film force against Ocvirk, eps = {eps}", magnitude, formula, 1e-12)
        yield absolute(f"film attitude against Ocvirk, eps = {eps}", angle, formula_angle, 1e-12, "rad")
        yield relative(f"film force against print, eps = {eps}", magnitude, force, 1e-5)
        degrees = math.degrees(angle)
        yield absolute(f"film attitude against print, eps = {eps}", degrees, attitude, 1e-3, "deg")


def film_moving() -> Iterator[Measurement]:
    states = [(0.3, 0.2, 0.1, -0.2), (-0.5, 0.4, -0.3, 0.05), (0.1, -0.85, 0.02, 0.4), (0.0, 0.0, 0.1, 0.2)]
    for state in states:
        measured, expected = capone_film(1.0, 1.0, *state), film_by_quadrature(*state)
        error = math.dist(measured, expected) / math.hypot(*expected)
        yield Measurement(
            f"film force against quadrature, (ex, ey, ux, uy) = {state}",
            math.hypot(*measured), math.hypot(*expected), error, 1e-8,
        )  # fmt: skip


def rotor_threshold(eps: float) -> float:
    """w sqrt(m C / W) where a rigid rotor on two short bearings turns unstable, from the film's Jacobian."""
    fx0, fy0 = capone_film(1.0, 1.0, eps, 0.0, 0.0, 0.0)
    static = math.hypot(fx0, fy0)
    jacobian = np.empty((2, 4))
    h = 1e-6
    for i in range(4):
        ahead, behind = [eps, 0.0, 0.0, 0.0], [eps, 0.0, 0.0, 0.0]
        ahead[i] += h
        behind[i] -= h
        difference = np.subtract(capone_film(1.0, 1.0, *ahead), capone_film(1.0, 1.0, *behind))
        jacobian[:, i] = difference / (2.0 * h * static)

    def growth(speed: float) -> float:
        system = np.zeros((4, 4))
        system[:2, 2:] = np.eye(2)
        system[2:] = jacobian / speed**2
        return float(np.linalg.eigvals(system).real.max())

    return float(brentq(growth, 1.0, 6.0, xtol=1e-10))


def rotor() -> Iterator[Measurement]:
    for eps, reference in {0.1: 2.7413, 0.3: 2.6058, 0.5: 2.5417, 0.6: 2.7010, 0.7: 3.6278}.items():
        yield absolute(f"rigid rotor threshold, eps = {eps}", rotor_threshold(eps), reference, 1e-3)


# Impacts


def delivered_restitution(a: float) -> float:
    """Restitution that F = k d^n (1 + a v / v0) delivers, whatever k, n and the mass."""
    if a == 0.0:
        return 1.0

    def residual(e: float) -> float:
        return a - math.log1p(a) + a * e + math.log1p(-a * e)

    # the residual falls without bound as e nears 1 / a
    return float(brentq(residual, 0.0, (1.0 - 1e-15) / a, xtol=1e-16))


def simulated_restitution(eta: float, law: str, step: float = 1e-6) -> float:
    """Rebound speed over impact speed of a gear that strikes its bearing, through the engine."""
    p = flat(
        QUIET,
        {
            "model": "compared",
            "restitution_law": law,
            "bearings.driving.restitution": eta,
            "gears.backlash": 1e-3,
            "operation.drive_torque": 0.0,
            "operation.load_torque": 0.0,
            "operation.speed": 0.0,
            "solver.step": step,
        },
    )
    engine = Engine(p)
    checkpoint = engine.checkpoint()
    clearance, speed = p.bearings.driving.clearance, 0.1
    flung = {"u": 0.0, "y": [clearance - 1.234e-6, 0.0], "vy": [speed, 0.0], "flank": 0.0}
    engine.restore(checkpoint._replace(state={**checkpoint.state, **flung}))
    chunk = engine.advance(50)
    if chunk.counters.impacts != 1 or chunk["driving_penetration"][-1] > 0.0:
        raise AssertionError("the impact is not over")
    return -float(engine.checkpoint().state["vy"][0]) / speed


def restitution() -> Iterator[Measurement]:
    printed = {0.0: 0.66296, 0.2: 0.67226, 0.4: 0.70164, 0.6: 0.75615, 0.8: 0.84710, 0.9: 0.91318}
    for eta, reference in printed.items():
        delivered = delivered_restitution(damping_factor(eta, "lankarani_nikravesh"))
        yield absolute(f"Lankarani-Nikravesh at eta = {eta} delivers", delivered, reference, 1e-5)
    for eta in (0.2, 0.6, 0.9):
        simulated = simulated_restitution(eta, "lankarani_nikravesh")
        yield absolute(f"Lankarani-Nikravesh at eta = {eta}, simulated", simulated, printed[eta], 1e-5)
    for eta in (0.05, 0.2, 0.44, 0.8, 1.0):
        for step, tolerance in ((1e-6, 1e-7), (0.125e-6, 1e-9)):
            simulated = simulated_restitution(eta, "exact", step)
            what = f"exact law at eta = {eta}, simulated at {step * 1e6:g} us"
            yield absolute(what, simulated, eta, tolerance)


# Linear and static


def look(p: Parameters, state: NDArray[Any]) -> np.void:
    """All that the kernel evaluates at ``state``, without excitation."""
    table = excitation_table(p)
    points = aligned_zeros((3,), POINT)
    constants = kernel_constants(p, table)
    evaluate_state(constants, state, points, table.waves, np.zeros_like(table.amplitudes))
    point: np.void = points[HERE]
    return point


def loaded_state(p: Parameters, offset: float) -> NDArray[Any]:
    """Drive flank touching, each centre ``offset`` along the line of action, there in contact."""
    state = aligned_zeros((1,), STATE)
    state["drive_torque"], state["load_torque"] = p.operation.drive_torque, p.operation.load_torque
    state["speed"], state["impact_speed"] = p.operation.speed, p.bearings.minimum_impact_speed
    shift_centres(p, state, -offset, offset)
    state["flank"] = 1.0
    if offset > 0.0:
        state["contact"] = 1.0
    point = look(p, state)
    state["u"] += point["half_backlash"] - point["q"]
    return state


def shift_centres(p: Parameters, state: NDArray[Any], first: float, second: float) -> None:
    """Move the centres along the line of action."""
    state["x"] += np.array([first, second]) * math.sin(p.gears.pressure_angle)
    state["y"] += np.array([first, second]) * math.cos(p.gears.pressure_angle)


def mode_frequencies(p: Parameters, state: NDArray[Any], fixed_centres: bool = False) -> Vector:
    """Frequencies in Hz of (u, s1, s2), s the centres' displacements along the line of action."""
    along = np.array([math.sin(p.gears.pressure_angle), math.cos(p.gears.pressure_angle)])
    r1, r2 = base_radii(p)

    def reduced(shift: Vector) -> Vector:
        moved = state.copy()
        moved["u"] += shift[0]
        shift_centres(p, moved, shift[1], shift[2])
        point = look(p, moved)
        centres = point["ax"] * along[0] + point["ay"] * along[1]
        return np.array([r1 * point["omega_rate"][0] - r2 * point["omega_rate"][1], *centres])

    h = 1e-9
    columns = [(reduced(h * row) - reduced(-h * row)) / (2.0 * h) for row in np.eye(3)]
    stiffness = -np.array(columns).T
    if fixed_centres:
        stiffness = stiffness[:1, :1]
    squares = np.linalg.eigvals(stiffness).real
    return np.sort(np.sqrt(np.clip(squares, 0.0, None))) / (2.0 * math.pi)


def modes() -> Iterator[Measurement]:
    p = flat(QUIET, {"model": "traditional", "mesh.damping_ratio": 0.0})
    # a flank pressed in by a micrometre, so that the differences stay in contact
    state = loaded_state(p, 0.0)
    state["u"] += 1e-6
    torsion = float(mode_frequencies(p, state, fixed_centres=True)[-1])
    yield relative("torsion-only mesh mode", torsion, 4654.6, 1e-5, "Hz")
    yield relative("mesh mode of free gears", float(mode_frequencies(p, state)[-1]), 6071.5, 1e-5, "Hz")
    # a gap so small that it is closed at once: line of centres and line of action stay where they are
    clearance = 1e-7
    p = flat(
        QUIET,
        {
            "model": "traditional",
            "mesh.damping_ratio": 0.0,
            "bearings.driving.clearance": clearance,
            "bearings.driven.clearance": clearance,
        },
    )
    state = loaded_state(p, clearance + 1e-8)
    state["u"] += 1e-8
    frequencies = mode_frequencies(p, state)
    yield relative("lower mode on Kelvin bearings", float(frequencies[0]), 1202.5, 1e-4, "Hz")
    yield relative("upper mode on Kelvin bearings", float(frequencies[-1]), 6160.4, 1e-4, "Hz")


def static() -> Iterator[Measurement]:
    """Equilibrium of the kernel's right-hand side."""
    p = flat(QUIET, {"model": "traditional"})
    state = loaded_state(p, p.bearings.driving.clearance + 5e-6)
    start = state.copy()

    def residual(shift: Vector) -> Vector:
        metres = 1e-6 * shift
        state["x"], state["y"] = start["x"] + metres[0:2], start["y"] + metres[2:4]
        state["u"] = start["u"] + metres[4]
        point = look(p, state)
        torsion = point["omega_rate"][0] * p.gears.driving.inertia / 0.05
        return np.array([*point["ax"], *point["ay"], torsion]) / 500.0

    solution = root(residual, np.array([0.0, 0.0, 0.0, 0.0, 1.0]), tol=1e-14)
    residual(solution.x)
    point = look(p, state)
    deflection = float(point["q"] - point["half_backlash"])
    yield relative("static mesh deflection", 1e6 * deflection, 1.77363, 1e-6, "um")
    for gear, name in enumerate(("driving", "driven")):
        penetration = 1e6 * float(point["penetration"][gear])
        yield relative(f"static deflection, {name} Kelvin bearing", penetration, 5.32089, 1e-6, "um")


# Long runs


def mean_mesh_force() -> Iterator[Measurement]:
    for model in ("traditional", "compared", "improved"):
        for name, switches in (("refined", {}), ("published", PUBLISHED)):
            p = flat({"operation.control": "torque"}, {"model": model, **switches})
            engine = Engine(p)
            samples = round(1.0 / p.solver.sample_interval)
            before = engine.checkpoint().state["mesh_impulse"]
            engine.advance(samples)
            impulse = engine.checkpoint().state["mesh_impulse"] - before
            mean = impulse / (samples * p.solver.sample_interval)
            expected = p.operation.drive_torque / base_radii(p)[0]
            yield relative(f"mean mesh force over 1 s, {model}, {name}", mean, expected, 5e-4, "N")


def vibration_energy(p: Parameters, state: dict[str, Any]) -> tuple[float, float]:
    """Conserved energy and vibration energy (kinetic and elastic) in J of the undamped gear pair."""
    gears, bearings = p.gears, p.bearings
    r1, r2 = base_radii(p)
    reach = r1 + r2
    (x1, x2), (y1, y2), u = state["x"], state["y"], state["u"]
    (vx1, vx2), (vy1, vy2), (omega1, omega2) = state["vx"], state["vy"], state["omega"]
    dx, dy = gears.module * (gears.driving.teeth + gears.driven.teeth) / 2.0 + x2 - x1, y2 - y1
    alpha, alpha0 = math.acos(reach / math.hypot(dx, dy)), gears.pressure_angle
    q = u - reach * math.atan2(dy, dx)
    b1 = reach * (math.tan(alpha) - alpha - math.tan(alpha0) + alpha0) + 0.5 * gears.backlash
    g = q - b1 if q > b1 else min(q + b1, 0.0)
    reduced = gears.driving.inertia * gears.driven.inertia
    reduced /= r1**2 * gears.driven.inertia + r2**2 * gears.driving.inertia
    kinetic = 0.5 * gears.driving.mass * (vx1**2 + vy1**2) + 0.5 * gears.driven.mass * (vx2**2 + vy2**2)
    kinetic += 0.5 * reduced * (r1 * omega1 - r2 * omega2) ** 2
    elastic = 0.5 * p.mesh.stiffness * g**2
    compliance = (1.0 - bearings.shaft.poissons_ratio**2) / bearings.shaft.youngs_modulus
    compliance += (1.0 - bearings.sleeve.poissons_ratio**2) / bearings.sleeve.youngs_modulus
    for bearing, x, y in ((bearings.driving, x1, y1), (bearings.driven, x2, y2)):
        depth = math.hypot(x, y) - bearing.clearance
        if depth > 0.0:
            k = math.pi * bearing.length / (2.0 * compliance)
            # d = depth s^2 makes the integrand smooth
            work = quad(
                lambda s, d=depth, b=bearing.clearance: s**4 / math.sqrt(2.0 * (b + d * s * s)),
                0.0,
                1.0,
                epsabs=0.0,
                epsrel=1e-13,
            )[0]
            elastic += 2.0 * k * depth**2.5 * work
    return kinetic + elastic - p.operation.drive_torque / r1 * u, kinetic + elastic


def energy_drift(step: float) -> float:
    """Largest change of the conserved energy in 20 ms over the largest vibration energy."""
    p = flat(
        QUIET,
        {
            "model": "compared",
            "mesh_geometry": "exact",
            "mesh_damping": "contact",
            "restitution_law": "exact",
            "mesh.damping_ratio": 0.0,
            "bearings.driving.restitution": 1.0,
            "bearings.driven.restitution": 1.0,
            "solver.step": step,
        },
    )
    engine = Engine(p)
    energies = [vibration_energy(p, engine.checkpoint().state)]
    for _ in range(200):
        engine.advance(10)
        energies.append(vibration_energy(p, engine.checkpoint().state))
    conserved, vibration = np.array(energies).T
    return float(np.abs(conserved - conserved[0]).max() / vibration.max())


def energy() -> Iterator[Measurement]:
    for step, tolerance in ((1e-6, 1e-6), (0.125e-6, 1e-8)):
        drift = energy_drift(step)
        what = f"undamped energy drift over 20 ms, {step * 1e6:g} us"
        yield Measurement(what, drift, 0.0, drift, tolerance)


class BacklashOscillator:
    """x'' + 2 * 0.05 x' + g(x) = 0.1 + 0.05 W^2 cos(W t), b = 1: two gears whose centres stand still.

    The static error is the excitation, x = q / b0; W = Z1 * set-point / natural frequency.
    """

    def __init__(self, start: float) -> None:
        half_backlash, stiffness = 25e-6, 3.0e8
        probe = flat(QUIET, {})
        r1, _ = base_radii(probe)
        teeth, inertia = probe.gears.driving.teeth, probe.gears.driving.inertia
        self.natural = math.sqrt(stiffness * 2.0 * r1**2 / inertia)
        self.per_speed = teeth / self.natural
        self.torque = 0.1 * stiffness * half_backlash * r1
        p = flat(
            {**QUIET, **PUBLISHED},
            {
                "model": "traditional",
                "mesh.stiffness": stiffness,
                "mesh.damping_ratio": 0.05,
                "mesh.error_cos": [0.05 * half_backlash],
                "operation.drive_torque": self.torque,
                "operation.load_torque": self.torque,
                "operation.speed": start / self.per_speed,
            },
        )
        self.interval = p.solver.sample_interval
        self.engine = Engine(p)
        self.engine._constants["per_mass"] = 0.0  # no parameter holds a centre still
        self.settle(start)

    def settle(self, frequency: float, time: float = 300.0) -> tuple[float, int]:
        """Settle at W = ``frequency`` for ``time`` radians, then measure (amplitude, flank changes)."""
        self.engine.command(Commands(self.torque, self.torque, frequency / self.per_speed))
        samples = round(time / self.natural / self.interval)
        before = self.engine.advance(samples).counters.flank_changes
        last = self.engine.advance(round(60.0 / self.natural / self.interval))
        return float(np.ptp(last["dte"])) / 2.0 / 25e-6, last.counters.flank_changes - before


def backlash_oscillator() -> Iterator[Measurement]:
    closed_form = 0.820631
    oscillator = BacklashOscillator(0.6)
    for frequency in np.arange(0.62, closed_form, 0.01):
        oscillator.settle(float(frequency))
    low, high = closed_form - 5e-5, closed_form + 5e-5
    while high - low > 2e-6:
        middle = 0.5 * (low + high)
        _, changes = oscillator.settle(middle, 600.0)
        low, high = (middle, high) if changes == 0 else (low, middle)
    yield absolute("backlash oscillator: contact loss starts at W", 0.5 * (low + high), closed_form, 1e-5)
    frequency = closed_form
    amplitude, _ = oscillator.settle(frequency)
    while True:
        frequency += 5e-4
        following, _ = oscillator.settle(frequency)
        if following > 2.0 * amplitude:
            break
        amplitude = following
    yield absolute("backlash oscillator: up-jump at W", frequency - 2.5e-4, 0.8275, 0.005)
    while True:
        frequency -= 5e-4
        amplitude, changes = oscillator.settle(frequency)
        if changes == 0:
            break
    yield absolute("backlash oscillator: down-jump at W", frequency + 2.5e-4, 0.70825, 0.005)


# Surface


def mean_magnitude(height: Callable[[Vector], Vector], shortest_wave: int) -> float:
    """Mean of |height| over a revolution: zeros by bisection, Gauss-Legendre between them."""
    grid = np.linspace(0.0, 2.0 * math.pi, 32 * shortest_wave + 1)
    values = height(grid)
    at = np.nonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)[0]
    low, high, rising = grid[at], grid[at + 1], values[at] < 0
    for _ in range(45):
        middle = 0.5 * (low + high)
        below = (height(middle) < 0) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    edges = np.unique(np.concatenate((grid[::16], low)))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    half = np.diff(edges) / 2.0
    points = edges[:-1, None] + half[:, None] * (1.0 + nodes)
    return float((np.abs(height(points.ravel()).reshape(points.shape)) @ weights) @ half / (2.0 * math.pi))


def surface() -> Iterator[Measurement]:
    for teeth in (23, 40, 41):
        profile = fractal_surface(
            teeth=teeth, roughness=0.8e-6, fractal_dimension=1.1, offset=0.0, scale=1.5, waves=8
        )
        mean = mean_magnitude(profile.height, int(profile.orders.max()))
        yield relative(f"mean magnitude of the surface, {teeth} teeth", 1e6 * mean, 0.8, 1e-8, "um")
    for dimension in (1.1, 1.5):
        profile = fractal_surface(
            teeth=40, roughness=0.8e-6, fractal_dimension=dimension, offset=0.0, scale=1.5, waves=8
        )
        count = 4096
        spectrum = np.abs(np.fft.rfft(profile.height(2.0 * math.pi * np.arange(count) / count))) ** 2
        orders = profile.orders
        slope = float(np.polyfit(np.log(orders), np.log(spectrum[orders] / orders), 1)[0])
        what = f"spectral slope of the surface, D = {dimension}"
        yield absolute(what, slope, -(5.0 - 2.0 * dimension), 0.02)


# Measures of chaos


def regular_and_chaotic_series() -> Iterator[Measurement]:
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    rotation = np.cos(2.0 * math.pi * golden * np.arange(1000))
    for name, series, reference in (
        ("logistic map, r = 3.55, period 8", logistic(3.55, 1000), 0.0),
        ("logistic map, r = 3.97, chaotic", logistic(3.97, 1000), 1.0),
        ("quasi-periodic rotation", rotation, 0.0),
    ):
        yield absolute(f"K of the 0-1 test, {name}", zero_one_test(series), reference, 0.05)


def exponents() -> Iterator[Measurement]:
    for separation in (1e-6, 1e-9):
        found = largest_exponent(LorenzPair(separation), 50_000, 0.2, separation, skip=50)
        yield relative(f"exponent of the Lorenz attractor, separation {separation:g}", found, 0.9056, 0.01)
    orbit = settled({**QUIET, **PUBLISHED, "model": "improved", "operation.speed": 184.0}, 200, 3000)
    expected = slowest_mode(orbit)
    for separation in (1e-5, 1e-6, 1e-7, 1e-8):
        pair = SeparatedPair(orbit.copy(), separation)
        found = largest_exponent(pair, 200, pair.interval, separation, skip=10)
        what = f"exponent at rest in the oil film, separation {separation:g}"
        yield relative(what, found, expected, 0.01, "1/s")


GROUPS: dict[str, Callable[[], Iterator[Measurement]]] = {
    "film_steady": film_steady,
    "film_moving": film_moving,
    "rotor": rotor,
    "restitution": restitution,
    "modes": modes,
    "static": static,
    "mean_mesh_force": mean_mesh_force,
    "energy": energy,
    "backlash_oscillator": backlash_oscillator,
    "surface": surface,
    "regular_and_chaotic_series": regular_and_chaotic_series,
    "exponents": exponents,
}
