"""Renders the pages of reports from the Jinja2 templates of this package; every text is escaped."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Final, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

DIGITS: Final = 4
_PREFIXED: Final = ("m", "N", "J", "W", "Hz", "s", "m/s", "Pa")
_PREFIXES: Final = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


class NumberText(NamedTuple):
    """A number as text, with its unit."""

    text: str
    unit: str

    def __str__(self) -> str:
        return f"{self.text} {self.unit}".rstrip()


def render_page(template: str, content: Mapping[str, Any]) -> bytes:
    """The page of ``template``, a file in the folder templates, filled with ``content``, in UTF-8."""
    # Names of files may be no text: what UTF-8 can't hold becomes a question mark.
    return _environment().get_template(template).render(content).encode("utf-8", "replace")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("gear_dynamics_ros.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["quantity"] = quantity
    environment.filters["percent"] = percent
    environment.filters["png_url"] = png_url
    return environment


def quantity(value: float, unit: str = "", digits: int = DIGITS) -> NumberText:
    """``value`` with ``digits`` significant digits and, where the unit takes one, a prefix."""
    if isinstance(value, int) or not math.isfinite(value):
        return NumberText(f"{value}", unit)
    # Rounded first: 999.96 with four digits is 1000, so 1 k.
    factor, shown = axis_unit(float(f"{abs(value):.{digits - 1}e}"), unit)
    return NumberText(_plain(value * factor, digits), shown)


def percent(share: float) -> str:
    """``share`` (0 to 1) in per cent, without the sign; one that is not 0 is never shown as 0."""
    return "< 0.01" if 0.0 < share < 5e-5 else f"{100.0 * share:.2f}"


def axis_unit(size: float, unit: str) -> tuple[float, str]:
    """Factor and unit, with a prefix if it takes one, to show values up to ``size`` (> 0) in ``unit``."""
    if unit not in _PREFIXED or not size:
        return 1.0, unit
    scale, prefix = next((row for row in _PREFIXES if size >= row[0]), _PREFIXES[-1])
    return 1.0 / scale, prefix + unit


def _plain(value: float, digits: int) -> str:
    """``value`` without an exponent where it is neither very large nor very small."""
    rounded = float(f"{value:.{digits - 1}e}")
    if rounded == 0.0 or not 1e-4 <= abs(rounded) < 1e7:
        return f"{value:.{digits}g}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    text = f"{value:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def png_url(picture: bytes) -> str:
    """A PNG file as a URL that holds the file itself."""
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"
