"""Recordings as data of a fit: the same run again, under other parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.identification.fit import Fit, request_of, run_fit
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Problem
from gear_dynamics_ros.identification.recorded_motion import (
    MotionObjective,
    parameters_as_recorded,
    read_motion,
    require_not_recorded,
)
from gear_dynamics_ros.identification.search import SearchSettings
from gear_dynamics_ros.identification.unknowns import read_unknowns
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.recording import Recording
from support.recordings import SHORT, Recorded, following, record
from support.sensor_noise import record_with_noise

TRUTH = updated(
    Parameters(),
    {
        "bearings.driving.clearance": 31e-6,
        "bearings.driven.clearance": 31e-6,
        "oil.viscosity": 0.03,
        "mesh.stiffness": 3.3e8,
        "recording.checkpoint_interval": 0.002,
    },
)
NOISE = {"driving_x": 5e-8, "driving_y": 5e-8, "dte": 2e-7}  # m, about a hundredth of each
OPTIONS = ("bearings.*.clearance=20e-6:40e-6", "oil.viscosity=0.01:0.06", "mesh.stiffness=2e8:4e8")
VALUES = np.array([31e-6, 0.03, 3.3e8])
QUICK = SearchSettings(generations=8, population=7)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recording.open(record_with_noise(tmp_path_factory.mktemp("noisy") / "bag", TRUTH, NOISE, 0.01))


def problem_of(
    bag: Recording,
    channels: Sequence[str],
    options: Sequence[str],
    *window: float,
    base: Parameters | None = None,
) -> Problem:
    motion = read_motion(bag, channels, *window)
    base = parameters_as_recorded(Parameters() if base is None else base, motion)
    return Problem(base, read_unknowns(options, base), MotionObjective(motion, base))


def fitted(problem: Problem, folder: Path, settings: SearchSettings = QUICK, workers: int = 2) -> Fit:
    return run_fit(problem, settings, FitJournal.create(folder, request_of(problem, settings)), workers)


@pytest.fixture(scope="module")
def found(noisy: Recording, tmp_path_factory: pytest.TempPathFactory) -> Fit:
    return fitted(
        problem_of(noisy, tuple(NOISE), OPTIONS, 0.0, 0.002), tmp_path_factory.mktemp("fit") / "fit"
    )


def test_three_parameters_are_found_within_their_errors(found: Fit) -> None:
    assert found.uncertainty is not None
    errors = found.uncertainty.standard_errors
    assert (np.abs(found.values - VALUES) < 3.0 * errors).all()
    assert (errors < 0.01 * VALUES).all()
    assert found.uncertainty.directions == ()
    for name, entry in found.problem.objective.summary(found.residuals)["channels"].items():
        assert entry["residual_rms"] == pytest.approx(NOISE[name], rel=0.15)
        assert abs(entry["neighbour_correlation"]) < 4.0 / np.sqrt(200)


def test_errors_grow_with_the_noise_and_hold_the_truth(found: Fit, tmp_path: Path) -> None:
    louder = {name: 4.0 * deviation for name, deviation in NOISE.items()}
    bag = recording.open(record_with_noise(tmp_path / "bag", TRUTH, louder, 0.004, seed=2))
    loud = fitted(problem_of(bag, tuple(NOISE), OPTIONS, 0.0, 0.002), tmp_path / "fit")
    assert loud.uncertainty is not None and found.uncertainty is not None
    errors = loud.uncertainty.standard_errors
    assert (np.abs(loud.values - VALUES) < 3.0 * errors).all()
    np.testing.assert_allclose(errors / found.uncertainty.standard_errors, 4.0, rtol=0.15)


def test_two_moduli_that_act_together_are_named(noisy: Recording, tmp_path: Path) -> None:
    options = [f"bearings.{part}.youngs_modulus=1.5e11:3e11" for part in ("shaft", "sleeve")]
    problem = problem_of(noisy, ["driving_x", "driving_y"], [*options, OPTIONS[0]], 0.0, 0.001, base=TRUTH)
    found = fitted(problem, tmp_path / "fit", SearchSettings(generations=0))
    assert found.uncertainty is not None
    (direction,) = found.uncertainty.directions
    assert set(direction.changes) == {"bearings.shaft.youngs_modulus", "bearings.sleeve.youngs_modulus"}
    assert sorted(direction.changes.values()) == pytest.approx([-1.0, 1.0], abs=0.1)


def test_the_truth_gives_the_recording_to_the_bit(tmp_path: Path) -> None:
    """Also from a checkpoint in the middle, through changes of commands."""
    parameters = updated(TRUTH, SHORT | {"recording.checkpoint_interval": 0.001})
    deeds = [Commands(30.0 + chunk % 3, 30.0, 1600.0 + 5.0 * (chunk % 4)) for chunk in range(20)]
    bag = record(tmp_path / "bag", parameters, 20, following(deeds))
    for window in ((0.0, 0.004), (0.0021, 0.0049)):
        motion = read_motion(bag, ["dte", "driven_y", "driving_speed"], *window)
        assert motion.fresh == (motion.start.sample == 0) == (window[0] == 0.0)
        objective = MotionObjective(motion, parameters_as_recorded(parameters, motion))
        assert not objective.residuals(parameters_as_recorded(parameters, motion)).any()
        other = updated(parameters, {"mesh.stiffness": 3.31e8})
        assert objective.residuals(parameters_as_recorded(other, motion)).any()


def test_a_recording_that_was_begun_during_the_run_is_repeated_too(tmp_path: Path) -> None:
    parameters = updated(TRUTH, SHORT)
    deeds = [Commands(30.0 + chunk % 3, 30.0, 1600.0) for chunk in range(20)]
    bag = record(tmp_path / "bag", parameters, 20, following(deeds), begin=4)
    motion = read_motion(bag, ["dte"])
    assert not motion.fresh and motion.measured.first == 120
    base = parameters_as_recorded(parameters, motion)
    assert not MotionObjective(motion, base).residuals(base).any()


def test_the_start_the_commands_and_the_samples_are_those_of_the_recording(noisy: Recording) -> None:
    motion = read_motion(noisy, ["dte"])
    others = {"operation.speed": 500.0, "solver.sample_interval": 2e-5, "mesh.stiffness": 2.9e8}
    base = parameters_as_recorded(updated(Parameters(), others), motion)
    assert base.operation.speed == TRUTH.operation.speed
    assert base.solver.sample_interval == TRUTH.solver.sample_interval
    assert base.mesh.stiffness == 2.9e8


def test_the_default_window_is_forty_periods_of_the_mesh(noisy: Recording) -> None:
    period = 2.0 * np.pi / (40 * TRUTH.operation.speed)
    measured = read_motion(noisy, ["dte"]).measured
    assert measured.first == 0 and len(measured) == np.ceil(40 * period / 1e-5)
    later = read_motion(noisy, ["dte"], 0.004).measured
    assert later.first == 400 and len(later) == len(measured)


def test_a_smaller_step_than_that_of_the_recording_may_be_fitted_with(noisy: Recording) -> None:
    motion = read_motion(noisy, ["driving_x"], 0.005, 0.007)
    assert not motion.fresh
    base = parameters_as_recorded(updated(TRUTH, {"solver.step": 1e-6}), motion)
    residuals = MotionObjective(motion, base).residuals(base)
    assert np.isfinite(residuals).all() and residuals.std() < 0.2


@pytest.mark.parametrize(
    ("channels", "window", "told"),
    [
        (["dte", "speed"], (), "there is no channel 'speed'"),
        (["time"], (), "--channels time"),
        (["meshing_state"], (), "--channels meshing_state"),
        (["dte", "dte"], (), "names dte twice"),
        ([""], (), "names no channel"),
        (["load_torque"], (0.0, 0.002), "load_torque: it is constant in the window"),
        (["dte"], (0.003, 0.003), "is empty"),
        (["dte"], (0.003, 0.002), "is empty"),
        (["dte"], (1.0, 2.0), "has no sample from 1 s to 2 s"),
        (["dte"], (float("nan"), 1.0), "is not finite"),
    ],
)
def test_what_can_not_be_fitted_is_refused_in_words(
    noisy: Recording, channels: list[str], window: tuple[float, ...], told: str
) -> None:
    with pytest.raises(UsageError) as refused:
        problem_of(noisy, channels, OPTIONS, *window)
    assert told in str(refused.value)


def test_what_was_not_recorded_is_named(tmp_path: Path) -> None:
    few = updated(Parameters(), SHORT | {"waveform_channels": ["time", "dte"]})
    bag = record(tmp_path / "few", few, 4)
    with pytest.raises(UsageError, match=r"there is no channel 'driving_x' in .*: it has time, dte"):
        read_motion(bag, ["driving_x"])
    without = updated(Parameters(), SHORT | {"recording.topics": ["joint_states"]})
    with pytest.raises(UsageError, match="has no waveform"):
        read_motion(record(tmp_path / "without", without, 4), ["dte"])


def test_a_window_behind_an_event_that_is_not_repeated_is_refused(tmp_path: Path) -> None:
    made = Recorded(tmp_path / "bag", updated(Parameters(), SHORT))
    made.steps(5)
    made.run.reset()
    made.steps(5)
    made.close()
    bag = recording.open(tmp_path / "bag")
    assert len(read_motion(bag, ["dte"], 0.0, 0.0015).measured) == 150
    with pytest.raises(UsageError, match=r"a reset at 0\.0015 s"):
        read_motion(bag, ["dte"], 0.0, 0.002)


def test_a_window_without_speed_needs_an_end(tmp_path: Path) -> None:
    still = updated(Parameters(), SHORT | {"operation.speed": 0.0, "operation.control": "torque"})
    bag = record(tmp_path / "bag", still, 10)
    with pytest.raises(UsageError, match="give --to"):
        read_motion(bag, ["dte"])
    assert len(read_motion(bag, ["dte"], None, 0.001).measured) == 100


def test_a_trial_that_ends_early_says_why(noisy: Recording) -> None:
    problem = problem_of(noisy, ["dte"], OPTIONS)
    with pytest.raises(GearboxError, match="over-speed"):
        problem.objective.residuals(updated(problem.base, {"operation.speed_limit": 1623.2}))


def test_what_the_recording_gives_is_not_varied() -> None:
    with pytest.raises(UsageError, match=r"operation\.load_torque: the recording gives it"):
        require_not_recorded(read_unknowns(["operation.load_torque=20:40"], Parameters()))


def test_a_window_that_is_too_long_is_refused(noisy: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gear_dynamics_ros.identification.recorded_motion.MOST_SAMPLES", 500)
    with pytest.raises(UsageError, match="the window has 600 samples, the limit is 500"):
        read_motion(noisy, ["dte"], 0.0, 0.006)
