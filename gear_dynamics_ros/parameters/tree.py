"""The tree of parameters: the groups, and the parameters outside all groups; every value by a dotted name.

A ``Parameters`` object is always valid: building one checks each value against its bounds, and the values
against each other. SI units throughout.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, Final

from gear_dynamics_ros.channels import CHANNEL_NAMES, COLUMN
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.checks import (
    check_bearings,
    check_clock,
    check_mesh,
    check_operation,
    check_pacing,
    check_recording,
    check_rerun,
    check_solver,
    check_surface,
    check_value,
    check_waveform_channels,
    converted_value,
)
from gear_dynamics_ros.parameters.groups import (
    BearingPairParameters,
    CheckpointParameters,
    GearPairParameters,
    MeshParameters,
    OilParameters,
    OperationParameters,
    PacingParameters,
    RecordingParameters,
    RerunParameters,
    SolverParameters,
    SteppingParameters,
    SurfaceParameters,
)
from gear_dynamics_ros.parameters.hints import most_alike, shortened
from gear_dynamics_ros.parameters.specification import Specification, Value, parameter

# Parameters of ROS itself, which any node can have.
ROS_OWN_PARAMETERS: Final = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")


@dataclass(frozen=True, slots=True)
class Parameters:
    """All parameters. ``Parameters()`` has the defaults, the same values as config/gearbox.yaml.

    Raises UsageError if a value has the wrong type, is out of bounds, or does not fit the others.
    """

    model: str = parameter(
        "improved",
        "bearing model; traditional: Kelvin contact; compared: Hertz contact with restitution; improved: "
        "compared, and an oil film",
        choices=("traditional", "compared", "improved"),
    )
    mesh_geometry: str = parameter(
        "exact",
        "transmission error with displaced centres; published: as in the paper; exact: conserves energy",
        choices=("published", "exact"),
    )
    mesh_damping: str = parameter(
        "contact",
        "when the mesh damping acts; always: also while the teeth are apart; contact: only in contact",
        choices=("always", "contact"),
    )
    restitution_law: str = parameter(
        "exact",
        "damping of the Hertz contact; lankarani_nikravesh: as published; exact: free impacts return exactly "
        "the restitution",
        choices=("lankarani_nikravesh", "exact"),
    )
    mesh_phase: str = parameter(
        "actual",
        "what the mesh phase follows; nominal: the speed set-point; actual: the angle of the gears",
        choices=("nominal", "actual"),
    )
    gears: GearPairParameters = field(default_factory=GearPairParameters)
    mesh: MeshParameters = field(default_factory=MeshParameters)
    surface: SurfaceParameters = field(default_factory=SurfaceParameters)
    bearings: BearingPairParameters = field(default_factory=BearingPairParameters)
    oil: OilParameters = field(default_factory=OilParameters)
    operation: OperationParameters = field(default_factory=OperationParameters)
    solver: SolverParameters = field(default_factory=SolverParameters)
    pacing: PacingParameters = field(default_factory=PacingParameters)
    stepping: SteppingParameters = field(default_factory=SteppingParameters)
    checkpoint: CheckpointParameters = field(default_factory=CheckpointParameters)
    recording: RecordingParameters = field(default_factory=RecordingParameters)
    rerun: RerunParameters = field(default_factory=RerunParameters)
    autostart: bool = parameter(True, "true: the node configures and activates itself at the start")
    joint_prefix: str = parameter("", "text before the joint names driving, driven and mesh")
    waveform_channels: tuple[str, ...] = parameter(
        CHANNEL_NAMES,
        "channels of ~/waveform in this order; time must come first",
        choices=tuple(COLUMN),
        length=(1, len(COLUMN)),
    )
    clock_rate: float = parameter(
        0.0,
        "rate of /clock in simulated time, at most one a chunk; 0: no /clock",
        unit="Hz",
        minimum=0.0,
        maximum=1e4,
    )

    def __post_init__(self) -> None:
        for name, value in _leaves(self, ""):
            check_value(specifications()[name], value)
        check_bearings(self.bearings)
        check_mesh(self.mesh)
        check_surface(self.surface, self.gears)
        check_operation(self.operation, self.mesh_phase)
        check_solver(self.solver)
        check_pacing(self.pacing)
        check_clock(self.clock_rate, self.clock_period_ns, self.solver)
        check_waveform_channels(self.waveform_channels)
        check_recording(self.recording)
        check_rerun(self.rerun)

    @property
    def clock_period_ns(self) -> int:
        """Simulated time between two messages on /clock, ns; 0 if there are none."""
        return round(1e9 / self.clock_rate) if self.clock_rate > 0.0 else 0

    @classmethod
    def from_flat(cls, values: Mapping[str, object]) -> Parameters:
        """Parameters from values by dotted name; a missing one has its default.

        An integer becomes a float where one is needed, and any sequence a tuple. Parameters of ROS itself,
        such as use_sim_time, are left out. Raises UsageError if a name is unknown or a value is not valid.
        """
        converted: dict[str, Value] = {}
        for name, value in values.items():
            if not ROS_OWN_PARAMETERS.fullmatch(name):
                converted[name] = converted_value(specification_of(name), value)
        return cls(**_arguments(cls, "", converted))

    def to_flat(self) -> dict[str, Value]:
        """Every value by its dotted name, in the order of the table."""
        return dict(_leaves(self, ""))


@cache
def specifications() -> Mapping[str, Specification]:
    """The table of parameters by dotted name, in the order of the tree."""
    return dict(_rows(Parameters, ""))


def specification_of(name: str) -> Specification:
    """The row of the parameter ``name`` (dotted). Raises UsageError, with a hint, if there is none."""
    row = specifications().get(name)
    if row is None:
        raise UsageError(unknown_parameter(name))
    return row


def _members(group: Any) -> Iterator[tuple[str, Specification | None, Any]]:
    """Of each field of a group (a class or an object): name, row if it is a parameter, class if a group."""
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
    """Arguments that build ``group`` with ``values`` by dotted name; the others keep their defaults."""
    arguments: dict[str, Any] = {}
    for name, row, subgroup in _members(group):
        if row is None:
            arguments[name] = subgroup(**_arguments(subgroup, f"{prefix}{name}.", values))
        elif prefix + name in values:
            arguments[name] = values[prefix + name]
    return arguments


def unknown_parameter(name: str) -> str:
    """Why there is no parameter ``name``, and which may be meant."""
    names = specifications()
    inside = [known for known in names if known.startswith(f"{name}.")]
    if inside:
        return f"{name} is a group, not a parameter: set one of its parameters, such as {inside[0]}"
    leaf = name.rsplit(".", 1)[-1]
    alike = (known for known in names if known.rsplit(".", 1)[-1] == leaf)
    meant = most_alike(name, names) or next(alike, "")
    hint = f"did you mean {meant}?" if meant else "docs/parameters.md lists them all"
    return f"there is no parameter {shortened(name)}: {hint}"
