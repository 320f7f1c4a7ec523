"""Parameters: bounds and fits, and that files mean to our reader what they mean to the real parser of ROS."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Iterator
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import (
    GearPairParameters,
    GearParameters,
    Parameters,
    Specification,
    change_to,
    differences,
    dump_parameters,
    load_parameters,
    parameters_page,
    specifications,
)
from gear_dynamics_ros.parameters.rcl_yaml import SMALLEST_NORMAL, parse_yaml, resolve_scalar, scalar_text
from support.paths import ROOT
from support.published import published_gearbox

NUMBERS = """
    0 1 -1 +1 007 010 08 09.5 0x1F 0X1f -0x10 +0x10 0x 0b11 0o17 1_000 12:30 -0 +0 00 -010
    0x8000000000000000 0x7fffffffffffffff
    9223372036854775807 9223372036854775808 -9223372036854775808 -9223372036854775809
    1. .5 +.5 -.5 . 1.5 3.0e8 3.0e+8 3e8 1e-6 1E-6 1e 1e+ e5 1.5.1 +-1 --1 1e400 -1e400 1e-400 1e-310 -1e-310
    1e308 2.2250738585072014e-308
    0e400 0.0 -0.0 0x1p3 0x1.8 0x.8p1 0x1.p-2 0x.p1 0x1p 0x1p5000 0x1p-5000 1p3 1f 1d
    .inf .Inf .INF .iNF +.inf +.Inf -.inf -.INF .nan .NaN .NAN .Nan -.nan +.nan inf Inf INF -inf +infinity
    INFINITY infin nan NaN -nan +nan nan(1) nan() inf() .infinity inf1
    Y y yes Yes YES yEs true True TRUE tRUE on On ON oN N n no No NO nO false False FALSE off Off OFF oFF
    null Null ~ none text 5m 3.0e8x 2026-11-23 0.1.2 1e5e5 \N{ARABIC-INDIC DIGIT THREE} 1\N{NO-BREAK SPACE}
"""
NUMBER_TEXTS = NUMBERS.split()
YAML_TEXTS = [
    *("'5'", '"5"', '"1.5"', "'yes'", "''", '""', "!!str 5", "!!str yes", "!!int '5'", "!!float 5", '" 5"'),
    *(
        "[1, 2]",
        "[1.0, .5]",
        "[0x10, 010]",
        "[yes, off]",
        "[a, b]",
        "['1', '2']",
        "[1e-6]",
        "1 # note",
        "a#b",
    ),
    *("|-\n        5", "|-\n        1e-6", ">-\n        a\n        b", '"\N{GREEK SMALL LETTER MU}"'),
]


@pytest.fixture(scope="module")
def read_by_ros(
    module_ros_domain: int, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[str], dict[str, Any]]]:
    """What a real ROS node called gearbox takes from the text of a parameter file."""
    from rclpy.context import Context
    from rclpy.node import Node

    file = tmp_path_factory.mktemp("ros") / "parameters.yaml"
    context = Context()
    context.init(domain_id=module_ros_domain)

    def read(text: str) -> dict[str, Any]:
        file.write_text(text, encoding="utf-8")
        node = Node(
            "gearbox",
            context=context,
            cli_args=["--ros-args", "--params-file", str(file)],
            start_parameter_services=False,
            enable_rosout=False,
        )
        try:
            return {name: parameter.value for name, parameter in node._parameter_overrides.items()}
        finally:
            node.destroy_node()

    yield read
    context.shutdown()


def file_of(directory: Path, text: str) -> Path:
    file = directory / "parameters.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def section(body: str, name: str = "/**") -> str:
    return f"{name}:\n  ros__parameters:\n    {body}\n"


def bits(value: object) -> object:
    """Something equal only for values of one type and the same bits; every NaN is one."""
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        return [bits(entry) for entry in value]  # type: ignore[attr-defined]
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack(">d", value)
    return type(value), value


def refusal(values: dict[str, Any]) -> str:
    with pytest.raises(UsageError) as refused:
        Parameters.from_flat(values)
    message = str(refused.value)
    assert "\n" not in message
    return message


# The table


def test_every_leaf_is_described_and_every_number_is_bounded() -> None:
    rows = specifications()
    assert list(rows) == list(Parameters().to_flat())
    for name, row in rows.items():
        assert row.name == name and row.help and "|" not in row.help
        if row.element in (int, float):
            assert row.minimum is not None and row.maximum is not None
            assert math.isfinite(row.minimum) and math.isfinite(row.maximum)
        assert (row.length is not None) == (row.type is tuple)


def test_what_fixes_the_grid_of_samples_the_geometry_or_a_file_is_fixed_while_it_runs() -> None:
    fixed = {name for name, row in specifications().items() if not row.runtime}
    groups = ("gears.", "solver.", "recording.", "rerun.", "checkpoint.")
    assert {name for name in specifications() if name.startswith(groups)} <= fixed
    assert {"model", "joint_prefix", "waveform_channels", "autostart"} <= fixed
    assert {"oil.viscosity", "mesh.stiffness", "operation.control", "pacing.real_time_factor"}.isdisjoint(
        fixed
    )


def test_a_change_of_what_is_fixed_names_the_parameter_and_both_values() -> None:
    old = Parameters()
    thicker = Parameters.from_flat({"oil.viscosity": 0.05})
    assert differences(old, thicker) == {"oil.viscosity": 0.05}
    assert change_to(old, thicker).values == {"oil.viscosity": 0.05}
    with pytest.raises(UsageError, match=r"^model = improved is fixed .* model = compared$"):
        change_to(old, Parameters.from_flat({"oil.viscosity": 0.05, "model": "compared"}))


def numbers() -> list[Specification]:
    return [row for row in specifications().values() if row.element in (int, float)]


@pytest.mark.parametrize("row", numbers(), ids=lambda row: row.name)
def test_a_number_past_a_bound_is_refused_by_name_value_and_limit(row: Specification) -> None:
    assert row.minimum is not None and row.maximum is not None
    if row.element is int:
        beyond: list[float] = [int(row.minimum) - 1, int(row.maximum) + 1]
    else:
        below = row.minimum if row.exclusive_minimum else math.nextafter(row.minimum, -math.inf)
        above = row.maximum if row.exclusive_maximum else math.nextafter(row.maximum, math.inf)
        beyond = [below, above, math.inf, -math.inf, math.nan]
    for value in beyond:
        message = refusal({row.name: [value] if row.type is tuple else value})
        assert row.name in message and scalar_text(value) in message and row.limits in message


@pytest.mark.parametrize("row", specifications().values(), ids=lambda row: row.name)
def test_a_value_of_another_type_is_refused_by_name(row: Specification) -> None:
    wrong: list[object] = [None, b"1", {}, [], [[1.0]], 1 + 1j]
    wrong += ["1.0"] if row.element is not str else [1, 1.0, True]
    wrong += [True] if row.element in (int, float) else []
    wrong += [2.0, 2.5] if row.element is int else []
    wrong += [1, 0.0] if row.element is bool else []
    wrong += [1.0, "dte"] if row.type is tuple else [[row.default]]
    for value in wrong:
        assert row.name in refusal({row.name: value})


@pytest.mark.parametrize("row", [r for r in specifications().values() if r.choices], ids=lambda row: row.name)
def test_an_unknown_word_is_refused_with_the_choices(row: Specification) -> None:
    message = refusal({row.name: ["time", "tim"] if row.type is tuple else "exakt"})
    assert row.name in message and row.limits in message


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("gears.modul", "did you mean gears.module?"),
        ("operation.sped", "did you mean operation.speed?"),
        ("viscosity", "did you mean oil.viscosity?"),
        ("gears.driving", "gears.driving.teeth"),
        ("model.kind", "model"),
        ("zzz", "docs/parameters.md"),
        ("", "docs/parameters.md"),
    ],
)
def test_an_unknown_name_gets_a_hint(name: str, hint: str) -> None:
    message = refusal({name: 1})
    assert name in message and hint in message


@pytest.mark.parametrize("chunk", [2e-3, 3e-4, 1.7e-4])
def test_the_clock_may_come_with_every_chunk(chunk: float) -> None:
    Parameters.from_flat({"solver.chunk": chunk, "clock_rate": 1.0 / chunk})


def test_names_of_every_ros_node_are_passed_over() -> None:
    ours = {"use_sim_time": True, "start_type_description_service": True, "qos_overrides./clock.depth": 3}
    assert Parameters.from_flat(ours) == Parameters()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"bearings.driving.clearance": 2e-4},
            ["bearings.driving.oil_clearance", "0.00015", "bearings.driving.clearance", "0.0002"],
        ),
        (
            {"bearings.driven.oil_clearance": 27e-6},
            ["bearings.driven.oil_clearance", "bearings.driven.clearance"],
        ),
        ({"mesh.stiffness_cos": [0.6], "mesh.stiffness_sin": [0.0, -0.4]}, ["mesh.stiffness_cos", "< 1"]),
        (
            {"mesh.stiffness_cos": [0.6], "mesh.stiffness_sin": [0.8]},
            ["mesh.stiffness_sin", "total amplitude of 1:"],
        ),
        ({"mesh.error_cos": []}, ["mesh.error_cos", "0 entries", "1 to 32"]),
        ({"mesh.error_cos": [0.0] * 33}, ["mesh.error_cos", "33 entries"]),
        ({"surface.waves": 32}, ["surface.waves = 32", "surface.scale = 1.5", "200000"]),
        ({"operation.speed": -5000.1}, ["operation.speed = -5000.1", "operation.speed_limit = 5000.0"]),
        ({"operation.initial": "rest", "mesh_phase": "nominal"}, ["operation.initial", "rest", "mesh_phase"]),
        ({"solver.sample_interval": 2.1e-6}, ["solver.sample_interval = 2.1e-06", "1.05 steps"]),
        ({"solver.sample_interval": 1.00005e-5}, ["solver.sample_interval", "10000.5 nanoseconds"]),
        (
            {"solver.step": 3e-6},
            ["solver.sample_interval", "3.3333333333333335 steps of 3.0e-06 s", "9.0e-06 or 1.2e-05"],
        ),
        ({"solver.step": 2e-5}, ["solver.sample_interval", "0.5 steps"]),
        ({"solver.chunk": 1.5e-5}, ["solver.chunk = 1.5e-05", "1.5 samples"]),
        (
            {"solver.chunk": 10.0, "solver.sample_interval": 2e-6},
            ["solver.chunk", "5000000 samples", "1000000"],
        ),
        ({"clock_rate": 501.0}, ["clock_rate = 501.0 Hz", "solver.chunk = 0.002 s", "to 500 Hz"]),
        ({"clock_rate": 1e4, "solver.chunk": 3e-4}, ["clock_rate", "to 3333.33333 Hz"]),
        ({"waveform_channels": ["dte", "time"]}, ["waveform_channels", "time"]),
        ({"waveform_channels": ["time", "dte", "dte"]}, ["waveform_channels", "'dte' 2 times"]),
        ({"rerun.mode": "save"}, ["rerun.path", "save"]),
        ({"rerun.mode": "connect", "rerun.url": "localhost"}, ["rerun.url", "localhost"]),
        ({"joint_prefix": "a\nb"}, ["joint_prefix", "printed"]),
        ({"mesh.error_mean": 1e-310}, ["mesh.error_mean", "write 0.0"]),
        ({"oil.viscosity": 10**400}, ["oil.viscosity", "<= 1000 Pa s"]),
        ({"gears.driving.teeth": 10**400}, ["gears.driving.teeth", "<= 1000"]),
    ],
)
def test_what_does_not_fit_is_refused(values: dict[str, Any], words: list[str]) -> None:
    message = refusal(values)
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    "values",
    [
        {"operation.initial": "rest"},
        {"operation.speed": -5000.0},
        {"operation.speed": 0},
        {"mesh.stiffness_cos": [0.1, 0.1, 0.1], "mesh.stiffness_sin": [0.0]},
        {"bearings.driven.restitution": 1},
        {"waveform_channels": ["time"]},
        {"surface.waves": 1, "surface.scale": 100.0},
        {"rerun.mode": "save", "rerun.path": "run.rrd"},
    ],
)
def test_what_fits_is_taken(values: dict[str, Any]) -> None:
    flat = Parameters.from_flat(values).to_flat()
    assert {name: flat[name] for name in values} == {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
    }


@pytest.mark.parametrize(
    ("step", "interval", "chunk", "counts"),
    [
        (1e-6, 1e-5, 2e-3, (10, 10_000, 200)),
        (1.25e-7, 1e-5, 5e-4, (80, 10_000, 50)),
        (1e-9, 1.05e-6, 1.05e-6, (1050, 1050, 1)),
        (3e-7, 3e-6, 0.3, (10, 3000, 100_000)),
        (1e-5, 0.1, 0.3, (10_000, 100_000_000, 3)),
    ],
)
def test_whole_numbers_of_steps_and_samples_are_exact(
    step: float, interval: float, chunk: float, counts: tuple[int, int, int]
) -> None:
    solver = Parameters.from_flat(
        {"solver.step": step, "solver.sample_interval": interval, "solver.chunk": chunk}
    ).solver
    assert (solver.steps_per_sample, solver.sample_interval_ns, solver.samples_per_chunk) == counts


def test_counts_of_steps_and_samples_are_worked_out_once_for_each_solver() -> None:
    solver = Parameters.from_flat({"solver.sample_interval": 3e-3, "solver.chunk": 0.9}).solver
    assert solver.steps_per_sample is solver.steps_per_sample
    assert solver.sample_interval_ns is solver.sample_interval_ns
    assert solver.samples_per_chunk is solver.samples_per_chunk
    other = dataclasses.replace(solver, sample_interval=1e-3)
    assert (other.steps_per_sample, other.sample_interval_ns, other.samples_per_chunk) == (
        500,
        1_000_000,
        900,
    )
    assert dataclasses.replace(other, sample_interval=3e-3) == solver


def test_an_object_built_by_hand_is_checked_as_well() -> None:
    good = Parameters(gears=GearPairParameters(driving=GearParameters(teeth=23)))
    assert good.to_flat()["gears.driving.teeth"] == 23
    with pytest.raises(UsageError, match=r"gears\.driving\.teeth = 4 "):
        Parameters(gears=GearPairParameters(driving=GearParameters(teeth=4)))
    with pytest.raises(UsageError, match=r"gears\.driving\.mass = 1 must be a number"):
        Parameters(gears=GearPairParameters(driving=GearParameters(mass=1)))
    with pytest.raises(UsageError, match="model"):
        dataclasses.replace(good, model="new")


def test_integers_and_arrays_become_floats_and_tuples() -> None:
    import array

    import numpy as np

    given_values = {
        "operation.speed": 1000,
        "oil.viscosity": np.float64(0.02),
        "surface.waves": np.int64(5),
        "mesh.error_cos": array.array("d", [1e-6, 0.0]),
        "mesh.error_sin": np.array([0, 0]),
    }
    flat = Parameters.from_flat(given_values).to_flat()
    assert bits([flat[name] for name in given_values]) == bits([1000.0, 0.02, 5, (1e-6, 0.0), (0.0, 0.0)])


# Files


@pytest.mark.parametrize("name", ["gearbox", "paper"])
def test_the_files_in_config_name_every_parameter_in_order(name: str) -> None:
    tree = yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8"))
    names = list(flatten(tree["/**"]["ros__parameters"]))
    assert names == list(specifications())


def flatten(tree: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key


def test_the_gearbox_file_is_the_defaults_bit_for_bit(read_by_ros: Callable[[str], dict[str, Any]]) -> None:
    file = ROOT / "config" / "gearbox.yaml"
    defaults = Parameters().to_flat()
    assert load_parameters(file) == Parameters()
    by_ros = Parameters.from_flat(read_by_ros(file.read_text(encoding="utf-8"))).to_flat()
    assert {n: bits(v) for n, v in by_ros.items()} == {n: bits(v) for n, v in defaults.items()}


def test_the_paper_file_has_the_published_equations_and_what_its_table_names() -> None:
    published = published_gearbox().to_flat()
    paper = load_parameters(ROOT / "config" / "paper.yaml").to_flat()
    left_open = ("mesh.error_", "mesh.stiffness_", "bearings.", "surface.")
    changed = {name for name, value in paper.items() if value != published[name]}
    assert all(name.startswith(left_open) for name in changed)
    assert not any(name.endswith(("roughness", "fractal_dimension", "modulus", "ratio")) for name in changed)


def test_the_reference_page_is_up_to_date() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8") == parameters_page(), (
        "run: python -m gear_dynamics_ros.parameters > docs/parameters.md"
    )


def test_every_text_of_a_number_is_what_ros_takes_it_for(
    read_by_ros: Callable[[str], dict[str, Any]],
) -> None:
    texts = [*NUMBER_TEXTS, *YAML_TEXTS]
    text = section("\n    ".join(f"p{i}: {value}" for i, value in enumerate(texts)))
    by_ros = read_by_ros(text)
    ours: Any = parse_yaml(text)
    for index, value in enumerate(texts):
        taken = ours["/**"]["ros__parameters"][f"p{index}"]
        assert bits(taken) == bits(by_ros[f"p{index}"]), value
    assert all(bits(resolve_scalar(text)) == bits(by_ros[f"p{i}"]) for i, text in enumerate(NUMBER_TEXTS))


floats = st.floats(allow_nan=False, allow_infinity=False).filter(
    lambda x: x == 0.0 or abs(x) >= SMALLEST_NORMAL
)
words = st.text(st.characters(blacklist_categories=("Cs", "Cc")), max_size=12).filter(str.isprintable)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=st.lists(st.one_of(floats, words, st.booleans(), st.integers(-(2**63), 2**63 - 1)), min_size=1))
def test_what_is_written_is_read_back_to_the_bit_here_and_in_ros(
    values: list[float | str | bool | int], read_by_ros: Callable[[str], dict[str, Any]]
) -> None:
    text = section("\n    ".join(f"p{i}: {scalar_text(value)}" for i, value in enumerate(values)))
    by_ros = read_by_ros(text)
    ours: Any = parse_yaml(text)
    for index, value in enumerate(values):
        assert bits(ours["/**"]["ros__parameters"][f"p{index}"]) == bits(value)
        assert bits(by_ros[f"p{index}"]) == bits(value)


@st.composite
def parameters(draw: st.DrawFn) -> Parameters:
    """Parameters whose free numbers are any within their bounds."""
    tied = (
        "bearings.",
        "clock_rate",
        "mesh.stiffness_",
        "operation.speed",
        "solver.",
        "surface.scale",
        "surface.waves",
    )
    values: dict[str, Any] = {}
    for row in numbers():
        if row.element is int or row.name.startswith(tied):
            continue
        limits = {
            "min_value": row.minimum,
            "max_value": row.maximum,
            "exclude_min": row.exclusive_minimum,
            "exclude_max": row.exclusive_maximum,
        }
        number = st.floats(allow_subnormal=False, **limits)  # type: ignore[arg-type]
        values[row.name] = draw(st.lists(number, min_size=1, max_size=4) if row.type is tuple else number)
    values["joint_prefix"] = draw(words)
    values["recording.path"] = draw(words)
    values["waveform_channels"] = ["time", *draw(st.permutations(tuple(COLUMN)[1:]))[:3]]
    return Parameters.from_flat(values)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(original=parameters())
def test_parameters_survive_dump_and_load_here_and_in_ros(
    original: Parameters, read_by_ros: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    text = dump_parameters(original)
    wanted = {name: bits(value) for name, value in original.to_flat().items()}
    for read in (load_parameters(file_of(tmp_path, text)), Parameters.from_flat(read_by_ros(text))):
        assert {name: bits(value) for name, value in read.to_flat().items()} == wanted
    assert yaml.safe_load(text)["/**"]["ros__parameters"]["oil"]["viscosity"] == original.oil.viscosity


SECTION_NAMES = ("/**", "gearbox", "/gearbox", "/*", "/**/gearbox", "/other", "/gearboxes", "/ns/gearbox")


@pytest.mark.parametrize(("first", "second"), list(permutations(SECTION_NAMES, 2)))
def test_sections_count_as_in_ros(
    first: str, second: str, read_by_ros: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    text = section("operation: {speed: 1, load_torque: 1}", f'"{first}"')
    text += section("operation: {speed: 2}", f'"{second}"')
    by_ros = read_by_ros(text)
    if by_ros:
        assert load_parameters(file_of(tmp_path, text)) == Parameters.from_flat(by_ros)
    else:
        with pytest.raises(UsageError, match="no section for /gearbox"):
            load_parameters(file_of(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "/:\n  gearbox:\n    ros__parameters: {oil.viscosity: 0.5}\n",
        "/**:\n  gearbox:\n    ros__parameters: {oil: {viscosity: 0.5}}\n",
        "/**:\n  ros__parameters:\n    oil.viscosity: 5.0e-1\n    operation.governor: {integral: 1}\n",
        "/**:\n  ros__parameters: {}\n",
        "\N{ZERO WIDTH NO-BREAK SPACE}/**:\n  ros__parameters: {oil.viscosity: 0.5}\n",
    ],
)
def test_other_ways_to_write_a_section_count_as_in_ros(
    text: str, read_by_ros: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    assert load_parameters(file_of(tmp_path, text)) == Parameters.from_flat(read_by_ros(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("# nothing\n", ["empty"]),
        ("text", ["ros__parameters"]),
        ("- 1", ["ros__parameters"]),
        ("gears:\n  module: 1\n", ["gears/module", "ros__parameters"]),
        ("/other:\n  ros__parameters: {a: 1}\n", ["no section for /gearbox"]),
        ("/**:\n  ros__parameters:\n", ["line 2", "ros__parameters", "no value"]),
        ("/**:\n  ros__parameters: 3\n", ["/**", "ros__parameters", "mapping"]),
        ("/**:\n  ros__parameters: {}\n  more: 1\n", ["/**", "nothing but ros__parameters", "remove more"]),
        (section("oil:\n      viscosity:"), ["line 4", "oil.viscosity has no value"]),
        (section("oil: {viscosity: 1, viscosity: 2}"), ["line 3", "oil.viscosity is given twice"]),
        (section("oil: {viscosity: 1}\n    oil.viscosity: 1"), ["oil.viscosity is given twice"]),
        (section("oil: {}"), ["oil is an empty mapping"]),
        (section("a: &x 1\n    b: *x"), ["line 4", "*x", "alias"]),
        (section("mesh: {error_cos: [1, 0.5]}"), ["mesh.error_cos mixes types"]),
        (section("mesh: {error_cos: [[0.5]]}"), ["mesh.error_cos", "list of lists"]),
        (section("mesh: {error_cos: []}"), ["mesh.error_cos has 0 entries"]),
        (section("oil: {viscosity: '1.0'}"), ["oil.viscosity = '1.0'", "quotes"]),
        (section("joint_prefix: 5"), ["joint_prefix = 5", "quotes"]),
        (section("oil: {viscosity: .nan}"), ["oil.viscosity = .nan", ">= 0"]),
        (section("oil: {viscosity: 1e400}"), ["oil.viscosity = '1e400'", "number"]),
        (section("gears: {driving: {teeth: 40.0}}"), ["gears.driving.teeth = 40.0", "write 40"]),
        (section("oils: {viscosity: 1.0}"), ["oils.viscosity", "did you mean oil.viscosity"]),
        (section("oil: {viscosity: [1"), ["line", "not valid YAML"]),
        (section("\toil: 1"), ["line 3", "not valid YAML"]),
        (section("oil: \x01"), ["not valid YAML"]),
        (section("model: improved") + "---\n" + section("model: improved"), ["line 4", "second document"]),
        (section("a: " + "[" * 99 + "]" * 99), ["levels deep"]),
        ("? [a]\n: 1\n", ["line 1", "a name must be plain text"]),
    ],
)
def test_a_file_that_can_t_be_is_refused_in_one_line(text: str, words: list[str], tmp_path: Path) -> None:
    file = file_of(tmp_path, text)
    with pytest.raises(UsageError) as refused:
        load_parameters(file)
    message = str(refused.value)
    assert message.startswith(f"{file}: ") and "\n" not in message
    assert all(word in message for word in words), message


def test_a_file_that_can_t_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"missing\.yaml: it can't be read: No such file"):
        load_parameters(tmp_path / "missing.yaml")
    with pytest.raises(UsageError, match="can't be read: Is a directory"):
        load_parameters(tmp_path)
    (tmp_path / "latin.yaml").write_bytes("/**: \N{MICRO SIGN}".encode("latin-1"))
    with pytest.raises(UsageError, match="not UTF-8 text"):
        load_parameters(tmp_path / "latin.yaml")


# Settings on a command line


def test_settings_override_the_file_and_are_read_alike(tmp_path: Path) -> None:
    file = file_of(tmp_path, section("bearings: {driving: {clearance: 2.0e-4}}"))
    loaded = load_parameters(
        file,
        [
            "bearings.driving.oil_clearance=3.0e-4",
            "operation.speed=1000",
            "operation.speed=3e2",
            "mesh.error_cos=[1e-6, 2.e-6]",
            "waveform_channels=[time, dte]",
            "joint_prefix='a=b'",
            "autostart=off",
            "recording.path=/a/b c",
        ],
    )
    assert loaded == Parameters.from_flat(
        {
            "bearings.driving.clearance": 2.0e-4,
            "bearings.driving.oil_clearance": 3.0e-4,
            "operation.speed": 300.0,
            "mesh.error_cos": [1e-6, 2e-6],
            "waveform_channels": ["time", "dte"],
            "joint_prefix": "a=b",
            "autostart": False,
            "recording.path": "/a/b c",
        }
    )


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("operation.speed", ["name=value"]),
        ("=3", ["name=value"]),
        ("operation.speed=", ["operation.speed has no value"]),
        ("sped=3", ["sped"]),
        ("oil=3", ["oil is a group"]),
        ("oil.viscosity={a: 1}", ["oil.viscosity", "mapping"]),
        ("oil.viscosity=[1", ["oil.viscosity", "not valid YAML"]),
        ("oil.viscosity=-1", ["oil.viscosity = -1.0", ">= 0"]),
        ("oil.viscosity=thick", ["oil.viscosity = 'thick'", "number"]),
        ("mesh.error_cos=1e-6", ["mesh.error_cos = 1.0e-06", "list"]),
        ("model=improve", ["model = 'improve'", "did you mean improved?"]),
    ],
)
def test_a_setting_that_can_t_be_is_refused_in_one_line(setting: str, words: list[str]) -> None:
    with pytest.raises(UsageError) as refused:
        load_parameters(ROOT / "config" / "gearbox.yaml", [setting])
    message = str(refused.value)
    assert "\n" not in message and all(word in message for word in words), message


def test_a_text_of_any_length_is_refused_at_once() -> None:
    """A comparison of texts as long as this one would not end within the time of the whole suite."""
    endless = "a" * 10_000_000
    for values in ({endless: 1.0}, {"model": endless}):
        with pytest.raises(UsageError) as refused:
            Parameters.from_flat(values)
        assert len(str(refused.value)) < 500
