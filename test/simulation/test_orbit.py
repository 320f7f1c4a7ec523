"""Orbits against the engine, which an independent solver has checked, and against themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.chunk import Status
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.orbit import EXTREMES, SAMPLES_PER_PERIOD, Orbit
from support.published import published_gearbox

RPM = math.pi / 30.0


def paper(**values: object) -> Parameters:
    names = {name.replace("__", "."): value for name, value in values.items()}
    return updated(published_gearbox(), names)


@pytest.mark.parametrize("model", ["traditional", "compared", "improved"])
@pytest.mark.parametrize("phase", ["nominal", "actual"])
def test_an_orbit_is_what_the_engine_computes(model: str, phase: str) -> None:
    # 7500 rpm: a period of the mesh is 200 us, a whole number of samples.
    parameters = paper(
        model=model, mesh_phase=phase, operation__speed=7500.0 * RPM, solver__step=1e-6, solver__chunk=4e-3
    )
    chunk = Engine(parameters).advance(20 * SAMPLES_PER_PERIOD)
    record = Orbit(parameters, 200).advance(20)
    assert record.samples.shape == chunk.samples.shape
    for name, tolerance in {
        "dte": 1e-11,
        "driving_x": 1e-11,
        "mesh_phase": 1e-8,
        "meshing_state": 0.0,
    }.items():
        difference = np.abs(record.samples[:, COLUMN[name]] - chunk[name])
        difference = (
            np.minimum(difference, 2.0 * math.pi - difference) if name == "mesh_phase" else difference
        )
        assert difference.max() <= tolerance, name


def test_the_bits_do_not_depend_on_how_many_periods_are_advanced_at_once() -> None:
    parameters = paper(operation__speed=6000.0 * RPM)
    whole, parts = Orbit(parameters), Orbit(parameters)
    record = whole.advance(60)
    pieces = [parts.advance(count) for count in (1, 19, 40)]
    assert np.array_equal(record.samples, np.concatenate([piece.samples for piece in pieces]))
    assert np.array_equal(record.section, np.concatenate([piece.section for piece in pieces]))
    assert whole.state.tobytes() == parts.state.tobytes()
    assert record.drive_time == pytest.approx(sum(piece.drive_time for piece in pieces), rel=1e-12)


def test_the_section_of_a_nominal_phase_lies_at_phase_zero() -> None:
    record = Orbit(paper(operation__speed=6123.4 * RPM)).advance(500)
    assert len(record.section) == 500 and record.phase_error < 1e-12
    assert np.array_equal(record.section[:, 0], record.samples[::SAMPLES_PER_PERIOD, COLUMN["dte"]])


def test_the_section_of_an_actual_phase_converges_to_phase_zero() -> None:
    parameters = paper(
        mesh_phase="actual", operation__speed=6000.0 * RPM, mesh_geometry="exact", mesh_damping="contact"
    )
    coarse, fine = (Orbit(parameters, steps).advance(10).section for steps in (400, 3200))
    assert len(coarse) == len(fine) >= 9
    # A millionth of the amplitude; later the two trajectories part.
    for column in (0, 1):
        error = np.abs(coarse[:4, column] - fine[:4, column]).max()
        assert error < 1e-6 * np.abs(fine[:, column]).max()


def test_the_times_on_the_flanks_are_those_of_ever_finer_sampling() -> None:
    orbit = Orbit(paper(operation__speed=6000.0 * RPM, model="compared"), 2000)
    records = [orbit.advance(1) for _ in range(40)]
    flank = np.concatenate([record.samples[:, COLUMN["meshing_state"]] for record in records])
    time = sum(record.time for record in records)
    drive = sum(record.drive_time for record in records)
    assert time == pytest.approx(40 * orbit.period, rel=1e-12)
    events = sum(record.counters.flank_changes for record in records)
    assert abs(drive / time - np.mean(flank == 1.0)) <= events / len(flank)
    coarse = Orbit(paper(operation__speed=6000.0 * RPM, model="compared"), 200).advance(40)
    assert coarse.drive_time == pytest.approx(drive, rel=1e-4)  # sampling at these steps would miss by 1e-2


def test_the_extremes_hold_those_of_the_samples() -> None:
    record = Orbit(paper(operation__speed=9000.0 * RPM), 20).advance(50)
    dte = record.samples[1:, COLUMN["dte"]]
    assert set(record.extremes) == set(EXTREMES)
    assert record.extremes["dte"].minimum <= dte.min() and record.extremes["dte"].maximum >= dte.max()
    assert record.extremes["dte"].mean == pytest.approx(dte.mean(), rel=1e-3)
    pressed = record.samples[1:, COLUMN["driving_penetration"]].max()
    assert record.extremes["driving_penetration"].maximum == pytest.approx(pressed, rel=1e-3)


def test_a_copy_goes_its_own_way() -> None:
    orbit = Orbit(paper())
    orbit.advance(5)
    twin = orbit.copy()
    before = orbit.state.tobytes()
    first = twin.advance(5).samples
    assert orbit.state.tobytes() == before
    assert np.array_equal(orbit.advance(5).samples, first)


def test_a_retargeted_orbit_carries_its_vibration_on() -> None:
    orbit = Orbit(paper(operation__speed=6000.0 * RPM))
    last = orbit.advance(50).samples[-1]
    orbit.retarget(paper(operation__speed=6010.0 * RPM))
    first = orbit.advance(1).samples[0]
    step = abs(last[COLUMN["dte_rate"]]) * orbit.period / SAMPLES_PER_PERIOD
    assert abs(first[COLUMN["dte"]] - last[COLUMN["dte"]]) < 3.0 * step
    assert first[COLUMN["driving_speed"]] - last[COLUMN["driving_speed"]] == pytest.approx(
        10.0 * RPM, rel=0.1
    )
    same, other = Orbit(paper()), Orbit(paper())
    same.retarget(paper())
    assert same.advance(5).samples.tobytes() == other.advance(5).samples.tobytes()


@pytest.mark.parametrize(("dte", "state"), [(40e-6, 1.0), (0.0, 0.0), (-40e-6, -1.0)])
def test_a_displaced_orbit_starts_where_it_is_told(dte: float, state: float) -> None:
    orbit = Orbit(paper())
    orbit.displace(dte, 0.02)
    first = orbit.advance(1).samples[0]
    assert first[COLUMN["dte"]] == pytest.approx(dte, abs=1e-15)
    assert first[COLUMN["dte_rate"]] == pytest.approx(0.02, rel=1e-9)
    assert first[COLUMN["meshing_state"]] == state


def test_a_run_that_ends_says_why() -> None:
    orbit = Orbit(paper(operation__speed_limit=1000.0, operation__speed=999.0, operation__drive_torque=90.0))
    record = orbit.advance(200)
    assert orbit.status is Status.OVER_SPEED and orbit.reason.startswith("over-speed: ")
    assert 0 < len(record.samples) < 200 * SAMPLES_PER_PERIOD


def test_what_has_no_period_is_refused() -> None:
    with pytest.raises(UsageError, match="a gearbox that stands still has no mesh period"):
        Orbit(paper(mesh_phase="actual", operation__speed=0.0))
    with pytest.raises(UsageError, match="30 steps per period of the mesh: give a positive multiple of 20"):
        Orbit(paper(), 30)
