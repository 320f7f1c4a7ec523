"""Fractal tooth surface: Weierstrass-Mandelbrot waves closed over one revolution, (16)-(18) and (23)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import MOST_WAVES_PER_REVOLUTION

SAMPLES_PER_WAVE = 64
ROOT_ITERATIONS = 40


class FractalProfile(NamedTuple):
    """Profile sum_j cosine_j cos(orders_j a) + sine_j sin(orders_j a); a is the gear's own angle in rad."""

    orders: NDArray[np.int64]  # waves per revolution
    cosine: NDArray[np.float64]  # m
    sine: NDArray[np.float64]  # m

    def height(self, angle: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Signed height in m at the gear's own angle in rad; the shape of ``angle``."""
        phases = np.multiply.outer(np.asarray(angle, dtype=np.float64), self.orders.astype(np.float64))
        return np.asarray(np.cos(phases) @ self.cosine + np.sin(phases) @ self.sine)


def fractal_surface(
    *, teeth: int, roughness: float, fractal_dimension: float, offset: float, scale: float, waves: int
) -> FractalProfile:
    """Profile of one gear, scaled so that the mean of |z| over a revolution is ``roughness`` (m).

    The frequencies scale^j per tooth are rounded to whole waves per revolution (half to even), so that the
    profile closes on the gear.
    """
    unit, magnitude = _unit_surface(teeth, fractal_dimension, offset, scale, waves)
    gain = roughness / magnitude
    return FractalProfile(unit.orders, gain * unit.cosine, gain * unit.sine)


# What a run changes is the roughness alone, and the mean takes longer than a chunk.
@lru_cache(maxsize=16)
def _unit_surface(
    teeth: int, fractal_dimension: float, offset: float, scale: float, waves: int
) -> tuple[FractalProfile, float]:
    """The sum without its scale, dimensionless, and the mean of its magnitude."""
    ladder = [scale**j for j in range(waves)]
    if teeth * ladder[-1] > MOST_WAVES_PER_REVOLUTION:
        raise UsageError(
            f"surface.waves = {waves} with surface.scale = {scale} puts {teeth * ladder[-1]:.3g} waves on a "
            f"revolution; the limit is {MOST_WAVES_PER_REVOLUTION}: lower one of them"
        )
    orders = np.array([round(teeth * factor) for factor in ladder], dtype=np.int64)
    weights = np.array([factor ** (fractal_dimension - 2.0) for factor in ladder])
    unit = FractalProfile(orders, weights * math.sin(offset), weights * math.cos(offset))
    return unit, mean_magnitude(unit)


def mean_magnitude(surface: FractalProfile) -> float:
    """Mean of |z| over one revolution in m, from the zeros of z and its antiderivative, exact to rounding.

    Two zeros closer than a 64th of the shortest wave may escape; the area between them does not matter.
    """
    count = SAMPLES_PER_WAVE * int(surface.orders.max())
    angles = np.linspace(0.0, 2.0 * math.pi, count + 1)
    heights = np.concatenate([surface.height(part) for part in np.array_split(angles, 1 + count // 65536)])
    crossings = np.flatnonzero((heights[:-1] < 0.0) != (heights[1:] < 0.0))
    zeros = _bisect(surface, angles[crossings], angles[crossings + 1])
    bounds = np.concatenate([[0.0], zeros, [2.0 * math.pi]])
    return float(np.abs(np.diff(_antiderivative(surface, bounds))).sum() / (2.0 * math.pi))


def _bisect(
    surface: FractalProfile, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    rises = surface.height(low) < 0.0
    for _ in range(ROOT_ITERATIONS):
        middle = 0.5 * (low + high)
        before = (surface.height(middle) < 0.0) == rises
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)


def _antiderivative(surface: FractalProfile, angle: NDArray[np.float64]) -> NDArray[np.float64]:
    orders = surface.orders.astype(np.float64)
    phases = np.multiply.outer(angle, orders)
    return np.asarray(np.sin(phases) @ (surface.cosine / orders) - np.cos(phases) @ (surface.sine / orders))
