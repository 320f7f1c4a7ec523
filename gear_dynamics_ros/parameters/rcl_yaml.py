"""YAML as rcl reads it: own code, as PyYAML and rcl read numbers differently, and node and tools must agree.

For rcl_yaml_param_parser 3.0e8 and 1e-6 are numbers (text for PyYAML), 010 is octal, 08 a float; 1_000, ~ and
12:30 are text. Aliases are an error. A name given twice, which rcl accepts, is an error here.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator
from typing import Any, Final, TypeAlias

import yaml

from gear_dynamics_ros.errors import UsageError

Scalar: TypeAlias = bool | int | float | str
YamlTree: TypeAlias = "Scalar | list[YamlTree] | dict[str, YamlTree]"

# Below it strtod reports an underflow, and rcl takes the text for a string.
SMALLEST_NORMAL: Final = sys.float_info.min
DEEPEST: Final = 50

_TRUE = frozenset(["Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_INTEGER = re.compile(r"\s*([+-]?)(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)", re.ASCII)
_DECIMAL = re.compile(r"\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)
_HEXADECIMAL = re.compile(
    r"\s*[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][+-]?[0-9]+)?", re.ASCII
)
_DOTTED = re.compile(r"[+-]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NAMED = re.compile(r"\s*([+-]?)(inf|infinity|nan)(\(\w*\))?", re.ASCII | re.IGNORECASE)
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NULL_ELSEWHERE = frozenset(["null", "Null", "NULL"])  # text for rcl, null for other YAML readers
_TEXT_TAG = "tag:yaml.org,2002:str"


def resolve_scalar(text: str) -> Scalar:
    """Value of a plain scalar in rcl: one of its words for booleans, by C's strtol, by strtod, or text."""
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    integer = _integer(text)
    if integer is not None:
        return integer
    number = _float(text)
    return text if number is None else number


def parse_yaml(text: str) -> YamlTree:
    """The document in ``text`` as dicts, lists and scalars.

    Raises UsageError, with the line where there is one, if ``text`` is empty or not valid YAML, has a second
    document, an alias or more than DEEPEST levels, or a name that is given twice, has no value, or is not
    plain printable text.
    """
    events = _events(text)
    next(events)
    if isinstance(next(events), yaml.StreamEndEvent):
        raise UsageError("it is empty")
    tree = _node(next(events), events, "", 0)
    next(events)
    following = next(events)
    if not isinstance(following, yaml.StreamEndEvent):
        raise UsageError(f"{_line(following)}: a second document begins: remove it")
    return tree


def scalar_text(value: Scalar) -> str:
    """A scalar as text that rcl, ``parse_yaml`` and other YAML readers read to the same value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _float_text(value)
    if isinstance(value, str):
        plain = _WORD.fullmatch(value) and resolve_scalar(value) == value and value not in _NULL_ELSEWHERE
        return value if plain else json.dumps(value, ensure_ascii=False)
    return str(value)


def _integer(text: str) -> int | None:
    """strtol with base 0; None where it stops early (08) or overflows: rcl then calls strtod."""
    match = _INTEGER.fullmatch(text)
    if match is None:
        return None
    sign, digits = match.groups()
    base = 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" else 10
    value = int(sign + digits, base)
    return value if -(2**63) <= value < 2**63 else None


def _float(text: str) -> float | None:
    """strtod; None where it stops early, overflows or underflows: rcl then takes the text for a string."""
    if _DOTTED.fullmatch(text):
        return float(text.replace(".", ""))
    named = _NAMED.fullmatch(text)
    if named and (named[3] is None or named[2].lower() == "nan"):
        return float(named[1] + named[2])
    try:
        if _DECIMAL.fullmatch(text):
            value, digits = float(text), re.split("[eE]", text)[0]
        elif _HEXADECIMAL.fullmatch(text):
            value, digits = float.fromhex(text.strip()), re.split("[xXpP]", text)[1]
        else:
            return None
    except OverflowError:
        return None
    underflow = abs(value) < SMALLEST_NORMAL and re.search("[1-9a-fA-F]", digits) is not None
    return None if underflow or math.isinf(value) else value


def _float_text(value: float) -> str:
    if not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0.0 else "-.inf"
    digits, exponent, power = repr(value).partition("e")
    return digits + ("" if "." in digits else ".0") + exponent + power


def _events(text: str) -> Iterator[Any]:
    try:
        yield from yaml.parse(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise UsageError(f"{line}not valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise UsageError(f"not valid YAML: {' '.join(str(error).split())}") from None


def _node(event: Any, events: Iterator[Any], name: str, depth: int) -> YamlTree:
    if depth > DEEPEST:
        raise UsageError(f"{_line(event)}: more than {DEEPEST} levels deep: reduce the nesting")
    if isinstance(event, yaml.AliasEvent):
        raise UsageError(
            f"{_line(event)}: *{event.anchor} is an alias, which ROS refuses: write the value itself"
        )
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event, name)
    if isinstance(event, yaml.SequenceStartEvent):
        return _sequence(events, name, depth)
    return _mapping(events, name, depth)


def _sequence(events: Iterator[Any], name: str, depth: int) -> list[YamlTree]:
    entries: list[YamlTree] = []
    while not isinstance(event := next(events), yaml.SequenceEndEvent):
        entries.append(_node(event, events, f"{name}[{len(entries)}]", depth + 1))
    return entries


def _mapping(events: Iterator[Any], name: str, depth: int) -> dict[str, YamlTree]:
    entries: dict[str, YamlTree] = {}
    while not isinstance(event := next(events), yaml.MappingEndEvent):
        if not isinstance(event, yaml.ScalarEvent):
            raise UsageError(f"{_line(event)}: a name must be plain text")
        key = str(event.value)
        if not key.isprintable():
            raise UsageError(
                f"{_line(event)}: the name {key!r} contains characters that can't be printed: remove them"
            )
        path = f"{name}.{key}" if name else key
        if key in entries:
            raise UsageError(f"{_line(event)}: {path} is given twice: remove one")
        entries[key] = _node(next(events), events, path, depth + 1)
    return entries


def _scalar(event: Any, name: str) -> Scalar:
    text = str(event.value)
    if event.style in ("'", '"') or event.tag == _TEXT_TAG:
        return text
    if not text:
        raise UsageError(f"{_line(event)}: {name or 'it'} has no value: write one, '' for empty text")
    return resolve_scalar(text)


def _line(event: Any) -> str:
    return f"line {event.start_mark.line + 1}"
