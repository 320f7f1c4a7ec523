"""ROS parameter files and settings ``name=value`` to ``Parameters``, and ``Parameters`` to such a file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.rcl_yaml import YamlTree, parse_yaml
from gear_dynamics_ros.parameters.specification import value_text
from gear_dynamics_ros.parameters.tree import Parameters, specification_of

GEARBOX_NODE_NAME: Final = "/gearbox"  # full name of the node whose sections count

_WILDCARDS: Final = {"**": r"(/\w+)*", "*": r"/\w+"}  # as in rcl


def load_parameters(path: str | Path, overrides: Iterable[str] = ()) -> Parameters:
    """Parameters from a ROS parameter file, and from settings ``name=value`` that override it.

    Both are read as rcl reads them; sections of other nodes are ignored. Raises UsageError, which begins with
    ``path``, if the file can't be read, is not a ROS parameter file, or its values and the settings together
    are not valid; and UsageError if a setting can't be read.
    """
    settings = read_settings(overrides)
    try:
        return Parameters.from_flat({**_read_sections(_read_file(Path(path))), **settings})
    except UsageError as error:
        source = " with ".join([str(path), *settings])
        raise UsageError(f"{source}: {error}") from None


def parse_parameters(text: str) -> Parameters:
    """Parameters from the text of a ROS parameter file.

    Raises UsageError if it is not the text of such a file or its values are not valid.
    """
    return Parameters.from_flat(_read_sections(text))


def read_settings(settings: Iterable[str]) -> dict[str, YamlTree]:
    """Values by dotted name from settings ``name=value``; of two with one name the last counts.

    Raises UsageError if a setting has no name or value, names an unknown parameter, or is not valid YAML.
    Whether a value suits its parameter is checked later, by ``Parameters.from_flat``.
    """
    return dict(_read_setting(setting) for setting in settings)


def dump_parameters(parameters: Parameters) -> str:
    """Text of a ROS parameter file that rcl and ``load_parameters`` read back to the same bits."""
    lines = ["/**:", "  ros__parameters:"]
    previous: list[str] = []
    for name, value in parameters.to_flat().items():
        *groups, leaf = name.split(".")
        for depth, group in enumerate(groups):
            if groups[: depth + 1] != previous[: depth + 1]:
                lines.append(f"{_indent(depth)}{group}:")
        lines.append(f"{_indent(len(groups))}{leaf}: {value_text(value)}")
        previous = groups
    return "\n".join(lines) + "\n"


def _indent(depth: int) -> str:
    return "  " * (depth + 2)


def _read_file(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"it can't be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise UsageError(f"it is not UTF-8 text: {error.reason} at byte {error.start}") from None


def _read_sections(text: str) -> dict[str, YamlTree]:
    """Values for the gearbox by dotted name. A later section overrides an earlier one, as in rcl."""
    sections = [values for node, values in _node_sections(parse_yaml(text)) if _applies_to_gearbox(node)]
    if not sections:
        raise UsageError(
            f"it has no section for {GEARBOX_NODE_NAME}: put ros__parameters under /** or {GEARBOX_NODE_NAME}"
        )
    values: dict[str, YamlTree] = {}
    for section in sections:
        values.update(_flat_values(section, ""))
    return values


def _node_sections(tree: YamlTree, node: str = "") -> Iterator[tuple[str, dict[str, YamlTree]]]:
    """Name and parameters of each node, in the order of the file; a node can be inside namespaces."""
    where = node or "it"
    if not isinstance(tree, dict):
        raise UsageError(f"{where} must contain ros__parameters, or nodes that contain it")
    if "ros__parameters" in tree:
        parameters = tree["ros__parameters"]
        if not isinstance(parameters, dict):
            raise UsageError(f"{where}: ros__parameters must be a mapping of names to values")
        if others := [key for key in tree if key != "ros__parameters"]:
            raise UsageError(f"{where} must contain nothing but ros__parameters: remove {', '.join(others)}")
        yield node, parameters
        return
    for key, child in tree.items():
        yield from _node_sections(child, f"{node}/{key.strip('/')}".replace("//", "/"))


def _applies_to_gearbox(section: str) -> bool:
    tokens = [_WILDCARDS.get(token, re.escape(f"/{token}")) for token in section.split("/") if token]
    return re.fullmatch("".join(tokens), GEARBOX_NODE_NAME) is not None


def _flat_values(tree: dict[str, YamlTree], prefix: str) -> dict[str, YamlTree]:
    values: dict[str, YamlTree] = {}
    for key, child in tree.items():
        name = prefix + key
        if isinstance(child, dict):
            found = _flat_values(child, f"{name}.")
        else:
            found = {name: _checked_value(name, child)}
        for twice in values.keys() & found.keys():
            raise UsageError(f"{twice} is given twice in one section: remove one")
        values.update(found)
    if not tree and prefix:
        raise UsageError(f"{prefix[:-1]} is an empty mapping: remove it")
    return values


def _checked_value(name: str, value: YamlTree) -> YamlTree:
    """``value`` if rcl accepts it for a parameter: a scalar, or a list of scalars of one type."""
    if isinstance(value, dict):
        raise UsageError(f"{name} is a mapping: write a single value or a list")
    if isinstance(value, list):
        if any(isinstance(entry, list | dict) for entry in value):
            raise UsageError(f"{name} is a list of lists or mappings: write a list of single values")
        if len({type(entry) for entry in value}) > 1:
            raise UsageError(
                f"{name} mixes types, which ROS refuses: write all its numbers with a decimal point"
            )
    return value


def _read_setting(setting: str) -> tuple[str, YamlTree]:
    name, separator, text = setting.partition("=")
    if not separator or not name:
        raise UsageError(f"{setting!r} is not a setting: write name=value")
    specification_of(name)
    if not text.strip():
        raise UsageError(f"{name} has no value: write {name}=value, with '' for empty text")
    try:
        return name, _checked_value(name, parse_yaml(text))
    except UsageError as error:
        raise UsageError(f"{setting!r}: {error}") from None
