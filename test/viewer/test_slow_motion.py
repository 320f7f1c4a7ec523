"""Which windows of a run are played slowly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, COLUMN
from gear_dynamics_ros.viewer.slow_motion import SlowMotionChooser, SlowWindow, Subject

INTERVAL = 1.0e-5
TEETH = 40
SPEED = 2.0 * np.pi * 1000.0 / TEETH  # rad/s, mesh frequency 1 kHz: 100 samples a period
LENGTH = 30_000
HALF_BACKLASH = 25e-6


def steady() -> NDArray[np.float64]:
    """Samples with the drive flanks in contact, numbered in channel ``time``."""
    rows = np.zeros((LENGTH, len(CHANNELS)))
    rows[:, COLUMN["time"]] = np.arange(LENGTH)
    rows[:, COLUMN["driving_speed"]] = SPEED
    rows[:, COLUMN["half_backlash"]] = HALF_BACKLASH
    rows[:, COLUMN["dte"]] = 1.05 * HALF_BACKLASH
    rows[:, COLUMN["meshing_state"]] = 1.0
    return rows


def part(rows: NDArray[np.float64], begin: int, count: int, state: float, dte: float) -> None:
    rows[begin : begin + count, COLUMN["meshing_state"]] = state
    rows[begin : begin + count, COLUMN["dte"]] = dte


def windows(rows: NDArray[np.float64], sizes: int = 2_500) -> tuple[list[SlowWindow], SlowWindow | None]:
    chooser = SlowMotionChooser(TEETH, INTERVAL)
    found: list[SlowWindow] = []
    for begin in range(0, len(rows), sizes):
        found += chooser.add(begin, rows[begin : begin + sizes])
    return found, chooser.last()


@pytest.mark.parametrize("sizes", [200, 2_500, LENGTH])
def test_the_first_clear_loss_of_contact_after_the_start(sizes: int) -> None:
    rows = steady()
    part(rows, 1_000, 50, 0.0, 0.0)  # within the start
    part(rows, 9_000, 50, 0.0, 0.9 * HALF_BACKLASH)  # by a hair
    part(rows, 12_345, 50, 0.0, 0.0)
    part(rows, 20_000, 50, 0.0, 0.0)
    (window,), last = windows(rows, sizes)
    assert last is None
    assert window.subject is Subject.CONTACT_LOST
    assert (window.first_sample, len(window.rows)) == (12_345 - 150, 800)  # 1.5 of 8 mesh periods before
    np.testing.assert_array_equal(window.rows, rows[window.first_sample :][:800])
    assert window.factor == 1000.0  # a mesh period takes a second


@pytest.mark.parametrize("sizes", [200, 2_500, LENGTH])
def test_back_flanks_that_strike_are_shown_too_once(sizes: int) -> None:
    rows = steady()
    part(rows, 8_000, 50, 0.0, 0.0)
    for begin in (15_000, 25_000):
        part(rows, begin, 20, -1.0, -1.1 * HALF_BACKLASH)
    found, last = windows(rows, sizes)
    assert [window.subject for window in found] == [Subject.CONTACT_LOST, Subject.BACK_STRUCK]
    assert found[1].first_sample == 15_000 - 150
    assert last is None


@pytest.mark.parametrize("sizes", [200, LENGTH])
def test_one_window_that_shows_all_is_enough(sizes: int) -> None:
    rows = steady()
    part(rows, 8_000, 50, 0.0, 0.0)
    part(rows, 8_050, 20, -1.0, -1.1 * HALF_BACKLASH)
    part(rows, 20_000, 20, -1.0, -1.1 * HALF_BACKLASH)
    (window,), _ = windows(rows, sizes)
    assert window.subject is Subject.BACK_STRUCK
    assert window.first_sample == 8_000 - 150


def test_a_run_that_keeps_contact_shows_its_end() -> None:
    rows = steady()
    found, last = windows(rows)
    assert not found
    assert last is not None
    assert last.subject is Subject.STEADY
    np.testing.assert_array_equal(last.rows, rows[-800:])


def test_missing_samples_end_a_window() -> None:
    rows = steady()
    part(rows, 9_990, 5, 0.0, 0.0)
    chooser = SlowMotionChooser(TEETH, INTERVAL)
    assert not chooser.add(0, rows[:10_000])
    assert not chooser.add(11_000, rows[11_000:])
    window = chooser.last()
    assert window is not None
    assert window.subject is Subject.STEADY


def test_slow_gears_are_shown_for_a_limited_time() -> None:
    rows = steady()
    rows[:, COLUMN["driving_speed"]] = 0.1
    _, last = windows(rows)
    assert last is not None
    assert len(last.rows) == 2_000
    assert last.factor == 1000.0


def test_a_run_without_samples_shows_nothing() -> None:
    assert SlowMotionChooser(TEETH, INTERVAL).last() is None
