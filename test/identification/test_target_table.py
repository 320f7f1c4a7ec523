"""Tables of target numbers, and fits to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.identification.fit import request_of, run_fit
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.motion_quantities import QUANTITIES, measure_of
from gear_dynamics_ros.identification.objective import Problem
from gear_dynamics_ros.identification.search import SearchSettings
from gear_dynamics_ros.identification.target_table import TargetObjective, Watch, read_targets
from gear_dynamics_ros.identification.unknowns import read_unknowns
from gear_dynamics_ros.parameters import Parameters, updated

TABLE = """
transient: 30
keep: 10
conditions: {operation.control: torque, operation.drive_torque: 100.0, operation.load_torque: 100.0}
targets:
  - {quantity: dte_min, value: %g, scale: 1.0e-8, conditions: {operation.speed: 500.0}}
  - {quantity: dte_max, value: %g, scale: 1.0e-8, conditions: {operation.speed: 500.0}}
  - {quantity: dte_mean, value: %g, scale: 1.0e-8, conditions: {operation.speed: 500.0}}
  - {label: slowly, quantity: dte_mean, value: %g, scale: 1.0e-8, conditions: {operation.speed: 200.0}}
"""
CONDITIONS = {"operation.control": "torque", "operation.drive_torque": 100.0, "operation.load_torque": 100.0}
WATCH = Watch(30, 10)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_two_parameters_are_found_from_numbers_at_two_speeds(tmp_path: Path) -> None:
    truth = updated(Parameters(), CONDITIONS | {"mesh.stiffness": 3.2e8, "mesh.error_cos": [8e-6]})
    fast = measure_of(WATCH)(updated(truth, {"operation.speed": 500.0}))
    slow = measure_of(WATCH)(updated(truth, {"operation.speed": 200.0}))
    text = TABLE % (fast["dte_min"], fast["dte_max"], fast["dte_mean"], slow["dte_mean"])
    table = read_targets(written(tmp_path / "table.yaml", text))
    assert table.watch == WATCH
    unknowns = read_unknowns(["mesh.stiffness=2e8:4e8", "mesh.error_cos[0]=6e-6:12e-6"], Parameters())
    objective = TargetObjective(table, measure_of(table.watch), QUANTITIES)
    objective.require_fitting(Parameters(), unknowns)
    problem, settings = Problem(Parameters(), unknowns, objective), SearchSettings(8, 5)
    found = run_fit(problem, settings, FitJournal.create(tmp_path / "fit", request_of(problem, settings)), 2)
    np.testing.assert_allclose(found.values, [3.2e8, 8e-6], rtol=1e-3)
    rows = objective.summary(found.residuals)["targets"]
    assert [row["label"] for row in rows][-1] == "slowly"
    assert rows[-1]["fitted"] == pytest.approx(slow["dte_mean"], rel=1e-3)


def test_several_windows_count_by_their_median() -> None:
    """Of a motion that settles, the second of three windows is the median of what falls or rises."""
    parameters = updated(Parameters(), CONDITIONS | {"operation.speed": 500.0})
    median = measure_of(Watch(0, 10, 3))(parameters)
    parts = [measure_of(Watch(transient, 10))(parameters) for transient in (0, 10, 20)]
    for name in ("dte_max", "driving_penetration_mean"):
        assert median[name] == np.median([part[name] for part in parts])


def test_a_motion_that_trips_says_why() -> None:
    with pytest.raises(GearboxError, match="over-speed"):
        measure_of(WATCH)(updated(Parameters(), {"operation.speed_limit": 1623.2}))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("targets: []", "targets must be a list with at least one entry"),
        ("[1, 2]", "the table is [1, 2], must be a mapping"),
        ("target: [1]", "unknown key 'target'"),
        ("targets: [{quantity: ldmf, value: 1.0}]", "targets[0].scale is None"),
        ("targets: [{quantity: ldmf, value: 1.0, scale: 0.0}]", "scale is 0, must be > 0"),
        ("targets: [{quantity: ldmf, value: high, scale: 1.0}]", "targets[0].value is 'high'"),
        ("targets: [{value: 1.0, scale: 1.0}]", "targets[0] has no quantity"),
        (
            "targets: [{quantity: ldmf, value: 1.0, scale: 1.0, conditions: {mesh.stifness: 1.0}}]",
            "mesh.stiffness",
        ),
        ("targets: [{quantity: ldmf, value: 1.0, scale: 1.0}]\nkeep: 0", "keep is 0"),
        ("targets: [{quantity: ldmf, value: 1.0, scale: 1.0}]\nwindows: 1.5", "windows is 1.5"),
        ("targets: [", "line"),
    ],
)
def test_a_table_with_errors_is_refused_in_words(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path / "table.yaml", text)
    with pytest.raises(UsageError) as refused:
        read_targets(path)
    assert str(refused.value).startswith(f"{path}: ") and told in str(refused.value)


def test_a_table_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.yaml: it can't be read"):
        read_targets(tmp_path / "none.yaml")


def test_unknown_quantities_and_varied_or_invalid_conditions_are_refused(tmp_path: Path) -> None:
    def objective(entry: str) -> TargetObjective:
        table = read_targets(
            written(tmp_path / "table.yaml", f"targets: [{{value: 1.0, scale: 1.0, {entry}}}]")
        )
        return TargetObjective(table, measure_of(table.watch), QUANTITIES)

    with pytest.raises(UsageError, match="there is no quantity dte_maximum: did you mean dte_max"):
        objective("quantity: dte_maximum")
    unknowns = read_unknowns(["mesh.stiffness=2e8:4e8"], Parameters())
    with pytest.raises(UsageError, match=r"its condition mesh\.stiffness is varied"):
        objective("quantity: ldmf, conditions: {mesh.stiffness: 3.0e8}").require_fitting(
            Parameters(), unknowns
        )
    with pytest.raises(UsageError, match=r"targets\[0\] \(ldmf\): operation\.speed"):
        objective("quantity: ldmf, conditions: {operation.speed: 9.0e6}").require_fitting(
            Parameters(), unknowns
        )
