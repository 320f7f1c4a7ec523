"""Periodic excitations: surfaces (16)-(18), stiffness (24) and static error (25) as one series of waves.

See "Tooth surface" and "Integration", Excitations, in docs/model.md. ``waves`` is a table of WAVE_ROWS rows
with a column for each wave, ``amplitudes`` its amplitudes of cosine and sine, a column for each value of the
excitation table. A phase is given as a fraction of the hunting cycle, after which the same teeth meet again.
"""

from __future__ import annotations

from gear_dynamics_ros.physics.kernel.compiling import compiled, inlined
from gear_dynamics_ros.physics.kernel.lanes import load8, store
from gear_dynamics_ros.physics.kernel.records import (
    EXCITATIONS,
    TURNS_PER_RADIAN,
    TWO_PI,
    Floats,
    KernelRecord,
    Octet,
    Pointer,
)
from gear_dynamics_ros.physics.kernel.series import sine_cosine

# Columns of the excitation table: z1 + z2 (m), modulation of the stiffness (dimensionless), static error (m),
# with derivatives by the mesh phase.
SURFACE, SURFACE_SLOPE, SURFACE_CURVATURE, STIFFNESS, STIFFNESS_SLOPE, ERROR, ERROR_SLOPE, ERROR_CURVATURE = (
    range(EXCITATIONS)
)
# Rows of ``waves``: orders per hunting cycle; the waves on the steps' own grid; their rotation over half a
# step; waves at any other phase.
ORDER, COSINE, SINE, ROTATION_COSINE, ROTATION_SINE, OTHER_COSINE, OTHER_SINE = range(7)
WAVE_ROWS = 7
ROW_BLOCK = 8  # waves are padded to whole blocks of lanes
REFRESH_STEPS = 16  # after so many steps at the latest the waves are evaluated afresh


@inlined
def set_waves(
    constants: KernelRecord, waves: Pointer, fraction: float, cosine_row: int, sine_row: int
) -> None:
    """Sines and cosines of all waves at ``fraction`` of the hunting cycle, into two rows."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        sine, cosine = sine_cosine(load8(waves, ORDER * n + j) * fraction)
        store(waves, cosine_row * n + j, cosine)
        store(waves, sine_row * n + j, sine)


@inlined
def rotate_waves(constants: KernelRecord, waves: Pointer) -> None:
    """The waves on the grid half a step on: one rotation."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        cosine, sine = load8(waves, COSINE * n + j), load8(waves, SINE * n + j)
        rotation_cosine = load8(waves, ROTATION_COSINE * n + j)
        rotation_sine = load8(waves, ROTATION_SINE * n + j)
        store(waves, COSINE * n + j, cosine * rotation_cosine - sine * rotation_sine)
        store(waves, SINE * n + j, sine * rotation_cosine + cosine * rotation_sine)


@inlined
def nudge_waves(constants: KernelRecord, waves: Pointer, fraction: float) -> None:
    """The waves on the grid on by the small ``fraction`` of the hunting cycle."""
    n = constants.padded_waves
    for j in range(0, n, ROW_BLOCK):
        cosine, sine = load8(waves, COSINE * n + j), load8(waves, SINE * n + j)
        x = load8(waves, ORDER * n + j) * (TWO_PI * fraction)
        x2 = x * x
        rotation_sine = x * (1.0 - x2 * (1.0 / 6.0 - x2 * (1.0 / 120.0)))
        versine = x2 * (0.5 - x2 * (1.0 / 24.0 - x2 * (1.0 / 720.0)))
        store(waves, COSINE * n + j, cosine - (cosine * versine + sine * rotation_sine))
        store(waves, SINE * n + j, sine - (sine * versine - cosine * rotation_sine))


@inlined
def sum_waves(
    constants: KernelRecord, waves: Pointer, amplitudes: Pointer, cosine_row: int, sine_row: int
) -> Octet:
    """All columns of the excitation table, eight side by side."""
    n = constants.padded_waves
    c, s = cosine_row * n, sine_row * n
    even_c, even_s = waves[c] * load8(amplitudes, 0), waves[s] * load8(amplitudes, 8)
    odd_c, odd_s = waves[c + 1] * load8(amplitudes, 16), waves[s + 1] * load8(amplitudes, 24)
    for j in range(2, constants.waves, 2):
        even_c = even_c + waves[c + j] * load8(amplitudes, 16 * j)
        even_s = even_s + waves[s + j] * load8(amplitudes, 16 * j + 8)
        odd_c = odd_c + waves[c + j + 1] * load8(amplitudes, 16 * j + 16)
        odd_s = odd_s + waves[s + j + 1] * load8(amplitudes, 16 * j + 24)
    return (even_c + even_s) + (odd_c + odd_s)


@inlined
def cycle_fraction(constants: KernelRecord, state: KernelRecord, part_turn: float) -> float:
    """Fraction of the hunting cycle at ``part_turn`` turns of gear 1 beyond the whole ones."""
    fraction: float = (state.whole_turns + part_turn) / constants.hunting
    return fraction


@compiled
def excite_at(
    constants: KernelRecord,
    state: KernelRecord,
    waves: Pointer,
    amplitudes: Pointer,
    part_turn: float,
    excitation: Pointer,
) -> None:
    """Sum of all periodic excitations ``part_turn`` turns of gear 1 beyond the whole ones."""
    set_waves(constants, waves, cycle_fraction(constants, state, part_turn), OTHER_COSINE, OTHER_SINE)
    store(excitation, 0, sum_waves(constants, waves, amplitudes, OTHER_COSINE, OTHER_SINE))


@compiled
def refresh_waves(
    constants: KernelRecord, state: KernelRecord, here: KernelRecord, waves: Pointer, speed: float
) -> None:
    """Waves on the grid afresh at ``here``, and their rotation over half a step at ``speed`` in rad/s."""
    set_waves(constants, waves, cycle_fraction(constants, state, here.part_turn), COSINE, SINE)
    half_step = 0.5 * constants.step * speed * TURNS_PER_RADIAN / constants.hunting
    set_waves(constants, waves, half_step, ROTATION_COSINE, ROTATION_SINE)


@inlined
def surface_at(excitation: Floats, lead: float, phi_rate: float) -> tuple[float, float]:
    """Height z1 + z2 in m and its rate in m/s, ``lead`` rad of mesh phase ahead of ``excitation``.

    ``phi_rate`` is the rate of the mesh phase, rad/s.
    """
    slope = excitation[SURFACE_SLOPE] + 0.5 * lead * excitation[SURFACE_CURVATURE]
    rate = phi_rate * (excitation[SURFACE_SLOPE] + lead * excitation[SURFACE_CURVATURE])
    return excitation[SURFACE] + lead * slope, rate
