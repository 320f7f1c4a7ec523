"""Draws contiguous samples as Rerun's time series, orbits and phase portrait.

Time series have the minimum and the maximum of every POINT_INTERVAL at their own times, which keeps all
peaks: 2000 points per second and channel; the full waveform is in the recording. Orbits and phase plots show
the last PICTURE_SPAN at the full rate, every PICTURE_INTERVAL. 10 s of a run take some 20 MB.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.geometry import base_radii
from gear_dynamics_ros.viewer import blueprint
from gear_dynamics_ros.viewer.decimation import extreme_indices

POINT_INTERVAL: Final = 1.0e-3  # s of simulated time
PICTURE_INTERVAL: Final = 0.04  # s
PICTURE_SPAN: Final = 0.01  # s
MICROMETRES: Final = 1.0e6
DEGREES: Final = 180.0 / np.pi
CIRCLE_POINTS: Final = 181
LINE_WIDTH: Final = rr.Radius.ui_points(0.7)
MARK_SIZE: Final = rr.Radius.ui_points(5.0)
DOT_SIZE: Final = rr.Radius.ui_points(1.3)
FRAME_WIDTH: Final = rr.Radius.ui_points(1.0)
NO_MARK: Final = rr.Radius.ui_points(0.0)

SampleRows = NDArray[np.float64]


class PlottedSeries(NamedTuple):
    """One curve: its entity, label and colour, and what computes its values (n,) from samples (n, 28)."""

    entity: str
    label: str
    colour: str
    values: Callable[[SampleRows], SampleRows]


def scaled_channel(name: str, scale: float = 1.0) -> Callable[[SampleRows], SampleRows]:
    """What gives the column ``name`` of samples (n, 28), times ``scale``."""
    column = COLUMN[name]
    return lambda samples: samples[:, column] * scale


def vector_magnitude(name: str) -> Callable[[SampleRows], SampleRows]:
    """What gives the magnitude of the vector with the components ``name``_x and ``name``_y."""
    x, y = COLUMN[f"{name}_x"], COLUMN[f"{name}_y"]
    # np.hypot, which can't overflow, takes several times as long.
    return lambda samples: np.sqrt(samples[:, x] * samples[:, x] + samples[:, y] * samples[:, y])


def plotted_series() -> list[PlottedSeries]:
    """All curves of the time series views."""
    curves = [
        PlottedSeries("mesh/dte", "DTE (µm)", palette.BLUE, scaled_channel("dte", MICROMETRES)),
        PlottedSeries("mesh/force", "mesh force (N)", palette.ORANGE, scaled_channel("mesh_force")),
        PlottedSeries(
            "mesh/pressure_angle",
            "pressure angle (°)",
            palette.GREEN,
            scaled_channel("pressure_angle", DEGREES),
        ),
        PlottedSeries("mesh/state", "flank", palette.GREY, scaled_channel("meshing_state")),
        PlottedSeries(
            "shaft/speed/driving", "driving (rad/s)", palette.BLUE, scaled_channel("driving_speed")
        ),
        PlottedSeries("shaft/speed/driven", "driven (rad/s)", palette.ORANGE, scaled_channel("driven_speed")),
        PlottedSeries("shaft/torque/drive", "drive (N m)", palette.BLUE, scaled_channel("drive_torque")),
        PlottedSeries("shaft/torque/load", "load (N m)", palette.ORANGE, scaled_channel("load_torque")),
    ]
    for gear in blueprint.JOURNALS:
        entity = f"bearing/{gear}"
        curves += [
            PlottedSeries(
                f"{entity}/contact", "contact (N)", palette.BLUE, vector_magnitude(f"{gear}_contact_force")
            ),
            PlottedSeries(
                f"{entity}/film", "oil film (N)", palette.SKY, vector_magnitude(f"{gear}_film_force")
            ),
        ]
    return curves


def rgb_values(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour #RRGGBB."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def circle_line(radius: float) -> SampleRows:
    """Closed line about the origin, shape (CIRCLE_POINTS, 2), in the unit of ``radius``."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def upward_points(x: SampleRows, y: SampleRows) -> SampleRows:
    """Points with y upward_points in Rerun's plane, whose own y points down; shape (n, 2)."""
    return np.column_stack([x, -y])


class Scene:
    """Draws a run into one Rerun stream; for one thread."""

    def __init__(self, stream: rr.RecordingStream, parameters: Parameters) -> None:
        gears, mesh, bearings = parameters.gears, parameters.mesh, parameters.bearings
        self._stream = stream
        self._series = plotted_series()
        self._interval = parameters.solver.sample_interval
        self._width = max(1, round(POINT_INTERVAL / self._interval))
        self._span = max(2, round(PICTURE_SPAN / self._interval))
        self._spacing = max(1, round(PICTURE_INTERVAL / self._interval))
        self._clearances = {
            "driving": bearings.driving.clearance * MICROMETRES,
            "driven": bearings.driven.clearance * MICROMETRES,
        }
        self._oil_clearances = {
            "driving": bearings.driving.oil_clearance * MICROMETRES,
            "driven": bearings.driven.oil_clearance * MICROMETRES,
        }
        self._film = parameters.model == "improved"
        # Scaled by half the backlash and the torsional mesh frequency, the phase portrait is of order 1.
        r1, r2 = base_radii(parameters)
        mode = np.sqrt(mesh.stiffness * (r1**2 / gears.driving.inertia + r2**2 / gears.driven.inertia))
        self._dte_scale = max(gears.backlash / 2.0, 1e-6)
        self._rate_scale = self._dte_scale * mode

    def layout(self) -> rr.blueprint.Blueprint:
        """The views, scaled to the clearances of this run."""
        return blueprint.layout(self._clearances)

    def draw_fixed(self) -> None:
        """Draw what stays for the whole run: names and colours of curves, circles, axes."""
        for curve in self._series:
            style = rr.SeriesLines(
                colors=rgb_values(curve.colour), names=curve.label, widths=1.2, aggregation_policy="MinMax"
            )
            self._stream.log(curve.entity, style, static=True)
        for journal in blueprint.JOURNALS:
            self._draw_bearing(journal)
        self._draw_portrait_frame()
        self._draw_strobe_frame()

    def draw(self, samples: SampleRows) -> None:
        """Draw contiguous samples, shape (n, 28), n > 0."""
        for curve in self._series:
            values = curve.values(samples)
            kept = extreme_indices(values, self._width)
            self._stream.send_columns(
                curve.entity,
                indexes=[self._time_column(samples[kept])],
                columns=rr.Scalars.columns(scalars=values[kept]),
                strict=True,
            )
        ends = np.arange(len(samples), 0, -self._spacing)[::-1]
        pictures = [samples[max(0, end - self._span) : end] for end in ends]
        self._draw_pictures(self._time_column(samples[ends - 1]), pictures)

    @staticmethod
    def _time_column(samples: SampleRows) -> rr.TimeColumn:
        return rr.TimeColumn(blueprint.TIMELINE, duration=samples[:, COLUMN["time"]])

    def _draw_pictures(self, times: rr.TimeColumn, pictures: list[SampleRows]) -> None:
        for journal in blueprint.JOURNALS:
            x, y = COLUMN[f"{journal}_x"], COLUMN[f"{journal}_y"]
            self._draw_trail(
                blueprint.orbit_entity(journal),
                times,
                [upward_points(p[:, x], p[:, y]) * MICROMETRES for p in pictures],
            )
        x, y, phase = COLUMN["dte"], COLUMN["dte_rate"], COLUMN["mesh_phase"]
        self._draw_trail(
            blueprint.PHASE_PORTRAIT,
            times,
            [upward_points(p[:, x] / self._dte_scale, p[:, y] / self._rate_scale) for p in pictures],
        )
        width = blueprint.STROBE_SIZE[0] / (2.0 * np.pi)
        folded = [upward_points(p[:, phase] * width, p[:, x] / self._dte_scale) for p in pictures]
        self._stream.send_columns(
            f"{blueprint.STROBE}/samples",
            indexes=[times],
            columns=rr.Points2D.columns(positions=np.concatenate(folded)).partition([len(p) for p in folded]),
            strict=True,
        )

    def _draw_trail(self, entity: str, times: rr.TimeColumn, lines: list[SampleRows]) -> None:
        self._stream.send_columns(
            f"{entity}/path", indexes=[times], columns=rr.LineStrips2D.columns(strips=lines), strict=True
        )
        self._stream.send_columns(
            f"{entity}/now",
            indexes=[times],
            columns=rr.Points2D.columns(positions=np.array([line[-1] for line in lines])),
            strict=True,
        )

    def _log_static(self, entity: str, shape: rr.LineStrips2D | rr.Points2D) -> None:
        self._stream.log(entity, shape, static=True)

    def _draw_text(self, entity: str, texts: dict[str, tuple[float, float]], colour: str) -> None:
        positions = [(x, -y) for x, y in texts.values()]
        self._log_static(
            entity,
            rr.Points2D(
                positions, labels=list(texts), show_labels=True, radii=NO_MARK, colors=rgb_values(colour)
            ),
        )

    def _style_trail(self, entity: str) -> None:
        self._log_static(
            f"{entity}/path", rr.LineStrips2D.from_fields(colors=rgb_values(palette.SKY), radii=LINE_WIDTH)
        )
        self._log_static(
            f"{entity}/now", rr.Points2D.from_fields(colors=rgb_values(palette.YELLOW), radii=MARK_SIZE)
        )

    def _draw_bearing(self, journal: str) -> None:
        entity = blueprint.orbit_entity(journal)
        clearance, oil = self._clearances[journal], self._oil_clearances[journal]
        circles = [circle_line(clearance), *([circle_line(oil)] if self._film else [])]
        colours = [palette.ORANGE, *([palette.GREEN] if self._film else [])]
        self._log_static(
            f"{entity}/circles",
            rr.LineStrips2D(circles, colors=[rgb_values(colour) for colour in colours], radii=FRAME_WIDTH),
        )
        cross = [[(-clearance, 0.0), (clearance, 0.0)], [(0.0, -clearance), (0.0, clearance)]]
        self._log_static(
            f"{entity}/cross", rr.LineStrips2D(cross, colors=rgb_values(palette.DIM), radii=FRAME_WIDTH)
        )
        text = {f"bearing clearance {clearance:g} µm": (0.0, 1.25 * clearance)}
        self._draw_text(f"{entity}/clearance", text, palette.ORANGE)
        if self._film:
            text = {f"oil clearance {oil:g} µm": (0.0, 1.03 * oil)}
            self._draw_text(f"{entity}/oil_clearance", text, palette.GREEN)
        self._style_trail(entity)

    def _draw_portrait_frame(self) -> None:
        across, up = (0.9 * half for half in blueprint.PORTRAIT_HALF_SIZE)
        axes = [[(-across, 0.0), (across, 0.0)], [(0.0, -up), (0.0, up)]]
        flanks = [[(side, -up), (side, up)] for side in (-1.0, 1.0)]
        self._log_static(
            f"{blueprint.PHASE_PORTRAIT}/axes",
            rr.LineStrips2D(
                axes + flanks,
                colors=[rgb_values(palette.DIM)] * 2 + [rgb_values(palette.ORANGE)] * 2,
                radii=FRAME_WIDTH,
            ),
        )
        self._draw_text(
            f"{blueprint.PHASE_PORTRAIT}/labels",
            {
                f"back flank -{self._dte_scale * MICROMETRES:g} µm": (-1.0, up),
                f"drive flank {self._dte_scale * MICROMETRES:g} µm": (1.0, up),
                "DTE / half backlash →": (-0.55 * across, -0.15),
                f"DTE rate / {self._rate_scale:.3g} m/s ↑": (0.0, -up),
            },
            palette.GREY,
        )
        self._style_trail(blueprint.PHASE_PORTRAIT)

    def _draw_strobe_frame(self) -> None:
        width, height = blueprint.STROBE_SIZE
        bottom = blueprint.STROBE_BOTTOM / 2.0
        sides = [[(x, -bottom), (x, -height)] for x in (0.0, width)]
        self._log_static(
            f"{blueprint.STROBE}/axes",
            rr.LineStrips2D(
                [[(0.0, 0.0), (width, 0.0)], *sides, [(0.0, -1.0), (width, -1.0)]],
                colors=[rgb_values(palette.DIM)] * 3 + [rgb_values(palette.ORANGE)],
                radii=FRAME_WIDTH,
            ),
        )
        self._draw_text(
            f"{blueprint.STROBE}/labels",
            {
                "phase 0": (0.0, bottom),
                "2π": (width, bottom),
                "half backlash": (width / 2.0, 1.0),
                "DTE / half backlash ↑": (width / 2.0, height),
            },
            palette.GREY,
        )
        self._log_static(
            f"{blueprint.STROBE}/samples",
            rr.Points2D.from_fields(colors=rgb_values(palette.SKY), radii=DOT_SIZE),
        )
