"""The viewer's layout: which entity is shown in which view. No data."""

from __future__ import annotations

from typing import Final

import rerun.blueprint as rrb

TIMELINE: Final = "sim_time"

STATE_VIEW: Final = "mesh/state"
MESH_VIEWS: Final = {
    "Dynamic transmission error (µm)": "mesh/dte",
    "Mesh force (N)": "mesh/force",
    "Pressure angle (°)": "mesh/pressure_angle",
    "Meshing state: 1 drive flank, 0 apart, -1 back flank": STATE_VIEW,
}
SHAFT_VIEWS: Final = {
    "Bearing force, driving gear (N)": "bearing/driving",
    "Bearing force, driven gear (N)": "bearing/driven",
    "Shaft speeds (rad/s)": "shaft/speed",
    "Shaft torques (N m)": "shaft/torque",
}
PHASE_PORTRAIT: Final = "phase/portrait"
STROBE: Final = "phase/strobe"
JOURNALS: Final = ("driving", "driven")

PORTRAIT_HALF_SIZE: Final = (2.4, 1.8)
STROBE_SIZE: Final = (3.0, 2.0)
STROBE_BOTTOM: Final = -0.4
ORBIT_MARGIN: Final = 1.45


def orbit_entity(journal: str) -> str:
    """Name of the entity of one journal's orbit."""
    return f"orbit/{journal}"


def time_series_views(views: dict[str, str], legend: bool) -> rrb.Container:
    """``views`` (entity by title) on top of each other, each with its own value axis."""
    return rrb.Vertical(
        *(
            rrb.TimeSeriesView(
                name=name,
                origin=origin,
                plot_legend=rrb.PlotLegend(visible=legend),
                axis_y=rrb.ScalarAxis(range=(-1.2, 1.2)) if origin == STATE_VIEW else None,
            )
            for name, origin in views.items()
        )
    )


def plane_view(name: str, origin: str, x: tuple[float, float], y: tuple[float, float]) -> rrb.Spatial2DView:
    """View of a plane in the ranges ``x`` and ``y`` with y upward.

    Rerun's y axis points down, so the data must have y negated.
    """
    return rrb.Spatial2DView(
        name=name,
        origin=origin,
        visual_bounds=rrb.VisualBounds2D(x_range=x, y_range=(-y[1], -y[0])),
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=(16, 18, 22)),
    )


def orbit_view(journal: str, clearance: float) -> rrb.Spatial2DView:
    """View of a journal's orbit in um; ``clearance`` is the bearing's radial clearance in um."""
    half = ORBIT_MARGIN * clearance
    return plane_view(
        f"Journal orbit, {journal} gear (µm)", orbit_entity(journal), (-half, half), (-half, half)
    )


def layout(clearances: dict[str, float]) -> rrb.Blueprint:
    """The whole window; ``clearances`` are the bearings' radial clearances in um by journal."""
    across, up = PORTRAIT_HALF_SIZE
    return rrb.Blueprint(
        rrb.Horizontal(
            time_series_views(MESH_VIEWS, legend=False),
            time_series_views(SHAFT_VIEWS, legend=True),
            rrb.Grid(
                *(orbit_view(journal, clearances[journal]) for journal in JOURNALS),
                plane_view("Phase portrait (normalised)", PHASE_PORTRAIT, (-across, across), (-up, up)),
                plane_view(
                    "DTE over one mesh period (normalised)",
                    STROBE,
                    (-0.5, STROBE_SIZE[0] + 0.2),
                    (STROBE_BOTTOM, STROBE_SIZE[1] + 0.1),
                ),
                grid_columns=2,
            ),
            column_shares=[3, 3, 5],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )
