"""The report of a recording: one HTML page with everything in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.analysis.statistics import Envelope
from gear_dynamics_ros.recording import Recording
from gear_dynamics_ros.reporting.history import MOST_ROWS, command_changes, draw_history, event_rows
from gear_dynamics_ros.reporting.parameter_rows import changed_rows, key_rows, switch_rows
from gear_dynamics_ros.reporting.rendering import render_page
from gear_dynamics_ros.reporting.sankey import Sankey, draw_sankey
from gear_dynamics_ros.reporting.windows import ASKED, LAST, STEADY, AnalysisWindow

TEMPLATE: Final = "recording.html.j2"
TALL: Final = ("orbits",)  # figures that fill a page alone: last, so that the others share pages
RUN: Final = 0  # instead of the number of a window: the whole run
KINDS: Final = {
    STEADY: "steady: no change of commands in it or shortly before it",
    ASKED: "as asked for with --from and --to",
    LAST: "the end of the recording, which has no steady window",
}
ENERGY_LABELS: Final = {
    "shaft_work": ("work of the shafts: drive less load", "work given to the shafts: load less drive"),
    "excitation_work": ("excitation of the mesh", "given back to the excitation"),
    "driving_film_work": ("oil film drives the driving journal", "oil film of the driving bearing"),
    "driven_film_work": ("oil film drives the driven journal", "oil film of the driven bearing"),
    "kinetic_energy": ("gears slowed down", "gears sped up"),
    "elastic_energy": ("elastic energy released", "stored in teeth and contacts"),
    "mesh_loss": ("", "damping of the teeth"),
    "driving_contact_loss": ("", "contact in the driving bearing"),
    "driven_contact_loss": ("", "contact in the driven bearing"),
    "residual": ("not accounted for", "not accounted for"),
}


# Rows of the table of the condition: label, unit, place in the summary of the run or of a window.
CONDITION: Final = (
    ("mean speed of the driving gear", "rad/s", "channels.driving_speed.mean"),
    ("mean load torque", "N m", "channels.load_torque.mean"),
    ("static mesh force", "N", "static_mesh_force"),
    ("greatest mesh force", "N", "channels.mesh_force.max"),
    ("LDMF", "", "ldmf"),
    ("drive flank in contact", "%", "meshing_time.drive"),
    ("no contact", "%", "meshing_time.apart"),
    ("back flank in contact", "%", "meshing_time.back"),
    ("DTE, RMS", "m", "channels.dte.rms"),
    ("DTE, least", "m", "channels.dte.min"),
    ("DTE, greatest", "m", "channels.dte.max"),
    ("driving bearing, mean force", "N", "mean_bearing_force.driving"),
    ("driving bearing, greatest penetration", "m", "max_penetration.driving"),
    ("driven bearing, mean force", "N", "mean_bearing_force.driven"),
    ("driven bearing, greatest penetration", "m", "max_penetration.driven"),
)
WINDOW_CONDITION: Final = (
    ("mesh frequency", "Hz", "mesh_frequency"),
    ("spread of the Poincaré section, DTE", "m", "poincare.dte_spread"),
    ("impacts of the driving bearing", "", "impacts.driving.count"),
    ("impacts of the driven bearing", "", "impacts.driven.count"),
)


class ConditionCell(NamedTuple):
    """A number of the summary; without ``path`` the run has none."""

    path: str = ""
    value: float | None = None


class ConditionRow(NamedTuple):
    """One quantity: of the run, then of each window."""

    label: str
    unit: str
    cells: Sequence[ConditionCell]


class EmbeddedFigure(NamedTuple):
    """One figure of the report, and the file that it is in beside it."""

    name: str
    window: int  # number, or RUN
    file: str
    caption: str
    png: bytes


class EnergyRow(NamedTuple):
    """One energy of one side of the balance, J."""

    name: str
    label: str
    energy: float


def recording_page(
    recording: Recording,
    envelope: Envelope,
    windows: Sequence[AnalysisWindow],
    content: Mapping[str, Any],
    figures: Sequence[EmbeddedFigure],
    left_out: Mapping[str, str],
) -> bytes:
    """The page: ``content`` is that of summary.json, ``envelope`` that of the whole run.

    ``left_out`` says why a figure, by its name, was not drawn.
    """
    changes, events = command_changes(recording), event_rows(recording)
    return render_page(
        TEMPLATE,
        {
            "title": f"Gearbox run {recording.path.name}",
            "summary": content,
            "began": _began(recording),
            "provenance": recording.run.provenance,
            "switches": switch_rows(recording.parameters),
            "changed": changed_rows(recording.parameters),
            "parameters": key_rows(recording.parameters),
            "history": draw_history(recording, envelope, windows),
            "changes": changes[:MOST_ROWS],
            "changes_left": len(changes[MOST_ROWS:]),
            "events": events[:MOST_ROWS],
            "events_left": len(events[MOST_ROWS:]),
            "condition": _condition(content),
            "energy": _energy_sides(content["energy_flow"]),
            "sankey": _sankey(content["energy_flow"]),
            "kinds": KINDS,
            "restitution": {
                gear: getattr(recording.parameters.bearings, gear).restitution
                for gear in ("driving", "driven")
            },
            "figures": sorted(figures, key=lambda figure: (figure.window, figure.name in TALL)),
            "left_out": left_out,
            "run_number": RUN,
        },
    )


def _condition(content: Mapping[str, Any]) -> list[ConditionRow]:
    windows = [f"windows.{place}" for place in range(len(content["windows"]))]
    both = [
        ConditionRow(label, unit, [_cell(content, f"{part}.{path}") for part in ("run", *windows)])
        for label, unit, path in CONDITION
    ]
    alone = [
        ConditionRow(label, unit, [ConditionCell(), *(_cell(content, f"{part}.{path}") for part in windows)])
        for label, unit, path in WINDOW_CONDITION
    ]
    return [*both, *alone]


def _cell(content: Mapping[str, Any], path: str) -> ConditionCell:
    """The number at the dotted ``path``, None if there is none."""
    found: Any = content
    for key in path.split("."):
        if found is not None:
            found = found[int(key)] if isinstance(found, list) else found.get(key)
    return ConditionCell(path, found)


def _began(recording: Recording) -> str:
    """Wall time of simulated time 0; empty if it was not run by the clock."""
    if not recording.epoch_ns:
        return ""
    return f"{datetime.fromtimestamp(recording.epoch_ns / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _energy_sides(flow: Mapping[str, Any] | None) -> Mapping[str, Sequence[EnergyRow]] | None:
    """The rows of ``put_in`` and ``went_to``, the largest first; None without energies."""
    if flow is None:
        return None
    return {
        side: [
            EnergyRow(name, ENERGY_LABELS[name][place], energy)
            for name, energy in sorted(flow[side].items(), key=lambda entry: -entry[1])
        ]
        for place, side in enumerate(("put_in", "went_to"))
    }


def _sankey(flow: Mapping[str, Any] | None) -> Sankey | None:
    sides = _energy_sides(flow)
    if flow is None or sides is None or not flow["total"]:
        return None
    put_in, went_to = ({row.label: row.energy for row in sides[side]} for side in ("put_in", "went_to"))
    return draw_sankey(put_in, went_to, flow["total"])
