"""Every value that the table of parameters allows: refused in words, or a run that may end for a reason."""

from __future__ import annotations

import math
import warnings
from typing import Any, Final

from hypothesis import given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import (
    Parameters,
    Specification,
    change_values,
    specifications,
)
from gear_dynamics_ros.physics.advice import parameter_warnings
from gear_dynamics_ros.simulation.engine import Engine, require_resumable
from gear_dynamics_ros.simulation.run import Run

CHUNKS: Final = 3
MOST_STEPS: Final = 20_000  # of a chunk: longer ones take the same steps, and the time of this test


def numbers(row: Specification) -> st.SearchStrategy[Any]:
    """Both bounds, and values between them of any magnitude."""
    assert row.minimum is not None and row.maximum is not None
    if row.element is int:
        return st.sampled_from([int(row.minimum), int(row.maximum)])
    lowest = math.nextafter(row.minimum, math.inf) if row.exclusive_minimum else row.minimum
    highest = math.nextafter(row.maximum, -math.inf) if row.exclusive_maximum else row.maximum
    return st.sampled_from([float(lowest), float(highest)]) | st.floats(
        lowest, highest, allow_subnormal=False
    )


def values(row: Specification) -> st.SearchStrategy[Any]:
    if row.type is bool:
        return st.booleans()
    if row.element is str:
        word = st.sampled_from(row.choices) if row.choices else st.just(row.default)
        return st.just(row.default) if row.type is tuple else word
    number = numbers(row)
    if row.type is tuple:
        assert row.length is not None
        return st.integers(*row.length).flatmap(
            lambda count: st.lists(number, min_size=count, max_size=count)
        )
    return number


TABLE: Final = st.lists(st.sampled_from(list(specifications().values())), max_size=5, unique=True).flatmap(
    lambda rows: st.fixed_dictionaries({row.name: values(row) for row in rows})
)


def short_chunks(parameters: Parameters) -> Parameters | None:
    """``parameters`` with chunks of one sample where theirs have many steps; None if a sample has many."""
    solver = parameters.solver
    if solver.steps_per_sample > MOST_STEPS:
        return None
    if solver.samples_per_chunk * solver.steps_per_sample <= MOST_STEPS:
        return parameters
    return Parameters.from_flat({**parameters.to_flat(), "solver.chunk": solver.sample_interval})


def begin(given: dict[str, Any]) -> Run | None:
    """A run with ``given`` values, warned of as a start warns; None if they are refused, in words."""
    try:
        parameters = short_chunks(Parameters.from_flat(given))
    except UsageError as error:
        assert any(name in str(error) for name in specifications()), (given, error)
        return None
    if parameters is None:
        return None
    assert all("\n" not in line for line in parameter_warnings(parameters))
    return Run(Engine(parameters), Encoder(parameters, 0))


def go_on(run: Run) -> None:
    for _ in range(CHUNKS):
        if run.state.ended:
            assert run.state.reason
            return
        run.step()


@given(TABLE, TABLE)
@settings(max_examples=250, deadline=None)
def test_whatever_the_table_allows_is_refused_or_runs(
    at_start: dict[str, Any], later: dict[str, Any]
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = begin(at_start)
        if run is None:
            return
        go_on(run)
        rows = specifications()
        try:
            change = change_values(
                run.engine.parameters, {name: value for name, value in later.items() if rows[name].runtime}
            )
        except UsageError:
            return
        if not run.state.ended:
            run.change(change)
            go_on(run)


def test_each_bound_alone_is_refused_or_runs() -> None:
    for row in specifications().values():
        if row.element in (int, float) and not row.name.startswith(("recording", "rerun", "pacing")):
            for bound in (row.minimum, row.maximum):
                assert bound is not None
                value = row.element(bound)
                run = (
                    None if bound in _exclusive(row) else begin({row.name: [value] if row.length else value})
                )
                if run is not None:
                    go_on(run)


def _exclusive(row: Specification) -> list[float | None]:
    sides = ((row.exclusive_minimum, row.minimum), (row.exclusive_maximum, row.maximum))
    return [bound for exclusive, bound in sides if exclusive]


@given(
    st.sampled_from(["traditional", "compared", "improved"]),
    st.sampled_from(["actual", "nominal"]),
    st.floats(-4000.0, 4000.0),
    st.floats(-100.0, 100.0),
    st.integers(5, 60),
)
@settings(max_examples=40, deadline=None)
def test_no_state_that_a_run_has_is_refused(
    model: str, phase: str, speed: float, torque: float, teeth: int
) -> None:
    values = {"model": model, "mesh_phase": phase, "operation.speed": speed, "operation.load_torque": torque}
    engine = Engine(Parameters.from_flat({**values, "gears.driven.teeth": teeth}))
    for _ in range(6):
        if engine.advance(33).message:
            return
        require_resumable(engine.checkpoint())


def test_the_limit_and_what_exceeds_it_are_told_apart() -> None:
    limit = repr(math.nextafter(math.pi / 3.0, 4.0))
    for name, value in {"gears.pressure_angle": limit, "mesh.error_mean": "0.10000000000000002"}.items():
        try:
            Parameters.from_flat({name: float(value)})
        except UsageError as error:
            assert value in str(error) and specifications()[name].limits in str(error)
            assert value not in specifications()[name].limits
        else:
            raise AssertionError(name)
