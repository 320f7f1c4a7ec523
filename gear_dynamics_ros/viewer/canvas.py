"""Sends drawings to one Rerun stream: y points upward here and downward in Rerun.

Points are complex numbers x + iy in the unit of the view. A drawing over time has one entry a frame. It waits
until ``send``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

LINE_WIDTH: Final = 1.0
CIRCLE_POINTS: Final = 121

Points = NDArray[np.complex128]
Values = NDArray[np.float64]
Rgb = tuple[int, int, int]


class Times(NamedTuple):
    """Times of frames on one timeline."""

    timeline: str
    ns: NDArray[np.int64]


def rgb_values(colour: str) -> Rgb:
    """Red, green and blue, 0 to 255, of a colour #RRGGBB."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def circle(radius: float, centre: complex = 0.0) -> Points:
    """Closed line, shape (CIRCLE_POINTS,)."""
    return np.asarray(centre + radius * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)))


def flat_points(points: Points) -> NDArray[np.float32]:
    """Rerun's x and y of ``points``; shape (..., 2)."""
    return np.stack([points.real, -points.imag], axis=-1).astype(np.float32)


class Canvas:
    """Draws into one Rerun stream; for one thread."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._waiting: dict[tuple[str, str, Callable[..., list[Any]]], list[tuple[Any, Any]]] = {}

    def fix(self, entity: str, shape: Any) -> None:
        """Draw ``shape``, an archetype of Rerun, for the whole run."""
        self._stream.log(entity, shape, static=True)

    def fix_lines(self, entity: str, lines: Sequence[Points], colours: Sequence[str], width: float) -> None:
        """Lines that stay, one colour each, ``width`` in points of the screen."""
        strips = [flat_points(line) for line in lines]
        rgb = [rgb_values(colour) for colour in colours]
        self.fix(entity, rr.LineStrips2D(strips, colors=rgb, radii=rr.Radius.ui_points(0.5 * width)))

    def fix_labels(self, entity: str, texts: Mapping[str, complex], colour: str) -> None:
        """Texts that stay, centred above their points."""
        self.fix(
            entity,
            rr.Points2D(
                flat_points(np.array(list(texts.values()), dtype=np.complex128)),
                labels=list(texts),
                show_labels=True,
                radii=rr.Radius.ui_points(0.0),
                colors=rgb_values(colour),
            ),
        )

    def style_lines(self, entity: str, colours: Sequence[str], width: float = LINE_WIDTH) -> None:
        """Width of ``lines``, and the colour of each; without colours, each frame has its own."""
        rgb = [rgb_values(colour) for colour in colours] or None
        radius = rr.Radius.ui_points(0.5 * width)
        self.fix(entity, rr.LineStrips2D.from_fields(colors=rgb, radii=radius))

    def style_points(self, entity: str, colour: str, size: float) -> None:
        """Colour and size of ``points``."""
        radius = rr.Radius.ui_points(0.5 * size)
        self.fix(entity, rr.Points2D.from_fields(colors=rgb_values(colour), radii=radius))

    def style_labels(self, entity: str) -> None:
        """Make ``labels`` text without a point."""
        self.fix(entity, rr.Points2D.from_fields(radii=rr.Radius.ui_points(0.0), show_labels=True))

    def style_arrows(self, entity: str, colour: str, width: float = 3.0) -> None:
        """Colour and width of ``arrows``."""
        radius = rr.Radius.ui_points(0.5 * width)
        self.fix(entity, rr.Arrows2D.from_fields(colors=rgb_values(colour), radii=radius))

    def lines(
        self,
        entity: str,
        times: Times,
        lines: Sequence[Points] | Points,
        colours: Sequence[str] | None = None,
    ) -> None:
        """``lines[frame]``: a line (points,), or several of one length (lines, points); a colour a frame."""
        self._put(entity, times, _line_columns, lines, colours)

    def points(self, entity: str, times: Times, points: Sequence[Points] | Points) -> None:
        """``points[frame]``: any number of points (points,)."""
        self._put(entity, times, _point_columns, points)

    def labels(
        self, entity: str, times: Times, points: Points, texts: Sequence[str], colours: Sequence[str]
    ) -> None:
        """One text a frame at ``points[frame]``, with its colour."""
        self._put(entity, times, _label_columns, points, texts, colours)

    def arrows(
        self,
        entity: str,
        times: Times,
        origins: Sequence[Points] | Points,
        vectors: Sequence[Points] | Points,
    ) -> None:
        """``origins[frame]`` and ``vectors[frame]``: any number of arrows (arrows,)."""
        self._put(entity, times, _arrow_columns, origins, vectors)

    def placements(self, entity: str, times: Times, centres: Points, angles: Values) -> None:
        """Where what is drawn below ``entity`` is moved and turned (rad, counter-clockwise), each (n,)."""
        self._put(entity, times, _placement_columns, centres, angles)

    def scalars(self, entity: str, times: Times, values: Values) -> None:
        """Points of a curve, shape (n,)."""
        self._put(entity, times, _scalar_columns, values)

    def states(self, entity: str, times: Times, states: Sequence[str]) -> None:
        """States that begin."""
        self._put(entity, times, _state_columns, states)

    def log_lines(self, entity: str, times: Times, texts: Sequence[str], levels: Sequence[str]) -> None:
        """Lines of a log."""
        self._put(entity, times, _log_columns, texts, levels)

    def send(self) -> None:
        """Send everything drawn over time since the last call.

        Rerun keeps what is sent at once as one chunk of an entity, whose frame takes more than a few points.
        """
        waiting, self._waiting = self._waiting, {}
        for (entity, timeline, columns), parts in waiting.items():
            times = np.concatenate([part[0] for part in parts])
            if len(times):
                merged = [_together([part[1][i] for part in parts]) for i in range(len(parts[0][1]))]
                index = rr.TimeColumn(timeline, duration=times.astype("timedelta64[ns]"))
                self._stream.send_columns(entity, indexes=[index], columns=columns(*merged), strict=True)

    def _put(self, entity: str, times: Times, columns: Callable[..., list[Any]], *frames: Any) -> None:
        key = (entity, times.timeline, columns)
        self._waiting.setdefault(key, []).append((times.ns, frames))


def _together(parts: Sequence[Any]) -> Any:
    """The frames of all ``parts``, arrays or sequences; None if there are none."""
    if parts[0] is None:
        return None
    if all(isinstance(part, np.ndarray) for part in parts) and len({part.shape[1:] for part in parts}) == 1:
        return np.concatenate(parts)
    return [frame for part in parts for frame in part]


def _line_columns(lines: Sequence[Points], colours: Sequence[str] | None) -> list[Any]:
    frames = [flat_points(frame) for frame in lines]
    counts = [1 if frame.ndim == 2 else len(frame) for frame in frames]
    strips = [strip for frame in frames for strip in ([frame] if frame.ndim == 2 else frame)]
    columns = list(rr.LineStrips2D.columns(strips=strips).partition(counts))
    if colours is not None:
        columns += list(rr.LineStrips2D.columns(colors=[rgb_values(colour) for colour in colours]))
    return columns


def _point_columns(points: Sequence[Points]) -> list[Any]:
    counts = [len(frame) for frame in points]
    positions = flat_points(np.concatenate(list(points)))
    return list(rr.Points2D.columns(positions=positions).partition(counts))


def _label_columns(points: Points, texts: Sequence[str], colours: Sequence[str]) -> list[Any]:
    rgb = [rgb_values(colour) for colour in colours]
    return list(rr.Points2D.columns(positions=flat_points(points), labels=list(texts), colors=rgb))


def _arrow_columns(origins: Sequence[Points], vectors: Sequence[Points]) -> list[Any]:
    columns = rr.Arrows2D.columns(
        origins=flat_points(np.concatenate(list(origins))),
        vectors=flat_points(np.concatenate(list(vectors))),
    )
    return list(columns.partition([len(frame) for frame in origins]))


def _placement_columns(centres: Points, angles: Values) -> list[Any]:
    zeros, half = np.zeros(len(angles)), -0.5 * angles
    columns = rr.Transform3D.columns(
        translation=np.column_stack([flat_points(centres), zeros]),
        quaternion=np.column_stack([zeros, zeros, np.sin(half), np.cos(half)]),
    )
    return list(columns)


def _scalar_columns(values: Values) -> list[Any]:
    return list(rr.Scalars.columns(scalars=values))


def _state_columns(states: Sequence[str]) -> list[Any]:
    return list(rr.StateChange.columns(state=list(states)))


def _log_columns(texts: Sequence[str], levels: Sequence[str]) -> list[Any]:
    return list(rr.TextLog.columns(text=list(texts), level=list(levels)))
