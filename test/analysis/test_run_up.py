"""Where a run-up is found, and the spectra over its speed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.analysis.run_up import RunUp, SpeedSpectra, find_run_up, frame_length
from gear_dynamics_ros.analysis.statistics import Envelope, Quantities
from gear_dynamics_ros.analysis.summary import TimeSpan
from gear_dynamics_ros.chunk import Samples

INTERVAL = 1e-4
Vector = NDArray[np.float64]


def found_in(speed: Vector, name: str = "driving_speed") -> RunUp | None:
    """With the ripple that impacts of the teeth give the speed."""
    envelope = Envelope()
    rippled = speed + 2.0 * np.sin(0.7 * np.arange(len(speed)))
    samples = Samples(0, INTERVAL, (name,), rippled[:, None])
    envelope.add(samples, Quantities((name,), samples.values))
    return find_run_up(envelope)


def ramps(*corners: tuple[float, float]) -> Vector:
    times, speeds = zip(*corners, strict=True)
    return np.interp(np.arange(0.0, times[-1], INTERVAL), times, speeds)


def test_the_greatest_change_of_speed_is_found_without_its_flat_ends() -> None:
    speed = ramps((0.0, 200.0), (1.0, 200.0), (4.0, 1000.0), (6.0, 1000.0), (6.1, 950.0), (7.0, 1040.0))
    found = found_in(speed)
    assert found is not None and found.rises
    assert found.span == pytest.approx((1.0, 4.0), abs=0.15)
    assert (found.begin_speed, found.end_speed) == pytest.approx((200.0, 1000.0), abs=30.0)


def test_a_coast_down_is_one_too_in_either_sense_of_rotation() -> None:
    for sense in (1.0, -1.0):
        found = found_in(sense * ramps((0.0, 500.0), (1.0, 900.0), (2.0, 900.0), (5.0, 100.0)))
        assert found is not None and not found.rises
        assert found.span == pytest.approx((2.0, 5.0), abs=0.15)


def test_no_run_up_at_steady_speed_or_without_speed() -> None:
    assert found_in(ramps((0.0, 500.0), (1.0, 520.0), (2.0, 480.0), (3.0, 510.0))) is None
    assert found_in(np.linspace(100.0, 900.0, 1000), name="dte") is None


def test_of_frames_at_one_speed_the_greatest_amplitude_stays_and_gaps_are_filled() -> None:
    run_up = RunUp(TimeSpan(0.0, 4.0), 100.0, 900.0)
    spectra = SpeedSpectra(run_up, 10, INTERVAL)
    with pytest.raises(ValueError, match="no frame"):
        spectra.amplitudes()
    frame, frequency = spectra.frame, spectra.frequencies()[5]
    time = INTERVAL * np.arange(4 * frame)
    for first, (size, speed) in enumerate(((2.0, 300.0), (5.0, 300.0), (1.0, 700.0))):
        dte = 1e-6 * size * np.cos(2.0 * np.pi * frequency * time)
        block = np.column_stack([dte, np.full_like(time, speed)])
        spectra.add(Samples(first * 4 * frame, INTERVAL, ("dte", "driving_speed"), block))
    amplitudes = spectra.amplitudes()
    assert spectra.mean_load() is None
    column = np.searchsorted(spectra.speed_edges, [100.0, 300.0, 899.0], side="right") - 1
    np.testing.assert_allclose(amplitudes[column, 5], [5e-6, 5e-6, 1e-6], rtol=0.03)
    assert amplitudes[column[1]].argmax() == 5


def test_a_frame_is_so_long_that_orders_stay_in_their_bins() -> None:
    slow, fast = (RunUp(TimeSpan(0.0, duration), 100.0, 900.0) for duration in (100.0, 1.0))
    for run_up in (slow, fast):
        length = frame_length(run_up, 40.0 / (2.0 * np.pi), 1e-5) * 1e-5
        moved = 2.0 * 40.0 / (2.0 * np.pi) * 800.0 / run_up.span.end * length
        assert 0.5 <= moved * length <= 2.0  # bins, each 1 / length wide
