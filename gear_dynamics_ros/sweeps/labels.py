"""What is swept, and in which units it is shown."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

MODEL: Final = "model"
DIRECTION: Final = "direction"
# Dimensions of a sweep's dataset that are not swept.
FIXED_DIMENSIONS: Final = (MODEL, DIRECTION, "section", "order")


class DisplayUnit(NamedTuple):
    """A unit that readers of a figure expect, and what turns a value in SI units into it."""

    symbol: str
    factor: float


def display_unit(unit: str, largest: float) -> DisplayUnit:
    """How to show values in the SI ``unit`` of which ``largest`` is the largest magnitude."""
    if unit == "m":
        return _length_unit(largest)
    if unit == "N" and largest >= 1e4:
        return DisplayUnit("kN", 1e-3)
    return {
        "rad/s": DisplayUnit("rpm", 30.0 / math.pi),
        "rad": DisplayUnit("°", 180.0 / math.pi),
        "Pa s": DisplayUnit("mPa s", 1e3),
        "1": DisplayUnit("", 1.0),
    }.get(unit, DisplayUnit(unit, 1.0))


def _length_unit(largest: float) -> DisplayUnit:
    if largest < 1e-3:
        return DisplayUnit("µm", 1e6)
    return DisplayUnit("mm", 1e3) if largest < 1.0 else DisplayUnit("m", 1.0)


def with_symbol(text: str, symbol: str) -> str:
    """Axis label: the quantity, and its unit in parentheses if it has one."""
    return f"{text} ({symbol})" if symbol else text


class SweptQuantity(NamedTuple):
    """One swept dimension as a figure's axis shows it."""

    name: str  # of the dimension
    label: str  # with unit
    positions: NDArray[np.float64]  # rising, shape (n,), in the unit of the label; 0, 1, ... of names
    names: tuple[str, ...]  # at the positions, if the values are not numbers


def swept_quantities(dataset: xr.Dataset) -> list[SweptQuantity]:
    """What ``dataset`` was swept over, in the order of its dimensions; its values must rise."""
    return [_swept(dataset[name]) for name in map(str, dataset.dims) if name not in FIXED_DIMENSIONS]


def _swept(values: xr.DataArray) -> SweptQuantity:
    name = str(values.name)
    if values.dtype.kind not in "iuf":
        names = tuple(map(str, values.to_numpy()))
        return SweptQuantity(name, name, np.arange(len(names), dtype=np.float64), names)
    numbers = values.to_numpy().astype(np.float64)
    unit = display_unit(str(values.attrs.get("units", "1")), float(np.abs(numbers).max()))
    return SweptQuantity(name, with_symbol(name, unit.symbol), unit.factor * numbers, ())


def rising(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` with rising values along each swept dimension of numbers."""
    numeric = [
        str(name)
        for name in dataset.dims
        if name not in FIXED_DIMENSIONS and dataset[name].dtype.kind in "iuf"
    ]
    return dataset.sortby(numeric)
