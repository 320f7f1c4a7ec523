"""Amplitude spectra."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Flat-top window HFT95 (G. Heinzel, A. Rüdiger, R. Schilling, "Spectrum and spectral density estimation by
# the DFT", 2002), of mean 1: the amplitude of a line between two bins is within 5e-4, the sidelobes are 95 dB
# down.
HFT95_COEFFICIENTS: Final = (1.0, 1.9383379, 1.3045202, 0.4028270, 0.0350665)
HALF_LOBE: Final = len(HFT95_COEFFICIENTS)  # bins from the middle of the main lobe to its end
MIN_SAMPLES: Final = 8 * HALF_LOBE


class Spectrum(NamedTuple):
    """One-sided amplitude spectrum: a sine of amplitude A peaks at A."""

    frequency: NDArray[np.float64]  # Hz, shape (m,)
    amplitude: NDArray[np.float64]  # unit of the signal, shape (m,)

    @property
    def resolution(self) -> float:
        """Distance of two bins in Hz; lines closer than 2 * HALF_LOBE bins merge."""
        return float(self.frequency[1])


class SpectralLine(NamedTuple):
    """One peak of a spectrum."""

    frequency: float  # Hz
    amplitude: float  # unit of the signal


def amplitude_spectrum(values: NDArray[np.float64], interval: float) -> Spectrum:
    """Spectrum, with the HFT95 window, of ``values`` less their mean: shape (n,), every ``interval`` s.

    Raises ValueError for fewer than MIN_SAMPLES values.
    """
    count = len(values)
    if count < MIN_SAMPLES:
        raise ValueError(f"{count} samples are too few for a spectrum: give at least {MIN_SAMPLES}")
    # Not scipy.signal's window: its import takes a second, also from the viewer's thread of the node.
    angle = np.linspace(-np.pi, np.pi, count, endpoint=False)
    window = sum(
        (factor * np.cos(k * angle) for k, factor in enumerate(HFT95_COEFFICIENTS)), start=np.zeros(count)
    )
    weighted = (values - values.mean()) * window
    amplitude: NDArray[np.float64] = 2.0 / count * np.abs(np.fft.rfft(weighted))
    frequency = np.asarray(np.fft.rfftfreq(count, interval), dtype=np.float64)
    return Spectrum(frequency, amplitude)


def strongest_lines(spectrum: Spectrum, count: int) -> list[SpectralLine]:
    """The at most ``count`` highest peaks, highest first, each the highest within its own main lobe.

    The frequency is the centroid of power over the lobe: for an isolated line its error is a small part of a
    bin.
    """
    rest = spectrum.amplitude.copy()
    rest[:HALF_LOBE] = 0.0  # leakage from what is left of the mean
    lines: list[SpectralLine] = []
    for _ in range(count):
        peak = int(rest.argmax())
        if rest[peak] <= 0.0:
            break
        lobe = slice(max(0, peak - HALF_LOBE), peak + HALF_LOBE + 1)
        power = spectrum.amplitude[lobe] ** 2
        centre = float(power @ spectrum.frequency[lobe] / power.sum())
        lines.append(SpectralLine(centre, float(spectrum.amplitude[peak])))
        rest[lobe] = 0.0
    return lines
