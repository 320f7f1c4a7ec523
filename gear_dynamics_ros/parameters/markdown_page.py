"""The table of parameters as a page of the documentation, docs/parameters.md."""

from __future__ import annotations

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters.specification import Specification, value_text
from gear_dynamics_ros.parameters.tree import specifications
from gear_dynamics_ros.topics import TOPICS

_HEADING = """\
# Parameters

The node and all tools have the same parameters, in SI units. `config/gearbox.yaml` has all of them at their
defaults. Those marked under *at run time* can change while the gearbox runs; the others are fixed from the
start. This page is the output of `python -m gear_dynamics_ros.parameters`.

| name | type | default | unit | allowed | at run time | meaning |
| --- | --- | --- | --- | --- | --- | --- |
"""


def parameters_page() -> str:
    """The table of parameters as Markdown text."""
    return _HEADING + "".join(map(_table_line, specifications().values()))


def _table_line(row: Specification) -> str:
    kind = f"list of {row.element.__name__}" if row.type is tuple else row.type.__name__
    default, allowed = _default_and_allowed(row)
    if row.length:
        allowed = f"{row.length[0]} to {row.length[1]} entries, {allowed}"
    runtime = "yes" if row.runtime else ""
    return f"| `{row.name}` | {kind} | {default} | {row.unit} | {allowed} | {runtime} | {row.help} |\n"


def _default_and_allowed(row: Specification) -> tuple[str, str]:
    """Default and allowed values; where choices are many, in words."""
    if row.choices == tuple(COLUMN):
        return "all but the energies", "names of channels and energies"
    if row.choices == tuple(TOPICS):
        return "all", f"names, {', '.join(row.choices)}"
    return f"`{value_text(row.default)}`", row.limits
