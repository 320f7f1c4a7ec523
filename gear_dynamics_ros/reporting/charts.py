"""Charts over time as shapes of an SVG picture, which the template chart.svg.j2 draws.

A chart has lanes above each other with one time axis. Data are in the units of the axes, shapes in units of
the picture, of which the chart is WIDTH wide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

WIDTH: Final = 1000.0
LEFT: Final = 96.0  # room for the labels of an axis
RIGHT: Final = 28.0  # room for half of the last number of the axis
TOP: Final = 10.0
BOTTOM: Final = 44.0
BETWEEN: Final = 14.0  # lanes
LANE_HEIGHT: Final = 112.0
ROW_HEIGHT: Final = 19.0  # of the texts of marks
LEGEND_HEIGHT: Final = 20.0  # above a lane with several curves
GLYPH: Final = 8.4  # width of a letter, about
MOST_POINTS: Final = 500  # of a curve; of more, minimum and maximum of each interval are drawn
STRIP: Final = 3.0  # least height of a rectangle
NEAR: Final = 1.2  # distance of two points of a line of which one is left out
MARGIN: Final = 0.06  # of a lane's height, above and below its data


class Curve(NamedTuple):
    """Minimum and maximum of a quantity over time, all of shape (n,); equal ones make a line."""

    label: str
    colour: str
    time: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    dashed: bool = False


class Band(NamedTuple):
    """A rectangle: times in s, levels in the unit of the lane; a level may be infinite."""

    start: float
    end: float
    low: float
    high: float
    colour: str
    label: str = ""


class Mark(NamedTuple):
    """A vertical line at a time in s."""

    time: float
    label: str
    colour: str


@dataclass(frozen=True)
class Lane:
    """One diagram; ``marks`` go through all lanes, and have their texts in this one."""

    label: str
    unit: str = ""
    curves: Sequence[Curve] = ()
    bands: Sequence[Band] = ()
    levels: Sequence[Band] = ()  # outlined, their limits kept in view
    boxes: Sequence[Band] = ()  # outlined, as far as they are in view
    marks: Sequence[Mark] = ()
    names: dict[float, str] = field(default_factory=dict)  # of levels, instead of numbers on the axis
    height: float = LANE_HEIGHT


class Scale(NamedTuple):
    """Places of the numbers ``low`` to ``high`` between the places ``start`` and ``end``."""

    low: float
    high: float
    start: float
    end: float

    def place(self, value: float) -> float:
        """Place of ``value``, held within twice the range."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.start + min(max(share, -0.5), 1.5) * (self.end - self.start), 1)


class Text(NamedTuple):
    """A text at a place."""

    x: float
    y: float
    text: str
    anchor: str = "start"


class Rectangle(NamedTuple):
    """A filled rectangle."""

    x: float
    y: float
    width: float
    height: float
    colour: str
    label: str


class Polygon(NamedTuple):
    """A curve; ``points`` as SVG writes them. If ``filled``, the outline of its minimum and maximum."""

    points: str
    colour: str
    filled: bool
    dashed: bool


class Line(NamedTuple):
    """A straight line."""

    x1: float
    y1: float
    x2: float
    y2: float
    colour: str


class LegendEntry(NamedTuple):
    """Name of a curve, with a piece of its line before it."""

    text: Text
    colour: str
    dashed: bool


class Drawing(NamedTuple):
    """Shapes of one lane."""

    label: Sequence[str]  # a line each
    top: float
    height: float
    left: float
    width: float
    grid: Sequence[Line]
    ticks: Sequence[Text]
    bands: Sequence[Rectangle]
    levels: Sequence[Rectangle]
    curves: Sequence[Polygon]
    legend: Sequence[LegendEntry]
    texts: Sequence[Text]
    upright: bool  # the label is no text along an axis


class Chart(NamedTuple):
    """Shapes of a chart."""

    title: str
    width: float
    height: float
    lanes: Sequence[Drawing]
    marks: Sequence[Line]
    ticks: Sequence[Text]
    time_label: Text
    clip: str  # an id that no other chart of the page has


def draw_chart(
    title: str, lanes: Sequence[Lane], start: float, end: float, clip: str, time_label: str
) -> Chart:
    """Chart of ``lanes`` from ``start`` to ``end`` (s), with ``time_label`` below the axis."""
    time = Scale(start, end if end > start else start + 1e-9, LEFT, WIDTH - RIGHT)
    drawings: list[Drawing] = []
    top = TOP
    for lane in lanes:
        named = [curve for curve in lane.curves if curve.label]
        top += LEGEND_HEIGHT if named else 0.0
        drawing = _draw_lane(lane, time, top)
        drawings.append(drawing)
        top += drawing.height + BETWEEN
    bottom = top - BETWEEN
    ticks = nice_ticks(time.low, time.high, 10)
    return Chart(
        title,
        WIDTH,
        bottom + BOTTOM,
        drawings,
        [
            Line(time.place(mark.time), TOP, time.place(mark.time), bottom, mark.colour)
            for lane in lanes
            for mark in lane.marks
        ],
        [Text(time.place(tick), bottom + 18.0, tick_text(tick, ticks), "middle") for tick in ticks],
        Text((LEFT + WIDTH - RIGHT) / 2.0, bottom + 38.0, time_label, "middle"),
        clip,
    )


def _draw_lane(lane: Lane, time: Scale, top: float) -> Drawing:
    texts, rows = _mark_texts(lane.marks, time, top)
    height = lane.height if lane.curves or lane.names else rows * ROW_HEIGHT + 8.0
    value = _value_scale(lane, top, top + height)
    has_axis = bool(lane.curves or lane.names)
    places = sorted(lane.names) if lane.names else nice_ticks(value.low, value.high, 4)
    ticks = [
        Text(LEFT - 8.0, value.place(tick) + 5.0, lane.names.get(tick) or tick_text(tick, places), "end")
        for tick in places
    ]
    grid = [Line(LEFT, value.place(tick), WIDTH - RIGHT, value.place(tick), "#e3e3e3") for tick in places]
    return Drawing(
        label=_label_lines(lane, height),
        top=top,
        height=height,
        left=LEFT,
        width=WIDTH - LEFT - RIGHT,
        grid=grid if has_axis else [],
        ticks=ticks if has_axis else [],
        bands=[_rectangle(band, time, value) for band in lane.bands],
        levels=[_rectangle(band, time, value) for band in (*lane.levels, *lane.boxes)],
        curves=[_polygon(curve, time, value) for curve in lane.curves if len(curve.time)],
        legend=_legend(lane, top),
        texts=texts,
        upright=not has_axis,
    )


def _label_lines(lane: Lane, height: float) -> list[str]:
    """Label and unit, in two lines where one is too long."""
    if not lane.unit:
        return [lane.label]
    whole = f"{lane.label} ({lane.unit})"
    return [whole] if GLYPH * len(whole) <= height else [lane.label, f"({lane.unit})"]


def _value_scale(lane: Lane, top: float, bottom: float) -> Scale:
    """Scale that holds all curves, the finite limits of all levels and, with names, these."""
    levels = [bound for band in lane.levels for bound in (band.low, band.high)]
    data = [float(bound) for curve in lane.curves for bound in (*curve.low, *curve.high)]
    values = [value for value in (*levels, *data, *lane.names) if math.isfinite(value)] or [0.0]
    low, high = min(values), max(values)
    if high - low <= 1e-9 * max(abs(high), abs(low)):
        pad = 0.05 * abs(high) or 1.0
        low, high = low - pad, high + pad
    margin = MARGIN * (high - low)
    return Scale(low - margin, high + margin, bottom, top)


def _rectangle(band: Band, time: Scale, value: Scale) -> Rectangle:
    left, right = (min(max(time.place(t), time.start), time.end) for t in (band.start, band.end))
    # Scale.place holds infinite levels outside the view; the rectangle is clipped to the lane.
    top, bottom = (min(max(value.place(v), value.end), value.start) for v in (band.high, band.low))
    # What is out of view leaves a strip at the edge.
    top, height = min(top, value.start - STRIP), max(bottom - top, STRIP)
    return Rectangle(left, top, max(right - left, 1.0), height, band.colour, band.label)


def _polygon(curve: Curve, time: Scale, value: Scale) -> Polygon:
    if np.array_equal(curve.low, curve.high):
        points = _thinned_line(
            [(time.place(t), value.place(v)) for t, v in zip(curve.time, curve.low, strict=True)]
        )
        return Polygon(_point_text(points), curve.colour, filled=False, dashed=curve.dashed)
    times, low, high = thin_out(curve.time, curve.low, curve.high, MOST_POINTS)
    upper = [(time.place(t), value.place(v)) for t, v in zip(times, high, strict=True)]
    lower = [(time.place(t), value.place(v)) for t, v in zip(times, low, strict=True)]
    return Polygon(_point_text([*upper, *reversed(lower)]), curve.colour, filled=True, dashed=False)


def _point_text(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x:g},{y:g}" for x, y in points)


def _thinned_line(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """``points`` without those that lie hardly away from the one before; corners of steps stay."""
    kept = [points[0]]
    before = points[0]
    for point in points[1:]:
        if max(abs(point[0] - kept[-1][0]), abs(point[1] - kept[-1][1])) > NEAR:
            if before != kept[-1]:
                kept.append(before)
            kept.append(point)
        before = point
    return kept if kept[-1] == before else [*kept, before]


def thin_out(
    time: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """At most ``most`` points with the first time, the minimum and the maximum of as many intervals."""
    if len(time) <= most:
        return time, low, high
    starts = np.unique(np.linspace(0, len(time), most, endpoint=False).astype(np.int64))
    return time[starts], np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def _legend(lane: Lane, top: float) -> list[LegendEntry]:
    """Names of the curves and levels above a lane whose upper edge is at ``top``."""
    entries: list[LegendEntry] = []
    left = LEFT + 26.0
    curves = [(curve.label, curve.colour, curve.dashed) for curve in lane.curves]
    for label, colour, dashed in (*curves, *((level.label, level.colour, False) for level in lane.levels)):
        if label:
            entries.append(LegendEntry(Text(left, top - 6.0, label), colour, dashed))
            left += GLYPH * len(label) + 48.0
    return entries


def _mark_texts(marks: Sequence[Mark], time: Scale, top: float) -> tuple[list[Text], int]:
    """The texts of marks in rows, so that none covers another, and the number of rows."""
    ends: list[float] = []
    texts: list[Text] = []
    for mark in sorted(marks, key=lambda mark: mark.time):
        if not mark.label:
            continue
        width = GLYPH * len(mark.label)
        place = time.place(mark.time)
        # Where the text would leave the picture, it stands left of its mark.
        left = place + 4.0 if place + 4.0 + width <= WIDTH else place - 4.0 - width
        row = next((row for row, end in enumerate(ends) if end <= left), len(ends))
        ends[row : row + 1] = [left + width + 8.0]
        texts.append(Text(left, top + 15.0 + row * ROW_HEIGHT, mark.label))
    return texts, max(1, len(ends))


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round numbers at equal distances from ``low`` to ``high``."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [step * count for count in range(first, last + 1)]


def tick_text(value: float, ticks: Iterable[float]) -> str:
    """``value`` with as many decimals as the distance of ``ticks`` needs."""
    places = sorted(ticks)
    step = min((b - a for a, b in pairwise(places)), default=abs(value) or 1.0)
    if max(abs(places[0]), abs(places[-1]), step) >= 1e6 or step < 1e-6:
        return f"{value:.4g}"
    return f"{value + 0.0:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"
