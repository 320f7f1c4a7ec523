"""The validation table at its tolerances, and the film and impact laws wherever their arguments may lie."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.physics.kernel.film import capone_film
from gear_dynamics_ros.physics.restitution import damping_factor
from support.measurements import GROUPS, delivered_restitution, film_by_quadrature, ocvirk


@pytest.mark.parametrize("group", GROUPS)
def test_validation_table(group: str) -> None:
    missed = [m for m in GROUPS[group]() if not m.holds]
    assert not missed, "\n".join(str(m) for m in missed)


angles = st.floats(-math.pi, math.pi)


@given(st.floats(1e-6, 0.98), angles, st.floats(0.1, 5000.0))
def test_steady_film_is_ocvirk_at_any_angle(eps: float, angle: float, w: float) -> None:
    fx, fy = capone_film(1.0, w, eps * math.cos(angle), eps * math.sin(angle), 0.0, 0.0)
    radial = -(fx * math.cos(angle) + fy * math.sin(angle))
    across = -fx * math.sin(angle) + fy * math.cos(angle)
    magnitude, attitude = ocvirk(eps)
    assert math.hypot(fx, fy) == pytest.approx(w * magnitude, rel=1e-12)
    assert math.atan2(abs(across), radial) == pytest.approx(attitude, abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 0.95), angles, st.floats(1e-3, 3.0), angles, st.sampled_from([1.0, -1.0]))
def test_moving_film_is_the_pressure_integral(
    eps: float, angle: float, v: float, way: float, w: float
) -> None:
    ex, ey = eps * math.cos(angle), eps * math.sin(angle)
    ux, uy = v * math.cos(way), v * math.sin(way)
    assume(math.hypot(w * ex - 2.0 * uy, w * ey + 2.0 * ux) > 1e-3)
    measured = capone_film(1.0, w, ex, ey, ux, uy)
    # a shaft that turns the other way is the same bearing seen in a mirror
    fx, fy = film_by_quadrature(ex, w * ey, ux, w * uy)
    assert math.dist(measured, (fx, w * fy)) <= 1e-8 * math.hypot(fx, fy)


def test_film_at_rest_carries_nothing() -> None:
    assert capone_film(1.0, 0.0, 0.5, 0.1, 0.0, 0.0) == (0.0, 0.0)


@given(st.floats(0.05, 1.0))
def test_factor_of_the_exact_law_keeps_the_force_from_pulling(eta: float) -> None:
    assert 0.0 <= damping_factor(eta, "exact") < 1.0 / eta


@given(st.floats(0.05, 1.0))
def test_exact_law_delivers_its_restitution(eta: float) -> None:
    a = damping_factor(eta, "exact")
    assume(a > 1e-6)  # below, the referee's formula itself is only rounding
    assert delivered_restitution(a) == pytest.approx(eta, abs=1e-6 if a < 1e-2 else 1e-9)
