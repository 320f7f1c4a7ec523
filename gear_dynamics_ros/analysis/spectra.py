"""Amplitude spectra."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Flat-top window HFT95 of Heinzel, Rüdiger and Schilling (2002): the amplitude of a line between two bins
# comes out within 5e-4, sidelobes lie 95 dB down.
FLAT_TOP: Final = (1.0, -1.9383379, 1.3045202, -0.4028270, 0.0350665)
HALF_LOBE: Final = len(FLAT_TOP)
SHORTEST: Final = 8 * HALF_LOBE


class Spectrum(NamedTuple):
    """One-sided amplitude spectrum: a sine of amplitude A peaks at A."""

    frequency: NDArray[np.float64]  # Hz, shape (m,)
    amplitude: NDArray[np.float64]  # unit of the signal, shape (m,)

    @property
    def resolution(self) -> float:
        """Distance of two bins in Hz; lines nearer than 2 * HALF_LOBE of them merge."""
        return float(self.frequency[1])


class Line(NamedTuple):
    """One peak of a spectrum."""

    frequency: float  # Hz
    amplitude: float  # unit of the signal


def flat_top(count: int) -> NDArray[np.float64]:
    """Periodic flat-top window, shape (count,), mean 1."""
    angle = 2.0 * np.pi * np.arange(count) / count
    window: NDArray[np.float64] = sum(
        (weight * np.cos(order * angle) for order, weight in enumerate(FLAT_TOP)), start=np.zeros(count)
    )
    return window


def amplitude_spectrum(values: NDArray[np.float64], interval: float) -> Spectrum:
    """Spectrum of ``values``, shape (n,), sampled each ``interval`` s, about their mean.

    Raises ValueError for fewer than SHORTEST values.
    """
    count = len(values)
    if count < SHORTEST:
        raise ValueError(f"a spectrum of {count} samples shows nothing: give at least {SHORTEST}")
    weighted = (values - values.mean()) * flat_top(count)
    amplitude: NDArray[np.float64] = 2.0 / count * np.abs(np.fft.rfft(weighted))
    frequency = np.asarray(np.fft.rfftfreq(count, interval), dtype=np.float64)
    return Spectrum(frequency, amplitude)


def strongest_lines(spectrum: Spectrum, count: int) -> list[Line]:
    """The ``count`` highest peaks, highest first, each the highest within its own main lobe.

    The frequency is the lobe's centre of power: exact to a small part of a bin for a line that stands alone.
    """
    rest = spectrum.amplitude.copy()
    rest[:HALF_LOBE] = 0.0  # what leaks from the mean
    lines: list[Line] = []
    for _ in range(count):
        peak = int(rest.argmax())
        if rest[peak] <= 0.0:
            break
        lobe = slice(max(0, peak - HALF_LOBE), peak + HALF_LOBE + 1)
        power = spectrum.amplitude[lobe] ** 2
        centre = float(power @ spectrum.frequency[lobe] / power.sum())
        lines.append(Line(centre, float(spectrum.amplitude[peak])))
        rest[lobe] = 0.0
    return lines
