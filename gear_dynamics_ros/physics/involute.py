"""Involute teeth: outlines of gears with standard proportions (F. L. Litvin, A. Fuentes, "Gear Geometry and
Applied Theory", 2004).

A tooth points along +x of its gear; angles are positive counter-clockwise. Lengths are in m.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

ADDENDUM: Final = 1.0  # modules from the reference circle to the tip
DEDENDUM: Final = 1.25  # modules from the reference circle to the root
FLANK_POINTS: Final = 12


def involute_function(angle: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """inv(angle) = tan(angle) - angle, rad; the shape of ``angle``."""
    return np.asarray(np.tan(angle) - angle)


class InvoluteGear(NamedTuple):
    """Dimensions of a spur gear without profile shift."""

    teeth: int
    module: float  # m
    pressure_angle: float  # rad, nominal

    @property
    def reference_radius(self) -> float:
        """Radius of the reference circle, m."""
        return 0.5 * self.module * self.teeth

    @property
    def base_radius(self) -> float:
        """Radius of the circle from which the flanks unwind, m."""
        return self.reference_radius * math.cos(self.pressure_angle)

    @property
    def tip_radius(self) -> float:
        """Radius of the tips, m; a tooth ends where its flanks meet at the latest."""
        wanted = self.reference_radius + ADDENDUM * self.module
        low, high = self.reference_radius, wanted
        if self.half_angle(np.array(wanted)) >= 0.0:
            return wanted
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.half_angle(np.array(middle)) >= 0.0 else (low, middle)
        return low

    @property
    def root_radius(self) -> float:
        """Radius between the teeth, m."""
        return self.reference_radius - DEDENDUM * self.module

    @property
    def pitch_angle(self) -> float:
        """Angle from tooth to tooth, rad."""
        return 2.0 * math.pi / self.teeth

    def half_angle(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Half the angle that a tooth without backlash spans at ``radius`` (m), rad; the shape of ``radius``.

        Below the base circle the flank goes straight to the centre.
        """
        cosine = np.minimum(self.base_radius / radius, 1.0)
        at_reference = 0.25 * self.pitch_angle + float(involute_function(self.pressure_angle))
        return np.asarray(at_reference - involute_function(np.arccos(cosine)))

    def flank(self, points: int = FLANK_POINTS) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Radii (m) of a flank from root to tip, and half the tooth's angle (rad) there; shapes (points,).

        More points lie near the base circle, where the flank bends most.
        """
        base, tip = max(self.base_radius, self.root_radius), self.tip_radius
        involute = base + (tip - base) * np.linspace(0.0, 1.0, points - 1) ** 2
        radii = np.concatenate([[min(self.root_radius, base)], involute])
        return radii, self.half_angle(radii)

    def narrowing_angle(self, clearance: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Angle by which each flank of this gear recedes, rad, so that a pair has ``clearance`` on each side.

        ``clearance`` (m) is half the backlash along the line of action, with the other gear narrowed
        alike.
        """
        return np.asarray(np.asarray(clearance) / (2.0 * self.base_radius))

    def tooth(self, narrowing: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Tooth outlines x + iy in m, each flank receded by ``narrowing`` (rad, shape (n,)).

        From the root of the trailing flank (negative angles) over the tip to the root of the other; shape
        (n, 2 FLANK_POINTS).
        """
        radii, half = self.flank()
        angle = half - np.asarray(narrowing)[..., None]
        upper = radii * np.exp(1j * angle)
        return np.concatenate([upper.conj(), upper[..., ::-1]], axis=-1)

    def outline(self, clearance: float) -> NDArray[np.complex128]:
        """Closed outline x + iy in m of the whole gear; the first tooth points along +x."""
        tooth = self.tooth(np.array([self.narrowing_angle(clearance)]).reshape(1))[0]
        turns = np.exp(1j * self.pitch_angle * np.arange(self.teeth))
        whole = (turns[:, None] * tooth).reshape(-1)
        return np.concatenate([whole, whole[:1]])
