"""What can be set: one table of parameters with type, unit, bounds and help, and its way from and to YAML.

Every leaf is declared once, through ``spec``. A ``Parameters`` object is always valid: building one checks
each value against its bounds and the values against each other. SI units throughout.
"""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.rcl_yaml import (
    SMALLEST_NORMAL,
    Tree,
    parse_yaml,
    resolve,
    scalar_text,
)
from gear_dynamics_ros.physics.surface import LARGEST_ORDER
from gear_dynamics_ros.topics import TOPICS

Value: TypeAlias = bool | int | float | str | tuple[float, ...] | tuple[str, ...]

NODE = "/gearbox"
OF_ROS = re.compile(
    r"use_sim_time|start_type_description_service|qos_overrides\..*"
)  # every ROS node has these
MOST_HARMONICS = 32
MOST_SAMPLES_PER_CHUNK = 1_000_000
SMALLEST_SPLIT = 1_000_000  # bytes
NANOSECONDS = 10**9


class Specification(NamedTuple):
    """One row of the table of parameters. Bounds are inclusive unless marked; None is no bound."""

    name: str  # dotted
    element: type[Any]  # type of the entries of a tuple, otherwise ``type``
    type: type[Any]  # bool, int, float, str or tuple
    default: Value
    unit: str
    help: str
    minimum: float | None
    maximum: float | None
    exclusive_minimum: bool
    exclusive_maximum: bool
    choices: tuple[str, ...]  # empty: any
    length: tuple[int, int] | None  # fewest and most entries of a tuple
    runtime: bool  # may change while the gearbox runs

    @property
    def limits(self) -> str:
        """What is allowed of a value, or of each entry, in words; empty where everything of the type is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        bounds = []
        if self.minimum is not None:
            bounds.append(f"{'>' if self.exclusive_minimum else '>='} {self.minimum:.9g}")
        if self.maximum is not None:
            bounds.append(f"{'<' if self.exclusive_maximum else '<='} {self.maximum:.9g}")
        return " and ".join(bounds)


def spec(
    default: Value,
    help: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    exclusive_minimum: bool = False,
    exclusive_maximum: bool = False,
    choices: Sequence[str] = (),
    length: tuple[int, int] | None = None,
    runtime: bool = False,
) -> Any:
    """Declare a leaf: its default and its row of the table."""
    kind = type(default)
    row = Specification(
        name="",
        type=kind,
        element=type(default[0]) if isinstance(default, tuple) else kind,
        default=default,
        unit=unit,
        help=help,
        minimum=minimum,
        maximum=maximum,
        exclusive_minimum=exclusive_minimum,
        exclusive_maximum=exclusive_maximum,
        choices=tuple(choices),
        length=length,
        runtime=runtime,
    )
    return field(default=default, metadata={"specification": row})


def _positive(default: float, help: str, *, unit: str, maximum: float, runtime: bool = False) -> Any:
    return spec(
        default, help, unit=unit, minimum=0.0, exclusive_minimum=True, maximum=maximum, runtime=runtime
    )


def _harmonics(default: float, help: str, *, unit: str = "", limit: float) -> Any:
    return spec(
        (default,),
        help,
        unit=unit,
        minimum=-limit,
        maximum=limit,
        length=(1, MOST_HARMONICS),
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class Gear:
    teeth: int = spec(40, "number of teeth Z", minimum=5, maximum=1000)
    mass: float = _positive(1.0, "mass m", unit="kg", maximum=1e6)
    inertia: float = _positive(2.23e-3, "moment of inertia J about the shaft", unit="kg m^2", maximum=1e6)


@dataclass(frozen=True, slots=True)
class Gears:
    module: float = _positive(0.003, "module M, the same for both gears", unit="m", maximum=1.0)
    pressure_angle: float = spec(
        0.3490658503988659,
        "nominal pressure angle alpha_0",
        unit="rad",
        minimum=0.0,
        exclusive_minimum=True,
        maximum=math.pi / 3.0,
        exclusive_maximum=True,
    )
    backlash: float = _positive(
        50.0e-6, "total backlash 2 b_0 along the line of action", unit="m", maximum=0.1
    )
    driving: Gear = field(default_factory=Gear)
    driven: Gear = field(default_factory=Gear)


@dataclass(frozen=True, slots=True)
class Mesh:
    stiffness: float = _positive(3.0e8, "mean mesh stiffness k_m", unit="N/m", maximum=1e13, runtime=True)
    stiffness_cos: tuple[float, ...] = _harmonics(
        0.08,
        "cosine part of the stiffness at 1, 2, ... times mesh frequency, relative to the mean",
        limit=1.0,
    )
    stiffness_sin: tuple[float, ...] = _harmonics(
        0.0, "sine part of the stiffness, relative to the mean; a missing harmonic is 0", limit=1.0
    )
    damping_ratio: float = spec(
        0.1, "damping ratio xi_2 of the mesh", minimum=0.0, maximum=10.0, runtime=True
    )
    error_mean: float = spec(
        0.0, "mean static transmission error e_m", unit="m", minimum=-0.1, maximum=0.1, runtime=True
    )
    error_cos: tuple[float, ...] = _harmonics(
        9.2e-6,
        "cosine part of the static transmission error at 1, 2, ... times mesh frequency",
        unit="m",
        limit=0.1,
    )
    error_sin: tuple[float, ...] = _harmonics(
        0.0, "sine part of the static transmission error; a missing harmonic is 0", unit="m", limit=0.1
    )


@dataclass(frozen=True, slots=True)
class ToothSurface:
    roughness: float = spec(
        0.8e-6,
        "mean roughness Ra; 0 is a smooth tooth",
        unit="m",
        minimum=0.0,
        maximum=1e-2,
        runtime=True,
    )
    fractal_dimension: float = spec(
        1.1,
        "fractal dimension D of the profile",
        minimum=1.0,
        exclusive_minimum=True,
        maximum=2.0,
        exclusive_maximum=True,
    )
    offset: float = spec(
        0.0, "phase psi of all waves", unit="rad", minimum=-2.0 * math.pi, maximum=2.0 * math.pi
    )


@dataclass(frozen=True, slots=True)
class Surface:
    scale: float = spec(
        1.5,
        "ratio lambda of the frequencies of successive waves",
        minimum=1.0,
        exclusive_minimum=True,
        maximum=100.0,
    )
    waves: int = spec(8, "number N of waves in the profile", minimum=1, maximum=32)
    driving: ToothSurface = field(default_factory=ToothSurface)
    driven: ToothSurface = field(default_factory=ToothSurface)


@dataclass(frozen=True, slots=True)
class Material:
    youngs_modulus: float = _positive(210.0e9, "Young's modulus E", unit="Pa", maximum=1e14)
    poissons_ratio: float = spec(0.3, "Poisson's ratio nu", minimum=-1.0, exclusive_minimum=True, maximum=0.5)


@dataclass(frozen=True, slots=True)
class Bearing:
    clearance: float = _positive(
        27.0e-6, "radial clearance b_b, where contact begins; below oil_clearance", unit="m", maximum=0.1
    )
    length: float = _positive(13.0e-3, "length L", unit="m", maximum=10.0)
    diameter: float = _positive(50.0e-3, "diameter D", unit="m", maximum=10.0)
    oil_clearance: float = _positive(150.0e-6, "radial clearance C of the oil film", unit="m", maximum=0.1)
    restitution: float = spec(0.2, "coefficient of restitution eta", minimum=0.05, maximum=1.0, runtime=True)
    kelvin_stiffness: float = _positive(
        1.0e8, "contact stiffness k_b of the traditional model", unit="N/m", maximum=1e13, runtime=True
    )
    kelvin_damping: float = spec(
        2000.0,
        "contact damping c_b of the traditional model",
        unit="N s/m",
        minimum=0.0,
        maximum=1e9,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class Bearings:
    shaft: Material = field(default_factory=Material)
    sleeve: Material = field(default_factory=Material)
    minimum_impact_speed: float = _positive(
        1.0e-3,
        "least impact speed v_min that enters the contact law",
        unit="m/s",
        maximum=100.0,
        runtime=True,
    )
    driving: Bearing = field(default_factory=Bearing)
    driven: Bearing = field(default_factory=Bearing)


@dataclass(frozen=True, slots=True)
class Oil:
    viscosity: float = spec(
        2.28e-2, "dynamic viscosity mu", unit="Pa s", minimum=0.0, maximum=1e3, runtime=True
    )
    eccentricity_limit: float = spec(
        0.98,
        "relative eccentricity past which the film force is held",
        minimum=0.1,
        maximum=0.999,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class Governor:
    proportional: float = spec(
        0.5, "proportional gain", unit="N m s/rad", minimum=0.0, maximum=1e6, runtime=True
    )
    integral: float = spec(5.0, "integral gain", unit="N m/rad", minimum=0.0, maximum=1e9, runtime=True)
    torque_limit: float = _positive(
        200.0, "largest drive torque, either way", unit="N m", maximum=1e6, runtime=True
    )


@dataclass(frozen=True, slots=True)
class Operation:
    control: str = spec(
        "speed",
        "what sets the drive torque: the torque command, or a PI governor of the speed",
        choices=("torque", "speed"),
        runtime=True,
    )
    speed: float = spec(
        1623.156,
        "speed of the driving gear at the start, and set-point; not beyond speed_limit",
        unit="rad/s",
        minimum=-1e6,
        maximum=1e6,
        runtime=True,
    )
    drive_torque: float = spec(
        30.0, "torque T_M on the driving shaft", unit="N m", minimum=-1e6, maximum=1e6, runtime=True
    )
    load_torque: float = spec(
        30.0,
        "torque T_L on the driven shaft, positive resists",
        unit="N m",
        minimum=-1e6,
        maximum=1e6,
        runtime=True,
    )
    load_law: str = spec(
        "constant",
        "constant: load_torque as it is; brake: against the motion, load_torque tanh(omega_2 / 1 rad/s)",
        choices=("constant", "brake"),
        runtime=True,
    )
    load_viscous: float = spec(
        0.0,
        "viscous load on the driven shaft",
        unit="N m s/rad",
        minimum=0.0,
        maximum=1e6,
        runtime=True,
    )
    speed_limit: float = _positive(
        5000.0, "speed that trips the run", unit="rad/s", maximum=1e6, runtime=True
    )
    governor: Governor = field(default_factory=Governor)
    command_timeout: float = spec(
        0.0,
        "wall time without a command after which on_timeout applies; 0 is never",
        unit="s",
        minimum=0.0,
        maximum=1e9,
        runtime=True,
    )
    on_timeout: str = spec(
        "hold",
        "hold: keep the last commands; release: both torques to 0",
        choices=("hold", "release"),
        runtime=True,
    )
    initial: str = spec(
        "touching",
        "start with the drive flank touching, at operation.speed, or at rest",
        choices=("touching", "rest"),
    )


@dataclass(frozen=True, slots=True)
class Solver:
    step: float = spec(1.0e-6, "integration step", unit="s", minimum=1e-9, maximum=1e-2)
    sample_interval: float = spec(
        1.0e-5,
        "interval of the waveform's samples: a whole number of nanoseconds and of steps",
        unit="s",
        minimum=1e-9,
        maximum=1.0,
    )
    chunk: float = spec(
        2.0e-3,
        "what one engine call simulates: a whole number of samples; commands take effect at its edges",
        unit="s",
        minimum=1e-9,
        maximum=10.0,
    )

    @property
    def sample_interval_ns(self) -> int:
        """Sample interval in nanoseconds, exact."""
        return _whole(self.sample_interval, Fraction(1, NANOSECONDS))

    @property
    def steps_per_sample(self) -> int:
        """Integration steps in a sample interval, exact."""
        return _whole(self.sample_interval, _decimal(self.step))

    @property
    def samples_per_chunk(self) -> int:
        """Samples in a chunk, exact."""
        return _whole(self.chunk, _decimal(self.sample_interval))


@dataclass(frozen=True, slots=True)
class Pacing:
    real_time_factor: float = spec(
        1.0,
        "simulated time per wall time; 0 is as fast as possible",
        minimum=0.0,
        maximum=1e6,
        runtime=True,
    )
    duration: float = spec(
        0.0, "simulated time after which the run ends; 0 is until stopped", unit="s", minimum=0.0, maximum=1e9
    )
    on_overrun: str = spec(
        "slip",
        "of a late chunk: slip: what is lost stays lost; catch_up: later ones hurry; error: the run ends",
        choices=("slip", "catch_up", "error"),
        runtime=True,
    )
    catch_up_limit: float = spec(
        0.1,
        "largest lateness that catch_up makes good; what exceeds it slips",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class Stepping:
    chunks: int = spec(
        1, "chunks that one call of ~/step makes while paused", minimum=1, maximum=1_000_000, runtime=True
    )
    timeout: float = _positive(
        10.0, "wall time after which a call of ~/step gives up", unit="s", maximum=3600.0, runtime=True
    )


@dataclass(frozen=True, slots=True)
class Checkpoint:
    path: str = spec("", "file that ~/save_checkpoint writes and ~/restore_checkpoint reads; empty is none")


@dataclass(frozen=True, slots=True)
class Recording:
    path: str = spec("", "folder to record to, must not exist yet; empty is no recording")
    mode: str = spec(
        "continuous",
        "continuous: everything from the start on; ring: the last ring_duration is kept in memory, and "
        "written where ~/snapshot asks for it or the run ends by a fault",
        choices=("continuous", "ring"),
    )
    ring_duration: float = _positive(
        5.0, "simulated time that the ring holds at least; 23 MB for a second", unit="s", maximum=3600.0
    )
    split_size: int = spec(
        0, "size at which a new file begins; 0 is never", unit="B", minimum=0, maximum=1 << 50
    )
    split_duration: float = spec(
        0.0,
        "simulated time after which a new file begins; 0 is never",
        unit="s",
        minimum=0.0,
        maximum=1e9,
    )
    checkpoint_interval: float = spec(
        1.0,
        "simulated time between two states in the recording, from which a replay may start; 0 is none",
        unit="s",
        minimum=0.0,
        maximum=1e9,
    )
    topics: tuple[str, ...] = spec(
        tuple(TOPICS),
        "topics to record, by their short names; commands in force and events are always among them",
        choices=tuple(TOPICS),
        length=(1, len(TOPICS)),
    )
    minimum_free: int = spec(
        10_000_000, "room on the disk below which recording stops", unit="B", minimum=0, maximum=1 << 50
    )


@dataclass(frozen=True, slots=True)
class Rerun:
    mode: str = spec("none", "where the Rerun stream goes", choices=("none", "save", "serve", "connect"))
    path: str = spec("", "file to write (save)")
    port: int = spec(9876, "port on 127.0.0.1 for viewers to connect to (serve)", minimum=1, maximum=65535)
    url: str = spec("rerun+http://127.0.0.1:9876/proxy", "viewer to send to (connect)")


@dataclass(frozen=True, slots=True)
class Parameters:
    """Everything that can be set. ``Parameters()`` holds the defaults, which config/gearbox.yaml spells out.

    Raises UsageError if a value has the wrong type, is out of bounds, or does not fit the others.
    """

    model: str = spec(
        "improved",
        "bearing contact: traditional (Kelvin), compared (Hertz, restitution), improved (and an oil film)",
        choices=("traditional", "compared", "improved"),
    )
    mesh_geometry: str = spec(
        "exact",
        "transmission error of displaced centres: as published, or exact",
        choices=("published", "exact"),
    )
    mesh_damping: str = spec(
        "contact",
        "when the mesh damps: always, in free flight too, or in contact only",
        choices=("always", "contact"),
    )
    restitution_law: str = spec(
        "exact",
        "damping of the bearing contact: as published, or such that it delivers exactly the restitution",
        choices=("lankarani_nikravesh", "exact"),
    )
    mesh_phase: str = spec(
        "actual",
        "mesh phase: nominal, from the speed set-point, or actual, from the state",
        choices=("nominal", "actual"),
    )
    gears: Gears = field(default_factory=Gears)
    mesh: Mesh = field(default_factory=Mesh)
    surface: Surface = field(default_factory=Surface)
    bearings: Bearings = field(default_factory=Bearings)
    oil: Oil = field(default_factory=Oil)
    operation: Operation = field(default_factory=Operation)
    solver: Solver = field(default_factory=Solver)
    pacing: Pacing = field(default_factory=Pacing)
    stepping: Stepping = field(default_factory=Stepping)
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    recording: Recording = field(default_factory=Recording)
    rerun: Rerun = field(default_factory=Rerun)
    autostart: bool = spec(True, "configure and activate the node by itself")
    joint_prefix: str = spec("", "put before the joint names driving, driven and mesh")
    waveform_channels: tuple[str, ...] = spec(
        CHANNEL_NAMES,
        "channels of the waveform, time first",
        choices=tuple(COLUMN),
        length=(1, len(COLUMN)),
    )
    clock_rate: float = spec(0.0, "rate of /clock; 0 is none", unit="Hz", minimum=0.0, maximum=1e4)

    def __post_init__(self) -> None:
        _check(self)

    @classmethod
    def from_flat(cls, values: Mapping[str, object]) -> Parameters:
        """Parameters from dotted names; what is missing has its default.

        Integers are welcome where floats are meant, and any sequence where a tuple is. Names that every ROS
        node has, such as use_sim_time, are passed over. Raises UsageError if a name is unknown or a value
        can't be.
        """
        converted: dict[str, Value] = {}
        for name, value in values.items():
            if name in specifications():
                converted[name] = _convert(specifications()[name], value)
            elif not OF_ROS.fullmatch(name):
                raise UsageError(_unknown(name))
        return cls(**_arguments(cls, "", converted))

    def to_flat(self) -> dict[str, Value]:
        """Every value by its dotted name, in the order of the table."""
        return dict(_leaves(self, ""))


@cache
def specifications() -> Mapping[str, Specification]:
    """The table of parameters by dotted name, in tree order."""
    return dict(_rows(Parameters, ""))


def read_settings(overrides: Iterable[str]) -> dict[str, Any]:
    """Values by dotted name of settings ``name=value``. Raises UsageError if one is none."""
    return dict(map(_read_override, overrides))


def load(path: str | Path, overrides: Iterable[str] = ()) -> Parameters:
    """Parameters from a ROS parameter file, and from settings ``name=value`` that override it.

    Both are read as rcl reads them. Sections of other nodes are left alone. Raises UsageError if the file
    can't be read or what it and the settings make together can't be.
    """
    settings = read_settings(overrides)
    try:
        return Parameters.from_flat({**_read_file(_read_text(Path(path))), **settings})
    except UsageError as error:
        source = " with ".join([str(path), *settings])
        raise UsageError(f"{source}: {error}") from None


def parse(text: str) -> Parameters:
    """Parameters from the text of a ROS parameter file. Raises UsageError as ``load`` does."""
    return Parameters.from_flat(_read_file(text))


def dump(parameters: Parameters) -> str:
    """Text of a ROS parameter file that rcl and ``load`` read back to the same bits."""
    lines = ["/**:", "  ros__parameters:"]
    groups: list[str] = []
    for name, value in parameters.to_flat().items():
        *path, leaf = name.split(".")
        shared = next((i for i, (a, b) in enumerate(zip(groups, path, strict=False)) if a != b), None)
        known = min(len(groups), len(path)) if shared is None else shared
        for depth in range(known, len(path)):
            lines.append(f"{_indent(depth)}{path[depth]}:")
        groups = path
        lines.append(f"{_indent(len(path))}{leaf}: {_text(value)}")
    return "\n".join(lines) + "\n"


def reference() -> str:
    """The table of parameters as a Markdown page."""
    lines = [
        "# Parameters",
        "",
        "One tree for the node and all tools, in SI units; `config/gearbox.yaml` is the same tree as a file.",
        "Written by `python -m gear_dynamics_ros.parameters > docs/parameters.md`.",
        "",
        "| name | type | default | unit | allowed | at run time | meaning |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in specifications().values():
        kind = f"list of {row.element.__name__}" if row.type is tuple else row.type.__name__
        default, allowed = f"`{_text(row.default)}`", row.limits
        if row.choices == tuple(COLUMN):
            default, allowed = "all but the energies", "names of channels and energies"
        if row.choices == tuple(TOPICS):
            default, allowed = "all", f"names, {', '.join(row.choices)}"
        if row.length:
            allowed = f"{row.length[0]} to {row.length[1]} entries, {allowed}"
        runtime = "yes" if row.runtime else ""
        lines.append(
            f"| `{row.name}` | {kind} | {default} | {row.unit} | {allowed} | {runtime} | {row.help} |"
        )
    return "\n".join(lines) + "\n"


# The tree of dataclasses


def _members(group: Any) -> Iterator[tuple[str, Specification | None, Any]]:
    """Name of each field of a group (a class or an object), its row if a leaf, its class if not."""
    for member in fields(group):
        yield member.name, member.metadata.get("specification"), member.default_factory


def _rows(group: type[Any], prefix: str) -> Iterator[tuple[str, Specification]]:
    for name, row, subgroup in _members(group):
        if row is None:
            yield from _rows(subgroup, f"{prefix}{name}.")
        else:
            yield prefix + name, row._replace(name=prefix + name)


def _leaves(group: Any, prefix: str) -> Iterator[tuple[str, Value]]:
    for name, row, _ in _members(group):
        if row is None:
            yield from _leaves(getattr(group, name), f"{prefix}{name}.")
        else:
            yield prefix + name, getattr(group, name)


def _arguments(group: type[Any], prefix: str, values: Mapping[str, Value]) -> dict[str, Any]:
    """What ``group`` is built from, as far as ``values`` name it."""
    arguments: dict[str, Any] = {}
    for name, row, subgroup in _members(group):
        if row is None:
            arguments[name] = subgroup(**_arguments(subgroup, f"{prefix}{name}.", values))
        elif prefix + name in values:
            arguments[name] = values[prefix + name]
    return arguments


def _unknown(name: str) -> str:
    names = specifications()
    inside = [known for known in names if known.startswith(f"{name}.")]
    if inside:
        return f"{name} is a group, not a parameter: set what is in it, such as {inside[0]}"
    leaf = name.rsplit(".", 1)[-1]
    close = difflib.get_close_matches(name, names, n=1)
    alike = [known for known in names if known.rsplit(".", 1)[-1] == leaf]
    hint = f"did you mean {(close or alike)[0]}?" if close or alike else "docs/parameters.md lists them all"
    return f"there is no parameter {name}: {hint}"


# Single values

_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def _convert(row: Specification, value: object) -> Value:
    """``value`` in the type of the row; raises UsageError where that would change its meaning."""
    if row.type is not tuple:
        converted: Value = _convert_scalar(row, value)
        return converted
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise UsageError(f"{row.name} = {_show(value)} must be a list, each entry {_WORDS[row.element]}")
    return tuple(_convert_scalar(row, entry) for entry in value)


def _convert_scalar(row: Specification, value: object) -> Any:
    if row.element is float and isinstance(value, float):
        return float(value)
    if row.element in (int, float) and hasattr(value, "__index__") and not isinstance(value, bool):
        return _from_integer(row, operator.index(value))
    if type(value) is not row.element:
        raise UsageError(f"{row.name} = {_show(value)} must be {_WORDS[row.element]}{_type_hint(row, value)}")
    return value


def _from_integer(row: Specification, value: int) -> int | float:
    if row.element is int:
        return value
    try:
        return float(value)
    except OverflowError:
        raise UsageError(f"{row.name} has {value.bit_length()} bits: {_allowed(row)}") from None


def _type_hint(row: Specification, value: object) -> str:
    if isinstance(value, list | tuple):
        return ", not a list"
    if row.element is str:
        return ": put it in quotes"
    if row.element is int and isinstance(value, float) and value.is_integer():
        return f": write {int(value)}"
    if isinstance(value, str) and not isinstance(resolve(value), str):
        return ": take it out of its quotes"
    return ""


def _show(value: object) -> str:
    if isinstance(value, str):
        return repr(value)
    return scalar_text(value) if isinstance(value, bool | float) else str(value)


def _allowed(row: Specification) -> str:
    return f"it must be {row.limits}{' ' + row.unit if row.unit else ''}"


def _check_value(row: Specification, value: Value) -> None:
    entries = value if isinstance(value, tuple) else (value,)
    _convert(row, value)
    if any(type(entry) is not row.element for entry in entries):
        raise UsageError(f"{row.name} = {_show(value)} must be {_WORDS[row.element]}: build it by from_flat")
    fewest, most = row.length or (1, 1)
    if not fewest <= len(entries) <= most:
        raise UsageError(f"{row.name} has {len(entries)} entries: it must have {fewest} to {most}")
    for index, entry in enumerate(entries):
        _check_scalar(row, f"{row.name}[{index}]" if row.length else row.name, entry)


def _check_scalar(row: Specification, name: str, value: bool | int | float | str) -> None:
    if isinstance(value, str):
        if row.choices and value not in row.choices:
            close = difflib.get_close_matches(value, row.choices, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise UsageError(f"{name} = {value!r}: {hint}it must be {row.limits}")
        if not value.isprintable():
            raise UsageError(f"{name} = {value!r} holds characters that can't be printed: leave them out")
        return
    if _outside(row, value) or not math.isfinite(value):
        raise UsageError(f"{name} = {_text(value)} is out of range: {_allowed(row)}")
    if 0.0 < abs(value) < SMALLEST_NORMAL:
        raise UsageError(f"{name} = {_text(value)} is closer to 0 than {SMALLEST_NORMAL:.4g}: write 0.0")


def _outside(row: Specification, value: float) -> bool:
    low, high = row.minimum, row.maximum
    below = low is not None and (value <= low if row.exclusive_minimum else value < low)
    above = high is not None and (value >= high if row.exclusive_maximum else value > high)
    return below or above


# Values that must fit one another


def _check(parameters: Parameters) -> None:
    for name, value in _leaves(parameters, ""):
        row = specifications()[name]
        _check_value(row, value)
    _check_bearings(parameters.bearings)
    _check_mesh(parameters.mesh)
    _check_surface(parameters)
    _check_operation(parameters)
    _check_solver(parameters.solver)
    _check_outputs(parameters)


def _check_bearings(bearings: Bearings) -> None:
    for side, bearing in (("driving", bearings.driving), ("driven", bearings.driven)):
        if bearing.oil_clearance <= bearing.clearance:
            raise UsageError(
                f"bearings.{side}.oil_clearance = {_text(bearing.oil_clearance)} m must be larger than "
                f"bearings.{side}.clearance = {_text(bearing.clearance)} m: contact is inside the film"
            )


def _check_mesh(mesh: Mesh) -> None:
    swing = sum(
        math.hypot(a, b) for a, b in zip_longest(mesh.stiffness_cos, mesh.stiffness_sin, fillvalue=0.0)
    )
    if swing >= 1.0:
        raise UsageError(
            f"mesh.stiffness_cos and mesh.stiffness_sin swing by {swing:.6g} in all: "
            "it must be < 1 for the stiffness to stay positive: lower them"
        )


def _check_surface(parameters: Parameters) -> None:
    surface, gears = parameters.surface, parameters.gears
    for side, gear in (("driving", gears.driving), ("driven", gears.driven)):
        highest = gear.teeth * surface.scale ** (surface.waves - 1)
        if highest > LARGEST_ORDER:
            raise UsageError(
                f"surface.waves = {surface.waves} with surface.scale = {_text(surface.scale)} and "
                f"gears.{side}.teeth = {gear.teeth} puts {highest:.3g} waves on a revolution; the limit is "
                f"{LARGEST_ORDER}: lower one of them"
            )


def _check_operation(parameters: Parameters) -> None:
    operation = parameters.operation
    if abs(operation.speed) > operation.speed_limit:
        raise UsageError(
            f"operation.speed = {_text(operation.speed)} rad/s is beyond operation.speed_limit = "
            f"{_text(operation.speed_limit)} rad/s: lower the one or raise the other"
        )
    if operation.initial == "rest" and parameters.mesh_phase == "nominal":
        raise UsageError(
            "operation.initial = 'rest' can't be with mesh_phase = 'nominal', whose phase runs at the "
            "set-point: take 'touching' or 'actual'"
        )


def _check_solver(solver: Solver) -> None:
    interval = _decimal(solver.sample_interval)
    _check_multiple("solver.sample_interval", solver.sample_interval, Fraction(1, NANOSECONDS), "nanoseconds")
    _check_multiple(
        "solver.sample_interval",
        solver.sample_interval,
        _decimal(solver.step),
        f"steps of {_text(solver.step)} s",
    )
    _check_multiple("solver.chunk", solver.chunk, interval, f"samples of {_text(solver.sample_interval)} s")
    if solver.samples_per_chunk > MOST_SAMPLES_PER_CHUNK:
        raise UsageError(
            f"solver.chunk = {_text(solver.chunk)} s holds {solver.samples_per_chunk} samples; the limit is "
            f"{MOST_SAMPLES_PER_CHUNK}: shorten it or lengthen solver.sample_interval"
        )


def _check_multiple(name: str, value: float, unit: Fraction, units: str) -> None:
    ratio = _decimal(value) / unit
    if ratio.denominator != 1:
        below = max(1, math.floor(ratio))
        nearest = " or ".join(_text(float(count * unit)) for count in (below, below + 1))
        raise UsageError(
            f"{name} = {_text(value)} s is {float(ratio):.9g} {units}; it must be a whole number: "
            f"take {nearest} s"
        )


def _check_outputs(parameters: Parameters) -> None:
    channels = parameters.waveform_channels
    if channels[0] != "time":
        raise UsageError(f"waveform_channels starts with '{channels[0]}': it must start with time")
    for name in channels:
        if channels.count(name) > 1:
            raise UsageError(f"waveform_channels names '{name}' {channels.count(name)} times: name it once")
    split_size = parameters.recording.split_size
    if 0 < split_size < SMALLEST_SPLIT:
        raise UsageError(
            f"recording.split_size = {split_size} B is too small for a file: "
            f"it must be 0 (never) or >= {SMALLEST_SPLIT} B"
        )
    rerun = parameters.rerun
    if rerun.mode == "save" and not rerun.path:
        raise UsageError("rerun.path is empty but rerun.mode = 'save' needs a file: name one")
    if rerun.mode == "connect" and not rerun.url.startswith("rerun"):
        raise UsageError(f"rerun.url = '{rerun.url}' must be a Rerun address, such as {Rerun().url}")


def _decimal(value: float) -> Fraction:
    """The shortest decimal that reads as ``value``: what its author wrote."""
    return Fraction(repr(value))


def _whole(value: float, unit: Fraction) -> int:
    return int(_decimal(value) / unit)


# Parameter files


def _read_sections(tree: Tree, node: str = "") -> Iterator[tuple[str, dict[str, Tree]]]:
    """Name and parameters of each node in the file, in its order; nodes may stand inside namespaces."""
    if not isinstance(tree, dict):
        raise UsageError(f"{node or 'it'} must hold ros__parameters, or nodes that hold them")
    if "ros__parameters" in tree:
        parameters = tree["ros__parameters"]
        if len(tree) > 1 or not isinstance(parameters, dict):
            raise UsageError(f"{node or 'it'} must hold ros__parameters, a mapping of names to values, alone")
        yield node, parameters
        return
    for key, child in tree.items():
        yield from _read_sections(child, f"{node}/{key.strip('/')}".replace("//", "/"))


def _concerns(section: str) -> bool:
    """Whether a section of this name is for the node /gearbox, by the wildcards of rcl."""
    pattern = {"**": r"(/\w+)*", "*": r"/\w+"}
    tokens = [pattern.get(token, re.escape(f"/{token}")) for token in section.split("/") if token]
    return re.fullmatch("".join(tokens), NODE) is not None


def _read_file(text: str) -> dict[str, Tree]:
    """Values by dotted name. A later section overrides an earlier one, as in rcl."""
    sections = [parameters for node, parameters in _read_sections(parse_yaml(text)) if _concerns(node)]
    if not sections:
        raise UsageError(f"it has no section for {NODE}: put ros__parameters under /** or {NODE}")
    values: dict[str, Tree] = {}
    for parameters in sections:
        values.update(_flatten(parameters, ""))
    return values


def _flatten(tree: dict[str, Tree], prefix: str) -> dict[str, Tree]:
    values: dict[str, Tree] = {}
    for key, child in tree.items():
        name = prefix + key
        found = _flatten(child, f"{name}.") if isinstance(child, dict) else {name: _single(name, child)}
        for twice in values.keys() & found.keys():
            raise UsageError(f"{twice} stands twice in one section: leave one")
        values.update(found)
    if not tree and prefix:
        raise UsageError(f"{prefix[:-1]} is an empty mapping: leave it out")
    return values


def _single(name: str, value: Tree) -> Tree:
    """``value`` if rcl takes it for a parameter's: a scalar or a list of scalars of one type."""
    if isinstance(value, list):
        if any(isinstance(entry, list | dict) for entry in value):
            raise UsageError(f"{name} is a list of lists or mappings: write a list of single values")
        if len({type(entry) for entry in value}) > 1:
            raise UsageError(
                f"{name} mixes types, which ROS refuses: write all its numbers with a decimal point"
            )
    elif isinstance(value, dict):
        raise UsageError(f"{name} is a mapping: write a single value or a list")
    return value


def _read_override(override: str) -> tuple[str, Tree]:
    name, separator, text = override.partition("=")
    if not separator or not name:
        raise UsageError(f"{override!r} is no setting: write name=value")
    if name not in specifications():
        raise UsageError(_unknown(name))
    if not text.strip():
        raise UsageError(f"{name} has no value: write {name}=value, with '' for empty text")
    try:
        return name, _single(name, parse_yaml(text))
    except UsageError as error:
        raise UsageError(f"{override!r}: {error}") from None


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"it can't be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise UsageError(f"it is no UTF-8 text: {error.reason} at byte {error.start}") from None


def _indent(depth: int) -> str:
    return "  " * (depth + 2)


def _text(value: Value) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(scalar_text(entry) for entry in value) + "]"
    return scalar_text(value)
