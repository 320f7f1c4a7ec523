"""Search, errors, journal: on residuals with known answers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.identification.fit import Fit, request_of, run_fit
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.objective import Problem
from gear_dynamics_ros.identification.report import fit_text, fit_to_json, write_fit
from gear_dynamics_ros.identification.search import SearchSettings, independent_directions
from gear_dynamics_ros.identification.unknowns import read_unknowns
from gear_dynamics_ros.parameters import Parameters, load_parameters

SHORT = SearchSettings(generations=12, population=8, seed=3)
OPTIONS = ("mesh.stiffness=2e8:4e8", "oil.viscosity=0.01:0.09")
TRUTH = Parameters.from_flat({"mesh.stiffness": 3.3e8, "oil.viscosity": 0.03})
POSITIONS = np.linspace(0.0, 1.0, 40)
NOISE = 0.01


class Formula:
    """Residuals of a formula in the parameters, with noise."""

    difference = 1e-6

    def __init__(self, model: Callable[[Parameters], NDArray[np.float64]], noise: float = NOISE) -> None:
        self.model = model
        self.measured = model(TRUTH) + noise * np.random.default_rng(5).normal(size=len(POSITIONS))
        self.count = len(POSITIONS)
        self.stages = (self.count,)

    def residuals(self, parameters: Parameters) -> NDArray[np.float64]:
        return self.measured - self.model(parameters)

    def identity(self) -> Mapping[str, Any]:
        return {"measured": self.measured.tolist()}

    def summary(self, residuals: NDArray[np.float64]) -> Mapping[str, Any]:
        return {}

    def table(self, residuals: NDArray[np.float64]) -> tuple[list[str], list[list[object]]]:
        return ["residual"], [[value] for value in residuals.tolist()]


def line(parameters: Parameters) -> NDArray[np.float64]:
    return parameters.mesh.stiffness / 1e8 * POSITIONS + parameters.oil.viscosity * 10.0


def product(parameters: Parameters) -> NDArray[np.float64]:
    return parameters.mesh.stiffness / 1e8 * parameters.oil.viscosity * POSITIONS


def problem_of(
    model: Callable[[Parameters], NDArray[np.float64]], *options: str, noise: float = NOISE
) -> Problem:
    return Problem(Parameters(), read_unknowns(options or OPTIONS, Parameters()), Formula(model, noise))


def fit(
    problem: Problem, folder: Path, settings: SearchSettings = SHORT, workers: int = 2, **more: Any
) -> Fit:
    return run_fit(
        problem, settings, FitJournal.create(folder, request_of(problem, settings)), workers, **more
    )


def test_values_and_errors_of_a_linear_model_are_those_of_the_closed_form(tmp_path: Path) -> None:
    problem = problem_of(line)
    found = fit(problem, tmp_path / "fit")
    columns = np.stack([POSITIONS / 1e8, np.full(len(POSITIONS), 10.0)], axis=1)
    best, squares, _, _ = np.linalg.lstsq(columns, problem.objective.measured)  # type: ignore[attr-defined]
    covariance = squares[0] / (len(POSITIONS) - 2) * np.linalg.inv(columns.T @ columns)
    errors = found.uncertainty
    assert errors is not None
    np.testing.assert_allclose(found.values, best, rtol=1e-8)
    np.testing.assert_allclose(errors.standard_errors, np.sqrt(np.diag(covariance)), rtol=1e-4)
    np.testing.assert_allclose(errors.covariance, covariance, rtol=1e-4)
    assert errors.correlation[0, 1] == pytest.approx(-np.sqrt(3.0) / 2.0, abs=0.02)
    assert (errors.directions, errors.at_bound) == ((), (False, False))


def test_two_parameters_that_act_as_a_product_are_named(tmp_path: Path) -> None:
    found = fit(problem_of(product), tmp_path / "fit")
    assert found.uncertainty is not None
    (direction,) = found.uncertainty.directions
    changes = direction.changes
    assert direction.flat and changes.keys() == {"mesh.stiffness", "oil.viscosity"}
    assert sorted(changes.values()) == pytest.approx([-1.0, 1.0], abs=0.02)
    assert np.isnan(found.uncertainty.standard_errors).all()
    page = fit_text(found, "a formula")
    assert "not determined" in page and "no change of the residuals" in page
    best = POSITIONS @ found.problem.objective.measured / (POSITIONS @ POSITIONS)  # type: ignore[attr-defined]
    assert found.values.prod() == pytest.approx(1e8 * best, rel=1e-6)
    assert fit_to_json(found, "")["unknowns"][0]["standard_error"] is None


def test_a_parameter_without_effect_is_named_and_the_other_determined(tmp_path: Path) -> None:
    found = fit(problem_of(lambda parameters: parameters.mesh.stiffness / 1e8 * POSITIONS), tmp_path / "fit")
    assert found.uncertainty is not None
    errors = found.uncertainty.standard_errors
    assert np.isfinite(errors[0]) and np.isnan(errors[1])
    assert "oil.viscosity: the data don't depend on it" in fit_text(found, "")


def test_an_effect_below_the_noise_is_named(tmp_path: Path) -> None:
    def faint(parameters: Parameters) -> NDArray[np.float64]:
        return parameters.mesh.stiffness / 1e8 * POSITIONS + 0.01 * parameters.oil.viscosity

    found = fit(problem_of(faint), tmp_path / "fit")
    assert found.uncertainty is not None
    (direction,) = found.uncertainty.directions
    assert not direction.flat and list(direction.changes) == ["oil.viscosity"]
    assert "hardly depend" in fit_text(found, "")


def test_a_parameter_at_its_bound_is_named(tmp_path: Path) -> None:
    found = fit(problem_of(line, "mesh.stiffness=2e8:3e8", OPTIONS[1]), tmp_path / "fit")
    assert found.uncertainty is not None
    assert found.uncertainty.at_bound == (True, False)
    assert found.values[0] == pytest.approx(3e8, rel=1e-3)
    assert "At a bound" in fit_text(found, "")


def test_errors_grow_with_the_noise(tmp_path: Path) -> None:
    quiet = fit(problem_of(line), tmp_path / "quiet").uncertainty
    loud = fit(problem_of(line, noise=3.0 * NOISE), tmp_path / "loud").uncertainty
    assert quiet is not None and loud is not None
    np.testing.assert_allclose(loud.standard_errors, 3.0 * quiet.standard_errors, rtol=1e-6)


def test_the_number_of_workers_changes_no_bit(tmp_path: Path) -> None:
    for workers in (1, 2, 5):
        folder = tmp_path / str(workers)
        write_fit(fit(problem_of(product), folder, workers=workers), folder, "")
    contents = [files(tmp_path / str(workers)) for workers in (1, 2, 5)]
    assert contents[0] == contents[1] == contents[2]


def files(folder: Path) -> dict[str, bytes]:
    """All files that a fit leaves, but for its batches."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("calls", [1, 5, 14, 17])
def test_an_interrupted_fit_goes_on_to_the_same_bits(tmp_path: Path, calls: int) -> None:
    problem = problem_of(line)
    whole = tmp_path / "whole"
    write_fit(fit(problem, whole), whole, "")

    batches = 0

    def count(_: object) -> None:
        nonlocal batches
        batches += 1

    folder = tmp_path / "interrupted"
    part = fit(problem, folder, progress=count, stopped=lambda: "SIGINT" if batches >= calls else "")
    assert part.stopped == "SIGINT" and part.uncertainty is None
    write_fit(part, folder, "")
    told = fit_to_json(part, "")
    assert (told["complete"], told["stopped"]) == (False, "SIGINT")
    assert "stopped by SIGINT" in (folder / "report.txt").read_text()
    assert load_parameters(folder / "parameters.yaml") == part.parameters

    again = FitJournal.reopen(folder, request_of(problem, SHORT))
    write_fit(run_fit(problem, SHORT, again, 1), folder, "")
    assert files(folder) == files(whole)


def test_what_was_computed_is_not_computed_again(tmp_path: Path) -> None:
    problem = problem_of(line)
    done = fit(problem, tmp_path / "fit")

    def refuse(parameters: Parameters) -> NDArray[np.float64]:
        raise AssertionError("computed again")

    problem.objective.model = refuse  # type: ignore[attr-defined]
    again = run_fit(problem, SHORT, FitJournal.reopen(tmp_path / "fit", request_of(problem, SHORT)), 2)
    assert again.values.tobytes() == done.values.tobytes()


def test_failed_trials_are_counted_and_the_fit_goes_round_them(tmp_path: Path) -> None:
    def partly(parameters: Parameters) -> NDArray[np.float64]:
        if parameters.mesh.stiffness > 3.5e8:
            raise GearboxError(f"over-speed: {parameters.mesh.stiffness}")
        return line(parameters)

    found = fit(problem_of(partly), tmp_path / "fit")
    (failures,) = found.failures.values()
    assert 0 < failures.number < found.evaluated
    assert found.values[0] == pytest.approx(3.3e8, rel=0.02)
    assert f"{failures.number} failed, such as: over-speed" in fit_text(found, "")


def test_derivatives_beside_a_failure_are_taken_from_the_other_side(tmp_path: Path) -> None:
    edge = 3.2e8

    def partly(parameters: Parameters) -> NDArray[np.float64]:
        if parameters.mesh.stiffness > edge:
            raise GearboxError("pressed")
        return line(parameters)

    base = Parameters.from_flat({"mesh.stiffness": edge})
    objective = Formula(line)
    objective.model = partly
    problem = Problem(base, read_unknowns(OPTIONS, base), objective)
    found = fit(problem, tmp_path / "fit", SearchSettings(generations=0))
    assert found.optimum is not None
    np.testing.assert_allclose(found.optimum.jacobian[:, 0], -2.0 * POSITIONS, rtol=1e-6, atol=1e-9)


def test_if_every_trial_fails_that_is_an_error_with_the_reason(tmp_path: Path) -> None:
    objective = Formula(line)

    def never(parameters: Parameters) -> NDArray[np.float64]:
        raise GearboxError("the centres are pressed together")

    objective.model = never
    problem = Problem(Parameters(), read_unknowns(OPTIONS, Parameters()), objective)
    with pytest.raises(
        GearboxError, match=r"none of the .* trials could be computed: the centres are pressed"
    ):
        fit(problem, tmp_path / "fit")


def test_values_that_do_not_fit_each_other_are_failed_trials(tmp_path: Path) -> None:
    options = ("bearings.driving.clearance=1e-5:3e-4", "mesh.stiffness=2e8:4e8")
    found = fit(problem_of(line, *options), tmp_path / "fit")
    assert any("oil_clearance" in failures.example for failures in found.failures.values())


def test_more_unknowns_than_data_are_refused(tmp_path: Path) -> None:
    problem = problem_of(line)
    problem.objective.count = 1  # type: ignore[misc]
    with pytest.raises(UsageError, match="1 data can't determine 2 unknowns"):
        fit(problem, tmp_path / "fit")


def test_the_folder_of_another_fit_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "fit"
    fit(problem_of(line), folder, SearchSettings(generations=0))
    with pytest.raises(UsageError, match="exists already"):
        fit(problem_of(line), folder)
    with pytest.raises(UsageError, match=r"another fit: search\.generations is 0 there and 12 here"):
        FitJournal.reopen(folder, request_of(problem_of(line), SHORT))
    with pytest.raises(UsageError, match="holds no fit"):
        FitJournal.reopen(tmp_path / "none", request_of(problem_of(line), SHORT))


def test_a_damaged_batch_is_named(tmp_path: Path) -> None:
    problem = problem_of(line)
    folder = tmp_path / "fit"
    fit(problem, folder)
    path = folder / "evaluations" / "000003.npz"
    for content in (path.read_bytes()[:100], (folder / "evaluations" / "000004.npz").read_bytes()):
        path.write_bytes(content)
        with pytest.raises(GearboxError, match=r"000003\.npz' .*remove it"):
            run_fit(problem, SHORT, FitJournal.reopen(folder, request_of(problem, SHORT)), 1)


def test_trials_run_on_as_many_threads_as_asked_for(tmp_path: Path) -> None:
    both = threading.Barrier(2, timeout=30.0)
    met = threading.Event()

    def together(parameters: Parameters) -> NDArray[np.float64]:
        if not met.is_set():
            both.wait()
            met.set()
        return line(parameters)

    objective = Formula(line)
    objective.model = together
    problem = Problem(Parameters(), read_unknowns(OPTIONS, Parameters()), objective)
    assert fit(problem, tmp_path / "fit", workers=2).stopped == ""


@pytest.mark.parametrize("shape", [(50_000, 3), (2, 3)])
def test_directions_of_many_or_few_residuals(shape: tuple[int, int]) -> None:
    """Of many: the singular vectors of the residuals, all by all, would take gigabytes."""
    jacobian = np.random.default_rng(1).normal(size=shape)
    singular, directions = independent_directions(jacobian)
    np.testing.assert_allclose(directions @ directions.T, np.eye(3), atol=1e-12)
    powers = directions @ jacobian.T @ jacobian @ directions.T
    np.testing.assert_allclose(powers, np.diag(singular**2), rtol=1e-9, atol=1e-9)
