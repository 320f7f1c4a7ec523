"""Elementary functions as polynomials: cheaper than the library's, exact to rounding where they are used."""

from __future__ import annotations

import math
from typing import Any

from gear_dynamics_ros.physics.kernel.compiling import inlined
from gear_dynamics_ros.physics.kernel.lanes import absolute, any_negative, arctangent_of, load4
from gear_dynamics_ros.physics.kernel.records import KernelRecord, Octet

# Where each series is exact to rounding.
INVOLUTE_REACH = 1.0 / 40.0  # of tan^2 alpha0
ARCSINE_REACH = 1e-2
ARCTANGENT_REACH = 0.2


@inlined
def sine_cosine(turns: Octet) -> tuple[Octet, Octet]:
    """Sine and cosine of 2 pi ``turns``, exact to rounding.

    Taylor polynomials of the half angle, |x| <= pi/2.
    """
    x = math.pi * (turns - ((turns + 6755399441055744.0) - 6755399441055744.0))
    x2 = x * x
    s = 1.0 / 51090942171709440000.0 * x2 - 1.0 / 121645100408832000.0
    s = s * x2 + 1.0 / 355687428096000.0
    s = s * x2 - 1.0 / 1307674368000.0
    s = s * x2 + 1.0 / 6227020800.0
    s = s * x2 - 1.0 / 39916800.0
    s = s * x2 + 1.0 / 362880.0
    s = s * x2 - 1.0 / 5040.0
    s = s * x2 + 1.0 / 120.0
    s = s * x2 - 1.0 / 6.0
    s = x + x * x2 * s
    c = 1.0 / 2432902008176640000.0 * x2 - 1.0 / 6402373705728000.0
    c = c * x2 + 1.0 / 20922789888000.0
    c = c * x2 - 1.0 / 87178291200.0
    c = c * x2 + 1.0 / 479001600.0
    c = c * x2 - 1.0 / 3628800.0
    c = c * x2 + 1.0 / 40320.0
    c = c * x2 - 1.0 / 720.0
    c = c * x2 + 1.0 / 24.0
    c = c * x2 - 0.5
    c = c * x2 + 1.0
    return 2.0 * s * c, 1.0 - 2.0 * s * s


@inlined
def arctangent(x: Any) -> Any:
    """atan x to rounding: Taylor's series where the film mostly is, without calls that spill registers."""
    if any_negative(ARCTANGENT_REACH - absolute(x)):
        return arctangent_of(x)
    x2 = x * x
    x4 = x2 * x2
    x8 = x4 * x4
    low = (1.0 / 3.0 - 1.0 / 5.0 * x2) + x4 * (1.0 / 7.0 - 1.0 / 9.0 * x2)
    high = (1.0 / 11.0 - 1.0 / 13.0 * x2) + x4 * (1.0 / 15.0 - 1.0 / 17.0 * x2)
    return x - x * x2 * (low + x8 * (high + x8 * (1.0 / 19.0 - 1.0 / 21.0 * x2)))


@inlined
def involute_functions(constants: KernelRecord, tan2_change: float) -> tuple[float, float, float, float]:
    """inv alpha - inv alpha0, cos, sin and cot of the pressure angle alpha (22).

    tan^2 alpha = tan^2 alpha0 + ``tan2_change``; the series of ``constants.involute_series`` near alpha0, see
    "Mesh" in docs/model.md.
    """
    if abs(tan2_change) > INVOLUTE_REACH * constants.tan2_alpha0:
        tangent = math.sqrt(constants.tan2_alpha0 + tan2_change)
        cosine = 1.0 / math.sqrt(1.0 + constants.tan2_alpha0 + tan2_change)
        involute = tangent - math.atan(tangent) - constants.involute_alpha0
        return involute, cosine, cosine * tangent, 1.0 / tangent
    series = constants.involute_series
    change2 = tan2_change * tan2_change
    change4 = change2 * change2
    low = (load4(series, 0) + load4(series, 4) * tan2_change) + (
        load4(series, 8) + load4(series, 12) * tan2_change
    ) * change2
    high = (load4(series, 16) + load4(series, 20) * tan2_change) + (
        load4(series, 24) + load4(series, 28) * tan2_change
    ) * change2
    top = load4(series, 32) + load4(series, 36) * tan2_change
    total = low + (high + top * change4) * change4
    return total[0], total[1], total[2], total[3]


@inlined
def position_angle(sin_beta: float, cos_beta: float) -> float:
    """Angle beta of the line of centres (27), rad, from its sine and cosine."""
    if abs(sin_beta) > ARCSINE_REACH:
        return math.atan2(sin_beta, cos_beta)
    s2 = sin_beta * sin_beta
    return sin_beta + sin_beta * s2 * (
        (1.0 / 6.0 + s2 * 0.075) + s2 * s2 * (5.0 / 112.0 + s2 * (35.0 / 1152.0))
    )
