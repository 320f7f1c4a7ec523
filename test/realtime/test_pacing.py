"""Deadlines of chunks, on a clock that the test turns."""

from __future__ import annotations

import pytest

from gear_dynamics_ros.parameters import PacingParameters
from gear_dynamics_ros.realtime.pacing import Pacer

CHUNK = 2_000_000


def test_a_chunk_is_due_when_its_last_moment_has_passed():
    pacer = Pacer(PacingParameters(1.0), 100)
    assert pacer.wait_ns(CHUNK, 100) == CHUNK
    assert pacer.wait_ns(CHUNK, 100 + CHUNK) == 0
    pacer.chunk_finished(CHUNK, 100 + CHUNK + 7)
    assert pacer.wait_ns(CHUNK, 100 + CHUNK + 7) == CHUNK - 7


@pytest.mark.parametrize("factor", [0.2, 0.3, 3.0, 7.7])
def test_deadlines_do_not_drift(factor):
    pacer = Pacer(PacingParameters(factor), 0)
    for k in range(1, 10_001):
        due = pacer.wait_ns(CHUNK, 0)
        pacer.chunk_finished(CHUNK, due)
        assert abs(due - k * CHUNK / factor) <= 1


def test_flat_out_is_always_due_and_never_late():
    pacer = Pacer(PacingParameters(0.0), 0)
    for now in range(0, 50 * CHUNK, 5 * CHUNK):
        assert pacer.wait_ns(CHUNK, now) == 0
        pacer.chunk_started(CHUNK, now)
        pacer.chunk_finished(CHUNK, now)
    report = pacer.report(100 * CHUNK)
    assert report == (0.1, 0, 0.0, 0.0)


def test_an_overrun_is_counted_and_slips():
    pacer = Pacer(PacingParameters(1.0), 0)
    pacer.chunk_started(CHUNK, CHUNK + 30)
    pacer.chunk_finished(CHUNK, 2 * CHUNK + 500)
    assert pacer.wait_ns(CHUNK, 2 * CHUNK + 500) == 0
    pacer.chunk_finished(CHUNK, 2 * CHUNK + 600)
    assert pacer.wait_ns(CHUNK, 2 * CHUNK + 600) == CHUNK - 100
    report = pacer.report(4 * CHUNK)
    assert report.overruns == 1
    assert report.slipped == pytest.approx(500e-9)
    assert report.worst_lateness == pytest.approx(30e-9)
    assert report.real_time_factor == 0.5


def test_worst_lateness_and_factor_are_those_since_the_last_report():
    pacer = Pacer(PacingParameters(1.0), 0)
    pacer.chunk_started(CHUNK, CHUNK + 30)
    pacer.chunk_finished(CHUNK, CHUNK + 40)
    pacer.report(CHUNK + 40)
    assert pacer.report(2 * CHUNK) == (0.0, 0, 0.0, 0.0)


def test_a_pause_is_no_overrun():
    pacer = Pacer(PacingParameters(1.0), 0)
    pacer.chunk_finished(CHUNK, CHUNK)
    pacer.change(PacingParameters(2.0), 1000 * CHUNK)
    assert pacer.wait_ns(CHUNK, 1000 * CHUNK) == CHUNK // 2
    pacer.chunk_finished(CHUNK, 1000 * CHUNK + CHUNK // 2)
    assert pacer.report(1001 * CHUNK).overruns == 0


def test_catch_up_keeps_the_deadlines_as_far_as_it_may():
    pacer = Pacer(PacingParameters(1.0, on_overrun="catch_up", catch_up_limit=3e-3), 0)
    assert pacer.chunk_finished(CHUNK, 3 * CHUNK) == CHUNK
    assert pacer.wait_ns(CHUNK, 3 * CHUNK) == 0
    assert pacer.chunk_finished(CHUNK, 3 * CHUNK + 10) == 10
    assert pacer.chunk_finished(CHUNK, 3 * CHUNK + 20) == 0
    assert pacer.wait_ns(CHUNK, 3 * CHUNK + 20) == CHUNK - 20
    assert pacer.report(4 * CHUNK).slipped == 0.0
    # Of 8 ms that the next chunk is late 3 may be made good.
    pacer.chunk_finished(CHUNK, 9 * CHUNK)
    assert pacer.report(10 * CHUNK).slipped == pytest.approx(5e-3)
    assert pacer.wait_ns(CHUNK, 9 * CHUNK) == 0
    pacer.chunk_finished(CHUNK, 9 * CHUNK)
    pacer.chunk_finished(CHUNK, 9 * CHUNK)
    assert pacer.wait_ns(CHUNK, 9 * CHUNK) == CHUNK // 2


def test_a_pause_does_not_count_into_the_factor():
    pacer = Pacer(PacingParameters(1.0), 0)
    pacer.chunk_finished(CHUNK, CHUNK)
    pacer.restart(1000 * CHUNK)
    pacer.chunk_finished(CHUNK, 1001 * CHUNK)
    assert pacer.report(1001 * CHUNK).real_time_factor == 1.0


def test_what_was_asked_for_is_no_overrun_but_slips():
    pacer = Pacer(PacingParameters(1.0), 0)
    pacer.excuse(20 * CHUNK)
    assert pacer.chunk_finished(CHUNK, 21 * CHUNK) == 0
    report = pacer.report(21 * CHUNK)
    assert report.overruns == 0 and report.slipped == pytest.approx(20 * CHUNK * 1e-9)
