"""Measures of chaos against systems whose answer is known in closed form or published."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.analysis import chaos
from support.chaotic_systems import LinearPair, LorenzPair, logistic

Vector = NDArray[np.float64]
TEETH = 40
MICRO = 1e-6


def tooth_scatter(count: int, size: float, cycle: int = TEETH) -> Vector:
    """One number a tooth, uniform within ``size``, turn after turn."""
    of_tooth = np.random.default_rng(cycle).uniform(-0.5 * size, 0.5 * size, cycle)
    return of_tooth[np.arange(count) % cycle]


# 0-1 test


@pytest.mark.parametrize("count", [500, 1000, 3000])
def test_zero_one_of_the_logistic_map(count: int) -> None:
    """Period 8 at r = 3.55, period 3 at 3.83, chaos at 3.97 and 4."""
    assert abs(chaos.zero_one_test(logistic(3.55, count))) < 0.05
    assert abs(chaos.zero_one_test(logistic(3.83, count))) < 0.05
    assert chaos.zero_one_test(logistic(3.97, count)) > 0.99
    assert chaos.zero_one_test(logistic(4.0 - 1e-12, count)) > 0.99


@pytest.mark.parametrize("turn", [(math.sqrt(5.0) - 1.0) / 2.0, math.sqrt(2.0), math.pi / 30.0])
def test_zero_one_of_a_quasi_periodic_rotation(turn: float) -> None:
    assert abs(chaos.zero_one_test(np.cos(2.0 * math.pi * turn * np.arange(1000)))) < 0.05


def test_zero_one_equals_its_definition() -> None:
    """M_c(n) as the double sum that defines it."""
    values = logistic(3.97, 300)
    centred = values - values.mean()
    lags, summed = 30, 270
    part = np.mod(chaos.GOLDEN * np.arange(1, chaos.FREQUENCIES + 1), 1.0)
    found = []
    for c in np.pi / 5.0 + 3.0 * np.pi / 5.0 * part:
        j = np.arange(1, 301)
        p, q = np.cumsum(centred * np.cos(c * j)), np.cumsum(centred * np.sin(c * j))
        moved = [
            np.mean((p[n : n + summed] - p[:summed]) ** 2 + (q[n : n + summed] - q[:summed]) ** 2)
            for n in range(1, lags + 1)
        ]
        found.append(np.corrcoef(np.arange(1, lags + 1), moved)[0, 1])
    assert chaos.zero_one_test(values) == pytest.approx(np.median(found), abs=1e-12)


def test_zero_one_does_not_depend_on_offset_and_unit() -> None:
    values = logistic(3.8, 1000)
    assert chaos.zero_one_test(30e-6 + 1e-9 * values) == pytest.approx(chaos.zero_one_test(values), abs=1e-6)


def test_zero_one_of_rounding_is_zero() -> None:
    noise = np.random.default_rng(1).standard_normal(1000)
    assert chaos.zero_one_test(np.full(1000, 3.0)) == 0.0
    assert chaos.zero_one_test(3.0e-5 * (1.0 + 1e-9 * noise)) == 0.0


def test_zero_one_takes_the_surface_of_the_teeth_out() -> None:
    """Alone, scatter from tooth to tooth is noise to the test; without it a hidden motion shows."""
    scatter = tooth_scatter(1000, 1.0)
    assert chaos.zero_one_test(scatter) > 0.5
    assert chaos.zero_one_test(scatter, (TEETH, TEETH)) == 0.0
    both = scatter + tooth_scatter(1000, 1.0, 41)
    assert chaos.zero_one_test(both, (TEETH, 41)) == 0.0
    third = 0.5 * np.cos(2.0 * math.pi / 3.0 * np.arange(1000))
    assert abs(chaos.zero_one_test(scatter + third, (TEETH, TEETH))) < 0.05
    assert chaos.zero_one_test(scatter + logistic(3.97, 1000), (TEETH, TEETH)) > 0.95


def test_too_few_values_for_zero_one() -> None:
    with pytest.raises(ValueError, match="at least 100"):
        chaos.zero_one_test(np.zeros(99))


# Largest exponent


@pytest.mark.parametrize("separation", [1e-6, 1e-7, 1e-8, 1e-9])
@pytest.mark.parametrize(("damping", "frequency"), [(0.02, 3.0), (0.3, 3.0)])
def test_exponent_of_a_linear_oscillator_is_the_real_part_of_its_eigenvalue(
    damping: float, frequency: float, separation: float
) -> None:
    pair = LinearPair(damping, frequency, 0.25, separation)
    found = chaos.largest_exponent(pair, 8000, 0.25, separation, skip=10)
    assert found == pytest.approx(-damping * frequency, rel=0.01)


@pytest.mark.parametrize("separation", [1e-6, 1e-9])
@pytest.mark.parametrize("patience", [1, 4])
def test_exponent_of_the_lorenz_attractor(separation: float, patience: int) -> None:
    """0.9056: J. C. Sprott, Chaos and Time-Series Analysis, 2003."""
    pair = LorenzPair(separation, patience)
    assert chaos.largest_exponent(pair, 50_000, 0.2, separation, skip=50) == pytest.approx(0.9056, rel=0.01)


def test_neighbours_that_become_equal_have_no_exponent() -> None:
    pair = LinearPair(0.02, 3.0, 0.25, 0.0)
    assert chaos.largest_exponent(pair, 10, 0.25, 1e-6, skip=0) == -math.inf


# Periodicity


def section(dte: Any) -> Vector:
    """A section of ``dte`` in um."""
    values = MICRO * np.asarray(dte, dtype=np.float64)
    return np.column_stack([values, 1e4 * values])


@pytest.mark.parametrize("k", [1, 2, 3, 4, 5, 7, 8, 12, 16])
@pytest.mark.parametrize("scatter", [0.0, 0.9])
def test_period_of_a_motion_with_and_without_scatter_from_tooth_to_tooth(k: int, scatter: float) -> None:
    levels = 20.0 + 2.0 * np.random.default_rng(k).permutation(k)
    dte = levels[np.arange(800) % k] + tooth_scatter(800, scatter)
    found = chaos.periodicity(section(dte), TEETH, MICRO)
    assert found.period == k and found.repeats
    assert found.cloud <= MICRO
    assert found.spread == pytest.approx(MICRO * np.ptp(dte))
    assert found.closing_error == pytest.approx(0.0, abs=1e-18)


def test_a_motion_wider_than_its_surface_that_repeats_has_no_period() -> None:
    found = chaos.periodicity(section(20.0 + tooth_scatter(800, 3.0)), TEETH, MICRO)
    assert (found.period, found.repeats) == (0, True)
    assert found.cloud == found.spread


@pytest.mark.parametrize("size", [0.4, 5.0])
def test_a_quasi_periodic_motion_does_not_repeat(size: float) -> None:
    """Narrower than the surface it is 1-T in the sense of the section."""
    turns = (math.sqrt(5.0) - 1.0) / 2.0 * np.arange(800)
    found = chaos.periodicity(section(20.0 + size * np.cos(2.0 * math.pi * turns)), TEETH, MICRO)
    assert found.period == (1 if 2.0 * size < 1.0 else 0)
    assert not found.repeats and found.closing_error > 0.01 * size * MICRO


def test_a_chaotic_motion_has_no_period() -> None:
    found = chaos.periodicity(section(20.0 + 10.0 * logistic(3.97, 800)), TEETH, MICRO)
    assert (found.period, found.repeats) == (0, False)


def test_chaos_in_narrow_bands_that_take_turns_does_not_repeat() -> None:
    dte = 20.0 + 5.0 * (np.arange(800) % 2) + 0.9 * logistic(3.97, 800)
    found = chaos.periodicity(section(dte), TEETH, MICRO)
    assert (found.period, found.repeats) == (2, False)


def test_a_section_that_is_shorter_than_the_hunting_cycle_can_not_show_whether_it_repeats() -> None:
    found = chaos.periodicity(section(20.0 + tooth_scatter(40, 0.5)), TEETH, MICRO)
    assert (found.period, found.repeats) == (1, False) and math.isnan(found.closing_error)


def test_few_points_of_chaos_are_no_long_period() -> None:
    for count in range(chaos.MIN_CLOUD, 160, 7):
        assert chaos.periodicity(section(20.0 + 10.0 * logistic(3.97, count)), TEETH, MICRO).period == 0


def test_too_few_points_for_a_periodicity() -> None:
    with pytest.raises(ValueError, match="at least 8"):
        chaos.periodicity(section(np.zeros(7)), TEETH, MICRO)


# Regime

PERIODIC = chaos.Periodicity(2, 9e-6, 0.5e-6, 1e-18, True)
WIDE = chaos.Periodicity(0, 9e-6, 9e-6, 1e-18, True)
UNSETTLED = chaos.Periodicity(2, 9e-6, 0.5e-6, 1e-7, False)
NONE = chaos.Periodicity(0, 9e-6, 9e-6, 5e-6, False)
MESH_PERIOD = 1e-4


@pytest.mark.parametrize(
    ("found", "growth", "zero_one", "expected"),
    [
        (PERIODIC, -0.1, 0.0, "periodic"),
        (WIDE, -0.1, 0.0, "periodic"),
        (UNSETTLED, -0.01, 0.1, "periodic"),
        (UNSETTLED, 0.1, 0.98, "chaotic"),  # in bands
        (UNSETTLED, 0.02, 0.1, "periodic"),
        (PERIODIC, 0.0, 0.8, "periodic"),
        (NONE, 0.0, 0.01, "quasi-periodic"),
        (NONE, 0.001, 0.6, "quasi-periodic"),
        (NONE, 0.2, 0.98, "chaotic"),
        (NONE, 0.2, 0.3, "chaotic"),
        (NONE, math.nan, 0.98, "chaotic"),
        (NONE, math.nan, 0.02, "quasi-periodic"),
        (PERIODIC, math.nan, 0.02, "periodic"),
        (PERIODIC, -math.inf, 0.02, "periodic"),
    ],
)
def test_regime(found: chaos.Periodicity, growth: float, zero_one: float, expected: str) -> None:
    assert chaos.regime(found, growth / MESH_PERIOD, zero_one, MESH_PERIOD) == expected
