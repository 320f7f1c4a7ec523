"""An independent referee: the model in plain Python, integrated by SciPy's DOP853 with every event located.

It shares no code with the package. It is written for reading, one formula a line, and for accuracy, not for
speed. Symbols are those of the model's documentation; SI units throughout.

Between events the contact flags (`Mode`) are frozen, so the right-hand side is smooth. Events are

* a gap closing or opening: either flank of the mesh, either bearing;
* a clamp acting or letting go inside a contact: a bearing force, or the mesh force (damping in contact).

Each is bracketed on DOP853's dense output, then reached by integrating afresh from the start of the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import acos, atan, atan2, cos, pi, sin, sqrt, tan, tanh
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

CHANNELS = (
    "time", "dte", "dte_rate", "mesh_force", "pressure_angle", "position_angle", "half_backlash",
    "meshing_state",
    "driving_x", "driving_y", "driven_x", "driven_y",
    "driving_contact_force_x", "driving_contact_force_y", "driven_contact_force_x", "driven_contact_force_y",
    "driving_film_force_x", "driving_film_force_y", "driven_film_force_x", "driven_film_force_y",
    "driving_penetration", "driven_penetration", "driving_speed", "driven_speed",
    "drive_torque", "load_torque",
    "driving_angle", "mesh_phase",
)  # fmt: skip

RTOL = 2e-12
# x1 y1 x2 y2, u, theta1, vx1 vy1 vx2 vy2, omega1 omega2
ATOL = np.array([1e-17] * 4 + [1e-17, 1e-13] + [1e-12] * 4 + [1e-10] * 2)
LOOKS = np.array([0.0, 1e-3, 0.25, 0.5, 0.75, 0.999, 1.0])  # at the events' values within one step
EVENTS_AT_ONCE = 20  # more at one instant would be a run that no longer moves

Vector = NDArray[np.float64]
Tree = Mapping[str, Any]


def load_case(path: Path) -> Tree:
    """Parameter tree of a ROS parameter file."""
    tree: Tree = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    return tree


def nested(flat: Mapping[str, Any]) -> Tree:
    """Dotted names -> tree."""
    tree: dict[str, Any] = {}
    for name, value in flat.items():
        branch = tree
        *path, leaf = name.split(".")
        for step in path:
            branch = branch.setdefault(step, {})
        branch[leaf] = value
    return tree


class Wave(NamedTuple):
    order: int  # waves a revolution
    frequency: float  # n_j, waves a tooth
    amplitude: float  # m
    phase: float


def mean_magnitude(waves: Sequence[Wave]) -> float:
    """Mean of |sum of waves| over one revolution, from its zeros and its antiderivative."""

    def height(angle: Vector) -> Vector:
        return sum((w.amplitude * np.sin(w.order * angle + w.phase) for w in waves), np.zeros_like(angle))

    def slope(angle: Vector) -> Vector:
        return sum(
            (w.amplitude * w.order * np.cos(w.order * angle + w.phase) for w in waves), np.zeros_like(angle)
        )

    def integral(angle: Vector) -> Vector:
        return sum(
            (-w.amplitude / w.order * np.cos(w.order * angle + w.phase) for w in waves), np.zeros_like(angle)
        )

    grid = np.linspace(0.0, 2.0 * pi, 64 * max(w.order for w in waves) + 1)
    values = height(grid)
    crossing = np.nonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))[0]
    low, high = grid[crossing], grid[crossing + 1]
    roots = low - values[crossing] * (high - low) / (values[crossing + 1] - values[crossing])
    for _ in range(4):
        roots = np.clip(roots - height(roots) / slope(roots), low, high)
    edges = np.concatenate(([0.0], roots, [2.0 * pi]))
    return float(np.abs(np.diff(integral(edges))).sum() / (2.0 * pi))


def surface_waves(side: Tree, scale: float, count: int, teeth: int) -> list[Wave]:
    """W-M profile of one gear: (16)-(18)."""
    waves = []
    for j in range(count):
        order = round(teeth * scale**j)
        amplitude = scale ** ((side["fractal_dimension"] - 2.0) * j)
        waves.append(Wave(order, order / teeth, amplitude, side["offset"]))
    if side["roughness"] == 0.0:
        return []
    factor = side["roughness"] / mean_magnitude(waves)
    return [wave._replace(amplitude=factor * wave.amplitude) for wave in waves]


def damping_factor(eta: float, law: str) -> float:
    """Factor a of the damping term 1 + a ddelta / v_impact."""
    if law == "lankarani_nikravesh":
        return 0.75 * (1.0 - eta**2)
    if eta == 1.0:
        return 0.0

    def residual(a: float) -> float:
        return a - math.log1p(a) + a * eta + math.log1p(-a * eta)

    return float(brentq(residual, 1e-9 * (1.0 - eta), (1.0 - 1e-15) / eta, xtol=1e-16, rtol=1e-15))


class Harmonics(NamedTuple):
    """mean + sum_h cosine_h cos(h phi) + sine_h sin(h phi)."""

    mean: float
    cosine: tuple[float, ...]
    sine: tuple[float, ...]

    def value(self, phi: float) -> float:
        terms = [c * cos(h * phi) for h, c in enumerate(self.cosine, 1)]
        terms += [s * sin(h * phi) for h, s in enumerate(self.sine, 1)]
        return self.mean + sum(terms)

    def slope(self, phi: float) -> float:
        terms = [-h * c * sin(h * phi) for h, c in enumerate(self.cosine, 1)]
        terms += [h * s * cos(h * phi) for h, s in enumerate(self.sine, 1)]
        return sum(terms)


class Bearing(NamedTuple):
    clearance: float  # b_b
    length: float
    diameter: float
    oil_clearance: float  # C
    stiffness: float  # Kelvin
    damping: float  # Kelvin
    restitution_factor: float  # a


@dataclass
class Mode:
    """The flags that are frozen between events."""

    flank: int = 0  # 1 drive, 0 apart, -1 back
    mesh_clamped: bool = False
    contact: list[bool] = field(default_factory=lambda: [False, False])
    clamped: list[bool] = field(default_factory=lambda: [False, False])
    impact_speed: list[float] = field(default_factory=lambda: [0.0, 0.0])


class Mesh(NamedTuple):
    """Everything about the mesh at one instant."""

    alpha: float
    beta: float
    q: float
    q_rate: float
    b1: float
    b1_rate: float
    k1: float
    phi: float


class Event(NamedTuple):
    """A switching surface of the mode in force: it is met when `value` turns negative."""

    name: str
    value: Callable[[float, Vector], float]
    apply: Callable[[float, Vector], None]


def film_force(
    x: float, y: float, vx: float, vy: float, w: float, bearing: Bearing, viscosity: float, limit: float
) -> tuple[float, float]:
    """Short-bearing oil film after Capone, N on the journal; w is the signed shaft speed."""
    C = bearing.oil_clearance
    ex, ey, ux, uy = x / C, y / C, vx / C, vy / C
    eps = sqrt(ex * ex + ey * ey)
    if eps > limit:
        ex, ey, eps = ex * limit / eps, ey * limit / eps, limit
    s = 1.0 - eps * eps
    A = w * ex - 2.0 * uy
    B = w * ey + 2.0 * ux
    m = sqrt(A * A + B * B)
    if m == 0.0:
        return 0.0, 0.0
    cos_al, sin_al = -A / m, -B / m
    h = ey * cos_al - ex * sin_al
    G = 2.0 / sqrt(s) * (pi / 2.0 + atan(h / sqrt(s)))
    V = (2.0 + h * G) / s
    c = ex * cos_al + ey * sin_al
    S = c / (1.0 - c * c)
    unit = viscosity * (bearing.diameter / 2.0) * bearing.length**3 / (4.0 * C**2) * (m / s)
    fx = -unit * (3.0 * ex * V - sin_al * G - 2.0 * cos_al * S)
    fy = -unit * (3.0 * ey * V + cos_al * G - 2.0 * sin_al * S)
    return fx, fy


def dip(
    event: Event, dense: Callable[[float], Vector], times: Sequence[float], values: Sequence[float]
) -> tuple[float, float]:
    """Lowest value of `event`, and when, about the second of three times if it can reach zero there."""
    (before, at, after), (left, middle, right) = times, values
    if not before < at < after:
        return middle, at
    steepest = max((left - middle) / (at - before), (right - middle) / (after - at))
    if middle > min(left, right) or middle > steepest * (after - before):
        return middle, at
    inner = minimize_scalar(
        lambda t: event.value(t, dense(t)),
        bounds=(before, after),
        method="bounded",
        options={"xatol": 1e-4 * (at - before)},
    )
    return min((middle, at), (float(inner.fun), float(inner.x)))


class Referee:
    """One run of the model from its start; `tree` is the nested parameter tree."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        gears, mesh, operation = tree["gears"], tree["mesh"], tree["operation"]
        self.Z1, self.Z2 = gears["driving"]["teeth"], gears["driven"]["teeth"]
        self.m1, self.m2 = gears["driving"]["mass"], gears["driven"]["mass"]
        self.J1, self.J2 = gears["driving"]["inertia"], gears["driven"]["inertia"]
        self.alpha0 = gears["pressure_angle"]
        self.a_s = gears["module"] * (self.Z1 + self.Z2) / 2.0
        self.r1 = gears["module"] * self.Z1 * cos(self.alpha0) / 2.0
        self.r2 = gears["module"] * self.Z2 * cos(self.alpha0) / 2.0
        self.R = self.r1 + self.r2
        self.b0 = gears["backlash"] / 2.0
        self.k_m = mesh["stiffness"]
        self.stiffness = Harmonics(1.0, tuple(mesh["stiffness_cos"]), tuple(mesh["stiffness_sin"]))
        self.error = Harmonics(mesh["error_mean"], tuple(mesh["error_cos"]), tuple(mesh["error_sin"]))
        effective = self.J1 * self.J2 / (self.r1**2 * self.J2 + self.r2**2 * self.J1)
        self.c1 = 2.0 * mesh["damping_ratio"] * sqrt(self.k_m * effective)
        surface = tree["surface"]
        self.surfaces = [
            surface_waves(surface[side], surface["scale"], surface["waves"], gears[side]["teeth"])
            for side in ("driving", "driven")
        ]
        self.bearings = [self._bearing(tree, side) for side in ("driving", "driven")]
        shaft, sleeve = tree["bearings"]["shaft"], tree["bearings"]["sleeve"]
        compliance = (1.0 - shaft["poissons_ratio"] ** 2) / shaft["youngs_modulus"]
        compliance += (1.0 - sleeve["poissons_ratio"] ** 2) / sleeve["youngs_modulus"]
        self.hertz = pi / (2.0 * compliance)
        self.v_min = tree["bearings"]["minimum_impact_speed"]
        self.traditional, self.film = tree["model"] == "traditional", tree["model"] == "improved"
        self.exact_geometry = tree["mesh_geometry"] == "exact"
        self.contact_damping = tree["mesh_damping"] == "contact"
        self.actual_phase = tree["mesh_phase"] == "actual"
        self.speed = operation["speed"]
        self.load_torque = operation["load_torque"]
        self.drive_torque = operation["drive_torque"]
        self.governed = operation["control"] == "speed"
        self.governor_integral = operation["drive_torque"]
        self.brake = operation.get("load_law", "constant") == "brake"
        self.load_viscous = operation.get("load_viscous", 0.0)
        self.interval = tree["solver"]["sample_interval"]
        self.events: list[tuple[float, str]] = []
        self._start()

    @staticmethod
    def _bearing(tree: Tree, side: str) -> Bearing:
        b = tree["bearings"][side]
        return Bearing(
            b["clearance"], b["length"], b["diameter"], b["oil_clearance"],
            b["kelvin_stiffness"], b["kelvin_damping"],
            damping_factor(b["restitution"], tree["restitution_law"]),
        )  # fmt: skip

    def _start(self) -> None:
        """`initial: touching` or `rest`: q = b1, centres at rest in the middle."""
        rest = self.tree["operation"]["initial"] == "rest"
        omega1 = 0.0 if rest else self.speed
        self.t = 0.0
        self.mode = Mode()
        self.y = np.array([0.0] * 10 + [omega1, omega1 * self.r1 / self.r2])
        at = self.mesh(0.0, self.y)
        self.y[4] = at.b1 - at.q
        at = self.mesh(0.0, self.y)
        self.mode.flank = 1 if at.q_rate - at.b1_rate > 0.0 else 0
        self.step = 1e-7

    def phase(self, t: float, y: Sequence[float]) -> tuple[float, float]:
        """phi and its rate; theta1 is never wrapped here, so its revolutions need no count."""
        if self.actual_phase:
            return self.Z1 * y[5], self.Z1 * y[10]
        return self.Z1 * self.speed * t, self.Z1 * self.speed

    def mesh(self, t: float, state: Vector) -> Mesh:
        x1, y1, x2, y2, u, _, vx1, vy1, vx2, vy2, omega1, omega2 = y = state.tolist()
        phi, phi_rate = self.phase(t, y)
        dx, dy, vx, vy = self.a_s + x2 - x1, y2 - y1, vx2 - vx1, vy2 - vy1
        a = sqrt(dx * dx + dy * dy)
        a_rate = (dx * vx + dy * vy) / a
        alpha = acos(self.R / a)
        alpha_rate = self.R * a_rate / (a * sqrt(a * a - self.R * self.R))
        beta = atan2(dy, dx)
        beta_rate = (dx * vy - dy * vx) / (a * a)
        z = z_rate = 0.0
        for waves in self.surfaces:
            for _, frequency, amplitude, offset in waves:
                z += amplitude * sin(frequency * phi + offset)
                z_rate += amplitude * frequency * cos(frequency * phi + offset) * phi_rate
        involute = (tan(alpha) - alpha) - (tan(self.alpha0) - self.alpha0)
        b1 = self.R * involute + self.b0 - z / 2.0
        b1_rate = self.R * tan(alpha) ** 2 * alpha_rate - z_rate / 2.0
        e, e_rate = self.error.value(phi), self.error.slope(phi) * phi_rate
        u_rate = self.r1 * omega1 - self.r2 * omega2
        if self.exact_geometry:
            q = u - self.R * beta - e
            q_rate = u_rate - self.R * beta_rate - e_rate
        else:
            gamma, gamma_rate = alpha - beta, alpha_rate - beta_rate
            sg, cg = sin(gamma), cos(gamma)
            q = u + (x1 - x2) * sg + (y1 - y2) * cg - e
            q_rate = u_rate - vx * sg - vy * cg + ((x1 - x2) * cg - (y1 - y2) * sg) * gamma_rate - e_rate
        return Mesh(alpha, beta, q, q_rate, b1, b1_rate, self.k_m * self.stiffness.value(phi), phi)

    def raw_mesh_force(self, at: Mesh, flank: int) -> float:
        """F_p before its clamp."""
        g = at.q - flank * at.b1 if flank else 0.0
        if not self.contact_damping:
            return at.k1 * g + self.c1 * at.q_rate
        return at.k1 * g + self.c1 * (at.q_rate - flank * at.b1_rate) if flank else 0.0

    def mesh_force(self, at: Mesh) -> float:
        return 0.0 if self.mode.mesh_clamped else self.raw_mesh_force(at, self.mode.flank)

    def direction(self, at: Mesh) -> tuple[float, float]:
        """Unit vector of the force on gear 2 for F_p = 1."""
        if self.exact_geometry and self.mode.flank < 0:
            return -sin(at.alpha + at.beta), cos(at.alpha + at.beta)
        return sin(at.alpha - at.beta), cos(at.alpha - at.beta)

    def gap(self, i: int, y: Sequence[float]) -> tuple[float, float, float, float]:
        """delta, its rate and the unit vector n of bearing i."""
        x, yy, vx, vy = y[2 * i], y[2 * i + 1], y[6 + 2 * i], y[7 + 2 * i]
        d = sqrt(x * x + yy * yy)
        if d == 0.0:
            return -self.bearings[i].clearance, 0.0, 0.0, 0.0
        return d - self.bearings[i].clearance, (x * vx + yy * vy) / d, x / d, yy / d

    def bearing_switch(self, i: int, delta: float, rate: float) -> float:
        """Negative where the contact force of bearing i would pull."""
        b = self.bearings[i]
        if self.traditional:
            return b.stiffness * delta + b.damping * rate
        return 1.0 + b.restitution_factor * rate / self.mode.impact_speed[i]

    def contact_force(self, i: int, y: Sequence[float]) -> tuple[float, float]:
        if not self.mode.contact[i] or self.mode.clamped[i]:
            return 0.0, 0.0
        b = self.bearings[i]
        delta, rate, nx, ny = self.gap(i, y)
        force = self.bearing_switch(i, delta, rate)
        if not self.traditional:
            delta = max(delta, 0.0)
            force *= self.hertz * b.length * sqrt(1.0 / (2.0 * (b.clearance + delta))) * delta**1.5
        return -force * nx, -force * ny

    def oil_force(self, i: int, y: Sequence[float]) -> tuple[float, float]:
        if not self.film:
            return 0.0, 0.0
        if self.actual_phase:
            w = y[10] if i == 0 else -y[11]
        else:
            w = self.speed if i == 0 else -self.speed * self.r1 / self.r2
        oil = self.tree["oil"]
        return film_force(
            y[2 * i], y[2 * i + 1], y[6 + 2 * i], y[7 + 2 * i], w, self.bearings[i],
            oil["viscosity"], oil["eccentricity_limit"],
        )  # fmt: skip

    def load(self, omega2: float) -> float:
        steady = self.load_torque * tanh(omega2) if self.brake else self.load_torque
        return float(steady + self.load_viscous * omega2)

    def derivative(self, t: float, state: Vector) -> list[float]:
        y = state.tolist()
        at = self.mesh(t, state)
        F = self.mesh_force(at)
        dx, dy = self.direction(at)
        (bx1, by1), (bx2, by2) = self.contact_force(0, y), self.contact_force(1, y)
        (ox1, oy1), (ox2, oy2) = self.oil_force(0, y), self.oil_force(1, y)
        return [
            *y[6:10],
            self.r1 * y[10] - self.r2 * y[11],
            y[10],
            (-F * dx + bx1 + ox1) / self.m1,
            (-F * dy + by1 + oy1) / self.m1,
            (F * dx + bx2 + ox2) / self.m2,
            (F * dy + by2 + oy2) / self.m2,
            (self.drive_torque - F * self.r1) / self.J1,
            (-self.load(y[11]) + F * self.r2) / self.J2,
        ]

    def switches(self) -> list[Event]:
        """The switching surfaces of the mode in force, each positive on the side where the mode holds."""
        found = []
        flank = self.mode.flank
        if flank == 0:
            found.append(
                Event("drive flank meets", lambda t, y: -self._flank_gap(t, y, 1), self._to_flank(1))
            )
            found.append(
                Event("back flank meets", lambda t, y: -self._flank_gap(t, y, -1), self._to_flank(-1))
            )
        else:
            found.append(Event("flank leaves", lambda t, y: self._flank_gap(t, y, flank), self._to_flank(0)))
        if flank and self.contact_damping:
            sign = -1.0 if self.mode.mesh_clamped else 1.0

            def pull(t: float, y: Vector) -> float:
                return sign * flank * self.raw_mesh_force(self.mesh(t, y), flank)

            found.append(Event("mesh clamp", pull, self._toggle_mesh_clamp))
        for i in (0, 1):
            found += self._bearing_switches(i)
        return found

    def _bearing_switches(self, i: int) -> list[Event]:
        if not self.mode.contact[i]:
            return [Event(f"bearing {i} strikes", lambda t, y: -self.gap(i, y)[0], self._strike(i))]
        sign = -1.0 if self.mode.clamped[i] else 1.0
        return [
            Event(f"bearing {i} leaves", lambda t, y: self.gap(i, y)[0], self._leave(i)),
            Event(
                f"bearing {i} clamp",
                lambda t, y: sign * self.bearing_switch(i, *self.gap(i, y)[:2]),
                self._toggle_clamp(i),
            ),
        ]

    def _flank_gap(self, t: float, y: Vector, flank: int) -> float:
        at = self.mesh(t, y)
        return flank * at.q - at.b1

    def _to_flank(self, flank: int) -> Callable[[float, Vector], None]:
        def apply(t: float, y: Vector) -> None:
            self.mode.flank, self.mode.mesh_clamped = flank, False

        return apply

    def _toggle_mesh_clamp(self, t: float, y: Vector) -> None:
        self.mode.mesh_clamped = not self.mode.mesh_clamped

    def _strike(self, i: int) -> Callable[[float, Vector], None]:
        def apply(t: float, y: Vector) -> None:
            self.mode.contact[i], self.mode.clamped[i] = True, False
            self.mode.impact_speed[i] = max(self.gap(i, y)[1], self.v_min)

        return apply

    def _leave(self, i: int) -> Callable[[float, Vector], None]:
        def apply(t: float, y: Vector) -> None:
            self.mode.contact[i] = self.mode.clamped[i] = False

        return apply

    def _toggle_clamp(self, i: int) -> Callable[[float, Vector], None]:
        def apply(t: float, y: Vector) -> None:
            self.mode.clamped[i] = not self.mode.clamped[i]

        return apply

    def advance(self, end: float) -> None:
        """Integrate to time `end`, all events located."""
        while self.t < end:
            solver = DOP853(
                self.derivative,
                self.t,
                self.y,
                end,
                rtol=RTOL,
                atol=ATOL,
                first_step=min(self.step, end - self.t),
            )
            while solver.status == "running":
                solver.step()
                event, when = self._first_event(solver)
                if event is not None:
                    self._stop_at(event, solver.t_old, self.y, when)
                    break
                self.t, self.y = solver.t, solver.y
                if solver.status == "running":
                    self.step = solver.h_abs
            if solver.status == "failed":
                raise RuntimeError(f"DOP853 failed at t = {solver.t}")

    def _first_event(self, solver: DOP853) -> tuple[Event | None, float]:
        """The event met first in the solver's last step, and when."""
        dense = solver.dense_output()
        times = solver.t_old + LOOKS * (solver.t - solver.t_old)
        states = [dense(t) for t in times]
        first, earliest = None, math.inf
        for switch in self.switches():
            values = [switch.value(t, y) for t, y in zip(times, states, strict=True)]
            low, high = self._overstepped(switch, dense, times, values)
            if high < math.inf and low < earliest:
                when = self._crossing(switch, dense, low, high)
                if when < earliest:
                    first, earliest = switch, when
        return first, earliest

    @staticmethod
    def _overstepped(
        event: Event, dense: Callable[[float], Vector], times: Vector, values: Sequence[float]
    ) -> tuple[float, float]:
        """Times between which `event` is met first: the last one known before it, the first one past it."""
        for i in range(1, len(times)):
            if i > 1:
                lowest, when = dip(event, dense, times[i - 2 : i + 1], values[i - 2 : i + 1])
                if lowest < 0.0:
                    return float(times[i - 2]), when
            if values[i] < 0.0:
                return float(times[i - 1]), float(times[i])
        return math.inf, math.inf

    @staticmethod
    def _crossing(event: Event, dense: Callable[[float], Vector], low: float, high: float) -> float:
        def value(t: float) -> float:
            return event.value(t, dense(t))

        if value(low) <= 0.0:  # an event that has just been applied, or falls together with it
            return low
        return float(brentq(value, low, high, xtol=1e-22, rtol=1e-15))

    def _stop_at(self, event: Event, t0: float, y0: Vector, when: float) -> None:
        """Integrate from (t0, y0) to the root of `event`, apply it and whatever falls together with it."""
        y = self._integrate(t0, y0, when)
        for _ in range(2):  # the dense output leaves little: Newton with a difference quotient
            if when <= t0:
                break
            ahead = self._integrate(t0, y0, when + 1e-12)
            value = event.value(when, y)
            slope = (event.value(when + 1e-12, ahead) - value) / 1e-12
            if slope >= 0.0 or abs(value / slope) > 1e-9:
                break
            when -= value / slope
            y = self._integrate(t0, y0, when)
        self.t, self.y = when, y
        if len(self.events) >= EVENTS_AT_ONCE and self.events[-EVENTS_AT_ONCE][0] == when:
            raise RuntimeError(f"{EVENTS_AT_ONCE} events at t = {when}, the last: {event.name}")
        event.apply(when, y)
        self.events.append((when, event.name))
        for i in (0, 1):  # a gap that closes at the same instant would never be seen to close
            delta, rate, *_ = self.gap(i, y.tolist())
            if delta > 0.0 and rate > 0.0 and not self.mode.contact[i]:
                self._strike(i)(when, y)
                self.events.append((when, f"bearing {i} strikes"))

    def _integrate(self, t0: float, y0: Vector, t1: float) -> Vector:
        if t1 <= t0:
            return y0
        solver = DOP853(self.derivative, t0, y0, t1, rtol=RTOL, atol=ATOL, first_step=t1 - t0)
        while solver.status == "running":
            solver.step()
        return np.array(solver.y)

    def govern(self) -> None:
        """PI governor, once a sample, on omega1; the integral stands still while the torque is clipped."""
        if not self.governed:
            return
        governor = self.tree["operation"]["governor"]
        error = self.speed - self.y[10]
        wanted = governor["proportional"] * error + self.governor_integral
        limit = governor["torque_limit"]
        self.drive_torque = min(max(wanted, -limit), limit)
        if self.drive_torque == wanted:
            self.governor_integral += governor["integral"] * error * self.interval

    def sample(self) -> list[float]:
        y = self.y.tolist()
        at = self.mesh(self.t, self.y)
        return [
            self.t, at.q, at.q_rate, self.mesh_force(at), at.alpha, at.beta, at.b1, float(self.mode.flank),
            *y[:4], *self.contact_force(0, y), *self.contact_force(1, y),
            *self.oil_force(0, y), *self.oil_force(1, y),
            self.gap(0, y)[0], self.gap(1, y)[0], y[10], y[11], self.drive_torque, self.load(y[11]),
            y[5] % (2.0 * pi), at.phi % (2.0 * pi),
        ]  # fmt: skip

    def run(self, samples: int) -> Vector:
        """The next `samples` samples, shape (samples, 28), columns as CHANNELS."""
        rows = []
        first = round(self.t / self.interval)
        for k in range(first, first + samples):
            self.govern()
            rows.append(self.sample())
            self.advance((k + 1) * self.interval)
        return np.array(rows)


class Unseeing(Referee):
    """A run that overlooks one event within a window of time, and keeps how far its surface was overstepped.

    What it keeps is a smooth function of every parameter on both sides of a contact that just touches, so
    that such a run can be found by the secant method.
    """

    def __init__(self, tree: Tree, overlooked: str, window: tuple[float, float]) -> None:
        self.overlooked, self.window = overlooked, window
        self.lowest = math.inf
        super().__init__(tree)

    def _in_window(self) -> bool:
        return self.window[0] <= self.t < self.window[1]

    def switches(self) -> list[Event]:
        return [s for s in super().switches() if s.name != self.overlooked or not self._in_window()]

    def _first_event(self, solver: DOP853) -> tuple[Event | None, float]:
        event, when = super()._first_event(solver)
        start, end = max(solver.t_old, self.window[0]), min(solver.t, when)
        surface = next((s for s in super().switches() if s.name == self.overlooked), None)
        if surface is not None and self._in_window() and end > start:
            dense = solver.dense_output()
            times = start + LOOKS * (end - start)
            values = [surface.value(t, dense(t)) for t in times]
            dips = [
                dip(surface, dense, times[i - 1 : i + 2], values[i - 1 : i + 2])[0]
                for i in range(1, len(times) - 1)
            ]
            self.lowest = min(self.lowest, *values, *dips)
        return event, when


def clearest(tree: Tree, event: str, window: tuple[float, float]) -> float:
    """How close a run comes to `event` within `window`: negative where it oversteps the surface."""
    run = Unseeing(tree, event, window)
    run.advance(window[0])
    run.advance(window[1])
    return run.lowest
