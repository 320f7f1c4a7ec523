"""Messages and requests of any ROS 2 type, filled with odd values: extremes, NaN, nothing, unknown names."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from importlib import import_module
from typing import Any, Final

from rosidl_parser.definition import AbstractNestedType, AbstractString, Array, BasicType, NamespacedType

_FLOATS: Final = (0.0, -0.0, 1.0, -1.0, 30.0, 1e-320, 1e300, -1e300, math.nan, math.inf, -math.inf)
_TEXTS: Final = ("", " ", "/", "~", "a" * 70_000, "ü\u2028\U0001f600", "a\nb", "use_sim_time", "{}", "-1")
_LENGTHS: Final = (0, 0, 1, 1, 2, 3, 17, 1000)
# Of lists in the entries of a list: long ones there make messages of hundreds of MB, which take DDS minutes.
_INNER_LENGTHS: Final = (0, 1, 3)


def odd_message(
    kind: Any, rng: random.Random, words: Sequence[str], lengths: Sequence[int] = _LENGTHS
) -> Any:
    """A message of the class ``kind``; its texts are odd or one of ``words``, its lists have ``lengths``."""
    message = kind()
    for field, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        setattr(message, field, _value(slot, rng, words, lengths))
    return message


def interface(name: str) -> Any:
    """Class of the message or service ``name``, such as std_srvs/srv/Trigger."""
    package, folder, kind = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


def _value(slot: Any, rng: random.Random, words: Sequence[str], lengths: Sequence[int]) -> Any:
    if isinstance(slot, AbstractNestedType):
        length = slot.size if isinstance(slot, Array) else rng.choice(lengths)
        return [_value(slot.value_type, rng, words, _INNER_LENGTHS) for _ in range(length)]
    if isinstance(slot, NamespacedType):
        return odd_message(interface("/".join(slot.namespaced_name())), rng, words, lengths)
    if isinstance(slot, AbstractString):
        return rng.choice(words if rng.random() < 0.7 else _TEXTS)
    return _number(slot, rng)


def _number(slot: BasicType, rng: random.Random) -> Any:
    name = slot.typename
    if name == "boolean":
        return rng.random() < 0.5
    if name == "octet":
        return bytes([rng.randrange(256)])
    if "int" not in name:
        return rng.choice(_FLOATS)
    bits = int(name.rpartition("int")[2])
    low, high = (0, 2**bits - 1) if name.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice([low, high, 0, 1, 2, 3, 4, rng.randint(0, 12), rng.randint(low, high)])
