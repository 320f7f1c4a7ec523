"""Oil film, (8)-(15): short bearing, see "Oil film" in docs/model.md, whose letters are used here."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.lanes import any_negative, at_least, both, load2, square_root
from gear_dynamics_ros.physics.kernel.records import TINY, KernelRecord, Motion, Pair
from gear_dynamics_ros.physics.kernel.series import arctangent


class FilmForces(NamedTuple):
    """Both bearings' films."""

    force_x: Pair  # N, on the gear, F_o
    force_y: Pair
    margin: Pair  # eps_max^2 - eps^2; its negative while the film is at its limit
    margin_rate: Pair  # 1/s


@inlined
def capone_film(coefficient: Any, w: Any, ex: Any, ey: Any, ex_rate: Any, ey_rate: Any) -> tuple[Any, Any]:
    """Capone's short-bearing film (9)-(15): force on the shaft (x, y) in N; of one bearing or of both.

    ``coefficient`` mu (D/2) L^3 / (4 C^2) in N s, ``w`` signed shaft speed in rad/s; ``ex``, ``ey``
    eccentricity (dimensionless, below 1) and ``ex_rate``, ``ey_rate`` velocity (1/s), both divided by the
    radial clearance C.
    """
    a = w * ex - 2.0 * ey_rate
    b = w * ey + 2.0 * ex_rate
    m = square_root(a * a + b * b)
    inverse_m = 1.0 / at_least(m, TINY)
    inverse_root = 1.0 / square_root(1.0 - (ex * ex + ey * ey))
    inverse_s = inverse_root * inverse_root
    cos_tilde, sin_tilde = -a * inverse_m, -b * inverse_m
    mh = ex * b - ey * a
    g = 2.0 * inverse_root * (0.5 * math.pi + arctangent(mh * (inverse_m * inverse_root)))
    v = (2.0 + mh * inverse_m * g) * inverse_s
    c = ex * cos_tilde + ey * sin_tilde
    big_s = c / (1.0 - c * c)
    f = -coefficient * m * inverse_s
    return (
        f * (3.0 * ex * v - sin_tilde * g - 2.0 * cos_tilde * big_s),
        f * (3.0 * ey * v + cos_tilde * g - 2.0 * sin_tilde * big_s),
    )


@compiled
def held_eccentricity(constants: KernelRecord, state: KernelRecord, gear: int, eps2: float) -> float:
    """Factor that shortens the eccentricity of a journal beyond the film's limit to it.

    ``eps2`` is the eccentricity squared, dimensionless.

    Before that event is located a trial step may overshoot the limit, yet never the wall.
    """
    limit2 = constants.eccentricity_limit2
    if state.film_limited[gear] == 0.0:
        limit2 = 0.5 * (1.0 + limit2)
        if eps2 <= limit2:
            return 1.0
    return math.sqrt(limit2 / eps2)


@inlined
def film_forces(constants: KernelRecord, state: KernelRecord, motion: Motion) -> FilmForces:
    """Oil films (9)-(15) of both bearings, flags frozen; gear 2 turns the other way."""
    per_c = load2(constants.per_oil_clearance, 0)
    w = both(motion.omega[0], -motion.omega[1])
    if constants.nominal_phase:
        w = state.speed * both(1.0, -constants.base_radius[0] / constants.base_radius[1])
    ex, ey = motion.x * per_c, motion.y * per_c
    ex_rate, ey_rate = motion.vx * per_c, motion.vy * per_c
    eps2 = ex * ex + ey * ey
    margin = constants.eccentricity_limit2 - eps2
    margin_rate = -2.0 * (ex * ex_rate + ey * ey_rate)
    film_limited = load2(state.film_limited, 0)
    if any_negative(margin) or any_negative(-film_limited):
        margin = margin * (1.0 - 2.0 * film_limited)
        margin_rate = margin_rate * (1.0 - 2.0 * film_limited)
        held = both(
            held_eccentricity(constants, state, 0, eps2[0]), held_eccentricity(constants, state, 1, eps2[1])
        )
        ex, ey = ex * held, ey * held
    force_x, force_y = capone_film(load2(constants.film_factor, 0), w, ex, ey, ex_rate, ey_rate)
    return FilmForces(force_x, force_y, margin, margin_rate)
