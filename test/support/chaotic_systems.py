"""Systems whose exponents and regimes are known: the logistic map, a linear oscillator, Lorenz' attractor."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def logistic(rate: float, count: int) -> Vector:
    """x' = r x (1 - x) after a thousand iterations."""
    x, values = 0.3, []
    for _ in range(1000 + count):
        x = rate * x * (1.0 - x)
        values.append(x)
    return np.array(values[1000:])


class LinearPair:
    """x'' + 2 D w x' + w^2 x = cos t and a copy, in closed form over an interval."""

    def __init__(self, damping: float, frequency: float, interval: float, separation: float) -> None:
        matrix = np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]])
        values, vectors = np.linalg.eig(matrix.astype(complex))
        self._flow = (vectors * np.exp(interval * values) @ np.linalg.inv(vectors)).real
        self._forced = np.linalg.inv(1j * np.eye(2) - matrix) @ np.array([0.0, 1.0])
        self._interval, self._time = interval, 0.0
        self.reference = np.array([1.0, -0.4])
        self.copy = self.reference + separation * np.array([0.6, 0.8])

    def forced(self) -> Vector:
        return (self._forced * np.exp(1j * self._time)).real

    def advance(self) -> None:
        before = self.forced()
        self._time += self._interval
        self.reference = self.forced() + self._flow @ (self.reference - before)
        self.copy = self.forced() + self._flow @ (self.copy - before)

    def distance(self) -> float:
        return float(np.linalg.norm(self.copy - self.reference))

    def rescale(self, distance: float) -> bool:
        self.copy = self.reference + distance / self.distance() * (self.copy - self.reference)
        return True


@numba.njit
def lorenz_rate(x: float, y: float, z: float) -> tuple[float, float, float]:
    return 10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z


@numba.njit
def lorenz_flow(start: Vector, step: float, steps: int) -> Vector:
    """Runge-Kutta of fourth order."""
    x, y, z = start[0], start[1], start[2]
    half = 0.5 * step
    for _ in range(steps):
        ax, ay, az = lorenz_rate(x, y, z)
        bx, by, bz = lorenz_rate(x + half * ax, y + half * ay, z + half * az)
        cx, cy, cz = lorenz_rate(x + half * bx, y + half * by, z + half * bz)
        dx, dy, dz = lorenz_rate(x + step * cx, y + step * cy, z + step * cz)
        x += step / 6.0 * (ax + 2.0 * bx + 2.0 * cx + dx)
        y += step / 6.0 * (ay + 2.0 * by + 2.0 * cy + dy)
        z += step / 6.0 * (az + 2.0 * bz + 2.0 * cz + dz)
    return np.array([x, y, z])


class LorenzPair(LinearPair):
    """The attractor of E. Lorenz (1963) and a copy; can be rescaled every ``patience`` intervals only."""

    def __init__(self, separation: float, patience: int = 1) -> None:
        self.reference = lorenz_flow(np.array([1.0, 2.0, 20.0]), 0.005, 10_000)
        self.copy = self.reference + np.array([separation, 0.0, 0.0])
        self._patience, self._waited = patience, 0

    def advance(self) -> None:
        self.reference = lorenz_flow(self.reference, 0.005, 40)
        self.copy = lorenz_flow(self.copy, 0.005, 40)

    def rescale(self, distance: float) -> bool:
        self._waited += 1
        if self._waited % self._patience:
            return False
        return super().rescale(distance)
