"""Periodic, quasi-periodic or chaotic: 0-1 test, largest exponent, periodicity of a Poincaré section."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Regime = Literal["periodic", "quasi-periodic", "chaotic"]

# 0-1 test
FREQUENCIES: Final = 100  # values of c
LOWEST_FREQUENCY: Final = math.pi / 5.0
HIGHEST_FREQUENCY: Final = 4.0 * math.pi / 5.0
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0  # spreads the values of c evenly, away from simple ratios
LAG_SHARE: Final = 10  # displacements over lags up to a tenth of the length, as the authors recommend
MIN_VALUES: Final = 10 * LAG_SHARE
MOST_TURNS: Final = 100  # of backfitting; a few are enough unless a cycle is held only a few times
BACKFITTED: Final = 1e-12  # change of a turn, of the largest value
MIN_TURNS: Final = 4  # fewer turns of a cycle would take most of the motion out with it

# What is smaller than this part of the largest DTE is rounding or the rest of a transient. Motions that
# settle fall below it by orders of magnitude, and motions that do not are as far above.
SETTLED: Final = 1e-6

# Periodicity
LONGEST_PERIOD: Final = 16  # mesh periods
MIN_CLOUD: Final = 8  # points: fewer may lie close together by chance
# Of the whole section: some of the teeth scatter less than all of them, so wider clouds tell of no period.
WIDEST_CLOUD: Final = 0.5

# Regime
# A regular motion has K near 0, a chaotic one near 1; K between 0.1 and 0.9 is rare.
ZERO_ONE_LIMIT: Final = 0.5
# Natural logarithm of the growth in a mesh period. Neighbours on a torus separate in proportion to the time
# at most: between 50 and 300 periods by ln(6) / 250 = 0.007 in each.
GROWTH_LIMIT: Final = 0.01


def zero_one_test(values: NDArray[np.float64], cycles: Sequence[int] = ()) -> float:
    """K of the 0-1 test for chaos of a series ``values``, shape (n,): about 0 if regular, about 1 if chaotic.

    The values are observations of the motion once a period, as a column of a Poincaré section. Series sampled
    densely look regular. Offset and unit of the values do not matter. Values that differ by less than SETTLED
    of their largest magnitude give 0. Raises ValueError for fewer than MIN_VALUES values.

    ``cycles`` are numbers of values after which something known repeats: the teeth of both gears. To the test
    a surface that differs from tooth to tooth is noise, unless the series holds some hundred turns. So the
    sum of one function of each cycle that fits the values best is taken out first; a cycle that the series
    holds less than MIN_TURNS times can't be, and stays.

    Source: G. A. Gottwald, I. Melbourne, "On the implementation of the 0-1 test for chaos", SIAM J. Appl.
    Dyn. Syst. 8 (2009): correlation method, median over c. Their modified displacement D_c = M_c - V_osc
    takes out what the mean of the values causes. Here the mean itself is subtracted first, after which V_osc
    is 0: D_c has the same limit, and no remainder of a mean that is much larger than the motion.
    """
    count = len(values)
    if count < MIN_VALUES:
        raise ValueError(f"{count} values are too few for the 0-1 test: give at least {MIN_VALUES}")
    rest = _without_cycles(values - values.mean(), cycles)
    if np.ptp(rest) <= SETTLED * np.abs(values).max():
        return 0.0
    displacement = _mean_square_displacement(rest / rest.std(), count // LAG_SHARE)
    lags = np.arange(displacement.shape[1]) - (displacement.shape[1] - 1) / 2.0
    centred = displacement - displacement.mean(axis=1, keepdims=True)
    # Not centred @ lags: for a product of this size the threads of BLAS would occupy all processors a while.
    covariance = np.einsum("ij,j->i", centred, lags)
    spread = np.sqrt((centred * centred).sum(axis=1) * (lags @ lags))
    return float(np.median(np.divide(covariance, spread, out=np.zeros_like(spread), where=spread > 0.0)))


def _without_cycles(values: NDArray[np.float64], cycles: Sequence[int]) -> NDArray[np.float64]:
    """``values`` (n,) less the sum of a function of each of the ``cycles``, by least squares.

    The mean at each place of a cycle is its function where there is one cycle; several take turns until
    nothing changes (backfitting).
    """
    fitted = sorted({cycle for cycle in cycles if 1 < cycle <= len(values) // MIN_TURNS})
    places = [np.arange(len(values)) % cycle for cycle in fitted]
    settled = BACKFITTED * float(np.abs(values).max(initial=0.0))
    rest = values
    for _ in range(MOST_TURNS if len(fitted) > 1 else len(fitted)):
        before = rest
        for place in places:
            rest = rest - (np.bincount(place, rest) / np.bincount(place))[place]
        if np.abs(rest - before).max() <= settled:
            break
    return rest


def _mean_square_displacement(values: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """M_c at lags 1 to ``lags``, for each c a row, shape (FREQUENCIES, lags).

    The translations p_c and q_c are real and imaginary part of one complex walk; the sum of its products at a
    lag comes from a Fourier transform.
    """
    count = len(values)
    summed = count - lags  # as many displacements at every lag
    part = np.mod(GOLDEN * np.arange(1, FREQUENCIES + 1), 1.0)
    frequencies = LOWEST_FREQUENCY + (HIGHEST_FREQUENCY - LOWEST_FREQUENCY) * part
    walk = np.cumsum(values * np.exp(1j * np.multiply.outer(frequencies, np.arange(1, count + 1))), axis=1)
    walk -= walk.mean(axis=1, keepdims=True)  # displacements stay, and the products below lose fewer digits
    # No product wraps around: those of a lag reach to count - 1 at most.
    whole = np.fft.fft(walk, axis=1)
    begin = np.fft.fft(walk[:, :summed], n=count, axis=1)
    products = np.fft.ifft(whole * begin.conj(), axis=1).real[:, 1 : lags + 1]
    squares = np.cumsum(walk.real**2 + walk.imag**2, axis=1)
    at_end = squares[:, summed : summed + lags] - squares[:, :lags]
    displacement: NDArray[np.float64] = at_end + squares[:, summed - 1, None] - 2.0 * products
    return displacement / summed


class NeighbourPair(Protocol):
    """Two neighbouring trajectories of one system: the reference and its copy."""

    def advance(self) -> None:
        """Both by one interval."""

    def distance(self) -> float:
        """Distance of the copy from the reference, in the norm that ``rescale`` uses."""

    def rescale(self, distance: float) -> bool:
        """Bring the copy to ``distance`` of the reference, along the line that joins them.

        False, with the copy as it was, where that can't be done now: the two stand on different sides of a
        switching surface, or coincide.
        """


def largest_exponent(
    pair: NeighbourPair, intervals: int, interval: float, separation: float, skip: int
) -> float:
    """Largest Lyapunov exponent in 1/s, over ``intervals`` of ``interval`` s each after ``skip`` more.

    The copy is brought back to ``separation`` after each interval, and the logarithms of its growth are added
    up. Where it can't be brought back the two go on, and the growth counts on from there. ``skip`` intervals
    turn the separation into the direction that grows fastest (or shrinks slowest). Returns -inf if the two
    become equal.

    Source: G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, "Lyapunov characteristic exponents for
    smooth dynamical systems and for Hamiltonian systems", Meccanica 15 (1980).
    """
    growth, before = 0.0, pair.distance()
    for index in range(skip + intervals):
        pair.advance()
        distance = pair.distance()
        if distance == 0.0:
            return -math.inf
        if index >= skip:
            growth += math.log(distance / before)
        before = separation if pair.rescale(separation) else distance
    return growth / (intervals * interval)


class Periodicity(NamedTuple):
    """What ``periodicity`` found; m."""

    period: int  # k of a k-T motion in mesh periods, 0 if there is none
    spread: float  # of DTE over the section
    cloud: float  # of DTE over the widest of the k clouds; equal to spread if there is no period
    closing_error: float  # greatest change of DTE after the hunting cycle; NaN if the section is too short
    repeats: bool  # the closing error is below SETTLED


def periodicity(section: NDArray[np.float64], hunting: int, width: float) -> Periodicity:
    """Periodicity of a motion from its Poincaré ``section`` at mesh phase 0.

    ``section``, shape (n, 2), holds DTE in m and its rate in m/s of n consecutive mesh periods. ``hunting``
    is the number of mesh periods after which the same teeth meet again, ``width`` the spread of DTE in m that
    the tooth surfaces alone make.

    The surface of each tooth is another. A motion that follows the mesh therefore does not come back to one
    point of the section: it visits ``hunting`` points in one cloud, and repeats after the hunting cycle. The
    motion is called *k-T* if k is the smallest number, up to LONGEST_PERIOD, for which each of the k
    sub-sections of every k-th point is a cloud no wider in DTE than ``width`` and, unless k is 1, than
    WIDEST_CLOUD of the section. Each sub-section has at least MIN_CLOUD points, so that a short section shows
    short periods only. Without such k the motion has no period. Where k divides ``hunting`` and the section
    is hardly wider than ``width``, the period may be one of the surfaces: with a ratio of 1.5 of their waves
    they almost repeat after 2, 4 and 8 teeth.

    A k-T motion *repeats* if DTE is the same after the least common multiple of k and ``hunting`` (after
    ``hunting`` if there is no k), within SETTLED of its largest magnitude, throughout the section,
    which must be longer than that. A motion without k that repeats is periodic too: it follows the teeth more
    widely than ``width``. One with k that does not repeat is not settled yet, or has a slow or narrow motion
    besides.

    Raises ValueError for fewer than MIN_CLOUD points.
    """
    dte = section[:, 0]
    if len(dte) < MIN_CLOUD:
        raise ValueError(f"{len(dte)} points are too few for a periodicity: give at least {MIN_CLOUD}")
    spread = float(np.ptp(dte))
    period, cloud = 0, spread
    for k in range(1, min(LONGEST_PERIOD, len(dte) // MIN_CLOUD) + 1):
        widest = max(float(np.ptp(dte[start::k])) for start in range(k))
        if widest <= (width if k == 1 else min(width, WIDEST_CLOUD * spread)):
            period, cloud = k, widest
            break
    error = _change_after(dte, math.lcm(max(period, 1), hunting))
    return Periodicity(period, spread, cloud, error, error <= SETTLED * float(np.abs(dte).max()))


def _change_after(values: NDArray[np.float64], cycle: int) -> float:
    """Greatest change of ``values`` (n,) from one to that ``cycle`` later, NaN if none is that late."""
    if len(values) <= cycle:
        return math.nan
    return float(np.abs(values[cycle:] - values[:-cycle]).max())


def regime(found: Periodicity, exponent: float, zero_one: float, mesh_period: float) -> Regime:
    """Name of a motion from its periodicity, largest exponent in 1/s and K; ``mesh_period`` in s.

    Neighbours that separate faster than GROWTH_LIMIT mean chaos if the 0-1 test agrees, and also if it does
    not while the motion has no period and does not repeat. If they don't separate, or only one measure speaks
    against a period, the motion is periodic with a period, or if it repeats, and else quasi-periodic. NaN as
    exponent leaves the word to the 0-1 test.
    """
    regular = found.period > 0 or found.repeats
    diffusive = zero_one > ZERO_ONE_LIMIT
    sensitive = diffusive if math.isnan(exponent) else exponent * mesh_period > GROWTH_LIMIT
    if sensitive and (diffusive or not regular):
        return "chaotic"
    return "periodic" if regular else "quasi-periodic"
