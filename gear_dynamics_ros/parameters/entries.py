"""Numbers of the tree by name: single parameters, entries of lists, and patterns that name several."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters.changes import updated
from gear_dynamics_ros.parameters.hints import shortened
from gear_dynamics_ros.parameters.tree import Parameters, specification_of, specifications

_WRITTEN: Final = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<place>\d+)\])?")


class Entry(NamedTuple):
    """A parameter, or one number of a parameter that is a list."""

    name: str  # dotted
    place: int | None  # in the list, from 0

    def __str__(self) -> str:
        return self.name if self.place is None else f"{self.name}[{self.place}]"

    def value(self, parameters: Parameters) -> Any:
        """Its value in ``parameters``. Raises UsageError if the list there is shorter."""
        value: Any = parameters.to_flat()[self.name]
        if self.place is None:
            return value
        if self.place >= len(value):
            raise UsageError(
                f"{self} does not exist: {self.name} has {len(value)} numbers, counted from 0: "
                f"set more, {self.name}=[...]"
            )
        return value[self.place]


def entries_named(pattern: str) -> tuple[Entry, ...]:
    """What ``pattern`` names: ``group.name``, ``group.list[0]``; a ``*`` stands for any letters but dots.

    Raises UsageError if there is none, or a list is named without a place, or a place in what is no list.
    """
    written = _WRITTEN.fullmatch(pattern)
    if written is None:
        raise UsageError(f"{shortened(pattern)!r} is not the name of a parameter: write it as group.name")
    place = None if written["place"] is None else int(written["place"])
    return tuple(_entry(name, place) for name in _names(written["name"]))


def with_entries(parameters: Parameters, values: Mapping[Entry, Any]) -> Parameters:
    """``parameters`` with ``values``. Raises UsageError if they are not valid together."""
    flat = parameters.to_flat()
    changed: dict[str, Any] = {}
    for (name, place), value in values.items():
        if place is None:
            changed[name] = value
        else:
            entries = list(changed.get(name, flat[name]))
            entries[place] = value
            changed[name] = entries
    return updated(parameters, changed)


def _names(pattern: str) -> list[str]:
    if "*" not in pattern:
        return [specification_of(pattern).name]
    parts = pattern.split(".")
    names = [
        name
        for name in specifications()
        if len(name.split(".")) == len(parts) and all(map(fnmatchcase, name.split("."), parts))
    ]
    if not names:
        raise UsageError(f"no parameter matches {shortened(pattern)}: docs/parameters.md lists them all")
    return names


def _entry(name: str, place: int | None) -> Entry:
    listed = specification_of(name).type is tuple
    if listed and place is None:
        raise UsageError(f"{name} is a list: name one of its numbers, such as {name}[0]")
    if place is not None and not listed:
        raise UsageError(f"{name} is not a list: leave [{place}] out")
    return Entry(name, place)
