"""What is drawn: contiguous samples into Rerun's time series, orbits and phase portrait.

Time series: of every POINT_INTERVAL the lowest and the highest sample at their own times, so peaks stay (2000
points a second and channel; the 100 kHz waveform itself stands in the recording). Orbits and phase plots: the
last PICTURE_SPAN at the full rate, PICTURE_INTERVAL apart. 10 s of a run take some 20 MB.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import base_radii
from gear_dynamics_ros.signals import COLUMN
from gear_dynamics_ros.viewer import blueprint
from gear_dynamics_ros.viewer.decimation import extremes

POINT_INTERVAL: Final = 1.0e-3  # s of simulated time
PICTURE_INTERVAL: Final = 0.04
PICTURE_SPAN: Final = 0.01
MICRO: Final = 1.0e6
DEGREES: Final = 180.0 / np.pi
CIRCLE_POINTS: Final = 181
LINE: Final = rr.Radius.ui_points(0.7)
MARK: Final = rr.Radius.ui_points(5.0)
DOT: Final = rr.Radius.ui_points(1.3)
FRAME: Final = rr.Radius.ui_points(1.0)
TEXT_ONLY: Final = rr.Radius.ui_points(0.0)

Samples = NDArray[np.float64]


class Series(NamedTuple):
    """One curve: where it goes, how it is called there, and how it is made of samples of shape (n, 28)."""

    entity: str
    label: str
    colour: str
    values: Callable[[Samples], Samples]


def channel(name: str, scale: float = 1.0) -> Callable[[Samples], Samples]:
    """One column, scaled."""
    column = COLUMN[name]
    return lambda samples: samples[:, column] * scale


def magnitude(name: str) -> Callable[[Samples], Samples]:
    """Length of the vector whose components are the columns ``name``_x and _y."""
    x, y = COLUMN[f"{name}_x"], COLUMN[f"{name}_y"]
    return lambda samples: np.hypot(samples[:, x], samples[:, y])


def series() -> list[Series]:
    """All curves, in the order of the views."""
    curves = [
        Series("mesh/dte", "DTE (µm)", palette.BLUE, channel("dte", MICRO)),
        Series("mesh/force", "mesh force (N)", palette.ORANGE, channel("mesh_force")),
        Series(
            "mesh/pressure_angle", "pressure angle (°)", palette.GREEN, channel("pressure_angle", DEGREES)
        ),
        Series("mesh/state", "flank", palette.GREY, channel("meshing_state")),
        Series("shaft/speed/driving", "driving (rad/s)", palette.BLUE, channel("driving_speed")),
        Series("shaft/speed/driven", "driven (rad/s)", palette.ORANGE, channel("driven_speed")),
        Series("shaft/torque/drive", "drive (N m)", palette.BLUE, channel("drive_torque")),
        Series("shaft/torque/load", "load (N m)", palette.ORANGE, channel("load_torque")),
    ]
    for gear in blueprint.JOURNALS:
        entity = f"bearing/{gear}"
        curves += [
            Series(f"{entity}/contact", "contact (N)", palette.BLUE, magnitude(f"{gear}_contact_force")),
            Series(f"{entity}/film", "oil film (N)", palette.SKY, magnitude(f"{gear}_film_force")),
        ]
    return curves


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of #RRGGBB, 0 to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def circle(radius: float) -> Samples:
    """Closed line, shape (CIRCLE_POINTS, 2)."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def upward(x: Samples, y: Samples) -> Samples:
    """Points with y upward in Rerun's plane, whose own y points down; shape (n, 2)."""
    return np.column_stack([x, -y])


class Scene:
    """Draws into one stream; not to be shared between threads."""

    def __init__(self, stream: rr.RecordingStream, parameters: Parameters) -> None:
        gears, mesh, bearings = parameters.gears, parameters.mesh, parameters.bearings
        self._stream = stream
        self._series = series()
        self._interval = parameters.solver.sample_interval
        self._width = max(1, round(POINT_INTERVAL / self._interval))
        self._span = max(2, round(PICTURE_SPAN / self._interval))
        self._spacing = max(1, round(PICTURE_INTERVAL / self._interval))
        self._clearances = {
            "driving": bearings.driving.clearance * MICRO,
            "driven": bearings.driven.clearance * MICRO,
        }
        self._oil_clearances = {
            "driving": bearings.driving.oil_clearance * MICRO,
            "driven": bearings.driven.oil_clearance * MICRO,
        }
        self._film = parameters.model == "improved"
        # Half backlash and the torsional mesh mode make both axes of the phase portrait of order one.
        r1, r2 = base_radii(parameters)
        mode = np.sqrt(mesh.stiffness * (r1**2 / gears.driving.inertia + r2**2 / gears.driven.inertia))
        self._dte_scale = max(gears.backlash / 2.0, 1e-6)
        self._rate_scale = self._dte_scale * mode

    def layout(self) -> rr.blueprint.Blueprint:
        """The views that fit this run."""
        return blueprint.layout(self._clearances)

    def draw_fixed(self) -> None:
        """Everything that holds for the whole run: names and colours of curves, circles, axes."""
        for curve in self._series:
            style = rr.SeriesLines(
                colors=rgb(curve.colour), names=curve.label, widths=1.2, aggregation_policy="MinMax"
            )
            self._stream.log(curve.entity, style, static=True)
        for journal in blueprint.JOURNALS:
            self._draw_bearing(journal)
        self._draw_portrait_frame()
        self._draw_strobe_frame()

    def draw(self, samples: Samples) -> None:
        """Contiguous samples, shape (n, 28)."""
        for curve in self._series:
            values = curve.values(samples)
            kept = extremes(values, self._width)
            self._stream.send_columns(
                curve.entity,
                indexes=[self._times(samples[kept])],
                columns=rr.Scalars.columns(scalars=values[kept]),
                strict=True,
            )
        ends = np.arange(len(samples), 0, -self._spacing)[::-1]
        pictures = [samples[max(0, end - self._span) : end] for end in ends]
        self._draw_pictures(self._times(samples[ends - 1]), pictures)

    @staticmethod
    def _times(samples: Samples) -> rr.TimeColumn:
        return rr.TimeColumn(blueprint.TIMELINE, duration=samples[:, COLUMN["time"]])

    def _draw_pictures(self, times: rr.TimeColumn, pictures: list[Samples]) -> None:
        for journal in blueprint.JOURNALS:
            x, y = COLUMN[f"{journal}_x"], COLUMN[f"{journal}_y"]
            self._trail(blueprint.orbit(journal), times, [upward(p[:, x], p[:, y]) * MICRO for p in pictures])
        x, y, phase = COLUMN["dte"], COLUMN["dte_rate"], COLUMN["mesh_phase"]
        self._trail(
            blueprint.PHASE_PORTRAIT,
            times,
            [upward(p[:, x] / self._dte_scale, p[:, y] / self._rate_scale) for p in pictures],
        )
        width = blueprint.STROBE_SIZE[0] / (2.0 * np.pi)
        folded = [upward(p[:, phase] * width, p[:, x] / self._dte_scale) for p in pictures]
        self._stream.send_columns(
            f"{blueprint.STROBE}/samples",
            indexes=[times],
            columns=rr.Points2D.columns(positions=np.concatenate(folded)).partition([len(p) for p in folded]),
            strict=True,
        )

    def _trail(self, entity: str, times: rr.TimeColumn, lines: list[Samples]) -> None:
        self._stream.send_columns(
            f"{entity}/path", indexes=[times], columns=rr.LineStrips2D.columns(strips=lines), strict=True
        )
        self._stream.send_columns(
            f"{entity}/now",
            indexes=[times],
            columns=rr.Points2D.columns(positions=np.array([line[-1] for line in lines])),
            strict=True,
        )

    def _fixed(self, entity: str, shape: rr.LineStrips2D | rr.Points2D) -> None:
        self._stream.log(entity, shape, static=True)

    def _text(self, entity: str, texts: dict[str, tuple[float, float]], colour: str) -> None:
        positions = [(x, -y) for x, y in texts.values()]
        self._fixed(
            entity,
            rr.Points2D(positions, labels=list(texts), show_labels=True, radii=TEXT_ONLY, colors=rgb(colour)),
        )

    def _trail_style(self, entity: str) -> None:
        self._fixed(f"{entity}/path", rr.LineStrips2D.from_fields(colors=rgb(palette.SKY), radii=LINE))
        self._fixed(f"{entity}/now", rr.Points2D.from_fields(colors=rgb(palette.YELLOW), radii=MARK))

    def _draw_bearing(self, journal: str) -> None:
        entity = blueprint.orbit(journal)
        clearance, oil = self._clearances[journal], self._oil_clearances[journal]
        circles = [circle(clearance), *([circle(oil)] if self._film else [])]
        colours = [palette.ORANGE, *([palette.GREEN] if self._film else [])]
        self._fixed(
            f"{entity}/circles",
            rr.LineStrips2D(circles, colors=[rgb(colour) for colour in colours], radii=FRAME),
        )
        cross = [[(-clearance, 0.0), (clearance, 0.0)], [(0.0, -clearance), (0.0, clearance)]]
        self._fixed(f"{entity}/cross", rr.LineStrips2D(cross, colors=rgb(palette.DIM), radii=FRAME))
        text = {f"bearing clearance {clearance:g} µm": (0.0, 1.25 * clearance)}
        self._text(f"{entity}/clearance", text, palette.ORANGE)
        if self._film:
            text = {f"oil clearance {oil:g} µm": (0.0, 1.03 * oil)}
            self._text(f"{entity}/oil_clearance", text, palette.GREEN)
        self._trail_style(entity)

    def _draw_portrait_frame(self) -> None:
        across, up = (0.9 * half for half in blueprint.PORTRAIT_HALF_SIZE)
        axes = [[(-across, 0.0), (across, 0.0)], [(0.0, -up), (0.0, up)]]
        flanks = [[(side, -up), (side, up)] for side in (-1.0, 1.0)]
        self._fixed(
            f"{blueprint.PHASE_PORTRAIT}/axes",
            rr.LineStrips2D(
                axes + flanks, colors=[rgb(palette.DIM)] * 2 + [rgb(palette.ORANGE)] * 2, radii=FRAME
            ),
        )
        self._text(
            f"{blueprint.PHASE_PORTRAIT}/labels",
            {
                f"back flank -{self._dte_scale * MICRO:g} µm": (-1.0, up),
                f"drive flank {self._dte_scale * MICRO:g} µm": (1.0, up),
                "DTE / half backlash →": (-0.55 * across, -0.15),
                f"DTE rate / {self._rate_scale:.3g} m/s ↑": (0.0, -up),
            },
            palette.GREY,
        )
        self._trail_style(blueprint.PHASE_PORTRAIT)

    def _draw_strobe_frame(self) -> None:
        width, height = blueprint.STROBE_SIZE
        bottom = blueprint.STROBE_BOTTOM / 2.0
        sides = [[(x, -bottom), (x, -height)] for x in (0.0, width)]
        self._fixed(
            f"{blueprint.STROBE}/axes",
            rr.LineStrips2D(
                [[(0.0, 0.0), (width, 0.0)], *sides, [(0.0, -1.0), (width, -1.0)]],
                colors=[rgb(palette.DIM)] * 3 + [rgb(palette.ORANGE)],
                radii=FRAME,
            ),
        )
        self._text(
            f"{blueprint.STROBE}/labels",
            {
                "phase 0": (0.0, bottom),
                "2π": (width, bottom),
                "half backlash": (width / 2.0, 1.0),
                "DTE / half backlash ↑": (width / 2.0, height),
            },
            palette.GREY,
        )
        self._fixed(
            f"{blueprint.STROBE}/samples", rr.Points2D.from_fields(colors=rgb(palette.SKY), radii=DOT)
        )
