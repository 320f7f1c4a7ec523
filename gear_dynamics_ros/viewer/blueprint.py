"""Layouts of the viewer: which entity is shown in which view. No data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, NamedTuple

import rerun.blueprint as rrb

from gear_dynamics_ros.channels import GEARS
from gear_dynamics_ros.viewer.entities import (
    ABOUT_RUN,
    ABOUT_VIEW,
    COMMAND,
    ENERGY,
    EVENTS,
    IMPACT,
    MESHING,
    MOMENTS,
    ORDERS,
    PHASE_PORTRAIT,
    REAL_TIME_FACTOR,
    RUN_TIMELINE,
    SCENE,
    SLOW_TIMELINE,
    channel_entity,
    orbit_entity,
)

BACKGROUND: Final = rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=(16, 18, 22))
PORTRAIT_HALF: Final = complex(2.6, 2.0)  # of the phase portrait
ORBIT_MARGIN: Final = 1.3
FILM_MARGIN: Final = 1.15

Corners = tuple[complex, complex]


class Views(NamedTuple):
    """What the layouts need to know of a run; corners are lower left and upper right, in a picture's unit."""

    scene: Corners
    close_up: Corners
    still: Corners
    clearances: Mapping[str, float]  # µm, by gear
    film_clearances: Mapping[str, float]  # µm, by gear; empty without film
    spectrum: Corners


class Playback(NamedTuple):
    """Which timeline is shown when the viewer opens, and whether it moves."""

    timeline: str
    state: Literal["following", "playing"]


LIVE: Final = Playback(RUN_TIMELINE, "following")
SLOW_MOTION: Final = Playback(SLOW_TIMELINE, "playing")


def overview_layout(views: Views, playback: Playback) -> rrb.Blueprint:
    """What the run was, and the moments in which contact is lost: for one who sees it for the first time."""
    return _window(
        rrb.Horizontal(
            rrb.Vertical(
                _scene(views),
                rrb.Horizontal(*(_moment(views, *moment) for moment in MOMENT_VIEWS)),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                _close_up(views),
                _curves("DTE between the flanks (µm)", DTE_CURVES),
                _states(),
                _curves("Mesh force (N)", ["mesh_force"]),
                row_shares=[5, 3, 1.3, 2],
            ),
            rrb.Vertical(
                rrb.TextDocumentView(origin=ABOUT_VIEW, name="What you see"),
                rrb.TextDocumentView(origin=ABOUT_RUN, name="The run"),
            ),
            column_shares=[5, 4, 3],
        ),
        playback,
    )


def operator_layout(views: Views, playback: Playback) -> rrb.Blueprint:
    """What is commanded and what the gears do."""
    return _window(
        rrb.Horizontal(
            rrb.Vertical(
                _scene(views),
                rrb.Horizontal(
                    _close_up(views),
                    rrb.TextDocumentView(origin=ABOUT_VIEW, name="What you see"),
                ),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                _curves("Speeds (rad/s)", SPEEDS, [f"{COMMAND}/speed"]),
                _curves("Torques (N m)", TORQUES, [f"{COMMAND}/drive_torque", f"{COMMAND}/load_torque"]),
                _curves("DTE between the flanks (µm)", DTE_CURVES),
                _states(),
                _curves("Mesh force (N)", ["mesh_force"]),
                _curves("Bearing forces (N)", [f"{gear}_bearing_force" for gear in GEARS]),
                row_shares=[2, 2, 3, 1.2, 2, 2],
            ),
            rrb.Vertical(
                _real_time_factor(),
                rrb.TimeSeriesView(origin=IMPACT, name="Impacts: closing speed (m/s)", plot_legend=LEGEND),
                _events(),
            ),
            column_shares=[5, 5, 3],
        ),
        playback,
    )


def dynamics_layout(views: Views, playback: Playback) -> rrb.Blueprint:
    """Transmission error, forces, phase portrait, spectrum and energies."""
    half = PORTRAIT_HALF
    return _window(
        rrb.Horizontal(
            rrb.Vertical(
                _curves("DTE between the flanks (µm)", DTE_CURVES),
                _states(),
                _curves("Mesh force (N)", ["mesh_force"]),
                _curves("Pressure angle (°)", ["pressure_angle"]),
                row_shares=[4, 1.3, 3, 2],
            ),
            rrb.Vertical(
                _curves("Speeds (rad/s)", SPEEDS, [f"{COMMAND}/speed"]),
                _curves("Torques (N m)", TORQUES, [f"{COMMAND}/drive_torque", f"{COMMAND}/load_torque"]),
                rrb.TimeSeriesView(origin=ENERGY, name="Energy balance (J)", plot_legend=LEGEND),
                _real_time_factor(),
                _events(),
                row_shares=[3, 3, 4, 2, 2],
            ),
            rrb.Vertical(
                _plane("Phase portrait, Poincaré points (normalised)", PHASE_PORTRAIT, (-half, half)),
                _plane("Spectrum of DTE over mesh orders", ORDERS, views.spectrum),
                _close_up(views),
            ),
            column_shares=[4, 4, 3],
        ),
        playback,
    )


def bearing_layout(views: Views, playback: Playback) -> rrb.Blueprint:
    """Orbits, forces, penetration and impacts of both bearings."""
    columns = [
        rrb.Vertical(
            _plane(
                f"Journal orbit in the clearance, {gear} gear (µm)",
                orbit_entity(gear),
                _square(ORBIT_MARGIN * views.clearances[gear]),
            ),
            *(
                [
                    _plane(
                        f"Clearance in the film, {gear} gear (µm)",
                        orbit_entity(gear),
                        _square(FILM_MARGIN * views.film_clearances[gear]),
                    )
                ]
                if views.film_clearances
                else []
            ),
        )
        for gear in GEARS
    ]
    forces = [
        _curves(f"Bearing force, {gear} gear (N)", [f"{gear}_{kind}" for kind in FORCES]) for gear in GEARS
    ]
    return _window(
        rrb.Horizontal(
            *columns,
            rrb.Vertical(
                *forces,
                _curves("Penetration, negative = gap left (µm)", [f"{gear}_penetration" for gear in GEARS]),
                rrb.TimeSeriesView(origin=IMPACT, name="Impacts: closing speed (m/s)", plot_legend=LEGEND),
                _events(),
                row_shares=[3, 3, 2, 2, 1],
            ),
            column_shares=[3, 3, 4],
        ),
        playback,
    )


LAYOUTS: Final[dict[str, Callable[[Views, Playback], rrb.Blueprint]]] = {
    "overview": overview_layout,
    "operator": operator_layout,
    "dynamics": dynamics_layout,
    "bearings": bearing_layout,
}

DTE_CURVES: Final = ("dte", "half_backlash", "minus_half_backlash")
SPEEDS: Final = ("driving_speed", "driven_speed")
TORQUES: Final = ("drive_torque", "load_torque")
FORCES: Final = ("contact_force", "film_force", "bearing_force")
MOMENT_VIEWS: Final = (
    ("drive", "Drive flanks carry"),
    ("apart", "Contact lost"),
    ("back", "Back flanks strike"),
)
LEGEND: Final = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
NO_LEGEND: Final = rrb.PlotLegend(visible=False)


def _window(content: rrb.Container, playback: Playback) -> rrb.Blueprint:
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=playback.timeline,
            play_state=playback.state,
            loop_mode="all" if playback.timeline == SLOW_TIMELINE else "off",
        ),
        auto_views=False,
        auto_layout=False,
    )


def _plane(name: str, origin: str, corners: Corners, contents: Sequence[str] = ("$origin/**",)) -> rrb.View:
    """View of a plane with y upward: the data has y negated, as Rerun's y axis points down."""
    low, high = corners
    return rrb.Spatial2DView(
        name=name,
        origin=origin,
        contents=list(contents),
        visual_bounds=rrb.VisualBounds2D(x_range=(low.real, high.real), y_range=(-high.imag, -low.imag)),
        background=BACKGROUND,
    )


def _square(half: float) -> Corners:
    return complex(-half, -half), complex(half, half)


def _scene(views: Views) -> rrb.View:
    hidden = [f"{SCENE}/{name}" for name in ("close_up_status", "close_up_mesh_force", "gap")]
    contents = ["$origin/**", *(f"- {entity}" for entity in hidden)]
    return _plane("Gears: driving left, driven right (mm)", SCENE, views.scene, contents)


def _close_up(views: Views) -> rrb.View:
    shown = ("teeth", "flanks", "line_of_action", "gap", "close_up_mesh_force", "close_up_status")
    contents = [f"+ $origin/{name}" for name in shown]
    return _plane("Teeth in mesh (mm)", SCENE, views.close_up, contents)


def _moment(views: Views, name: str, title: str) -> rrb.View:
    return _plane(title, f"{MOMENTS}/{name}", views.still)


def _curves(name: str, channels: Sequence[str], others: Sequence[str] = ()) -> rrb.View:
    contents = [f"+ /{channel_entity(channel)}" for channel in channels] + [
        f"+ /{entity}" for entity in others
    ]
    return rrb.TimeSeriesView(
        origin="/", contents=contents, name=name, plot_legend=LEGEND if len(contents) > 1 else NO_LEGEND
    )


def _states() -> rrb.View:
    return rrb.StateTimelineView(origin=MESHING, name="Meshing state")


def _real_time_factor() -> rrb.View:
    return rrb.TimeSeriesView(origin=REAL_TIME_FACTOR, name="Real-time factor", plot_legend=NO_LEGEND)


def _events() -> rrb.View:
    return rrb.TextLogView(origin=EVENTS, name="Operator events")
