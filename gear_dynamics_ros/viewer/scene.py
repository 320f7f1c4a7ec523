"""The gears in mesh: outlines, teeth, flanks, line of action, forces, and the journals in the hubs."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.channels import COLUMN, GEARS
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.canvas import Canvas, Times, circle
from gear_dynamics_ros.viewer.entities import MOMENTS, SCENE
from gear_dynamics_ros.viewer.gear_pair import GearPair, MeshContact, PairPose, plane_vector
from gear_dynamics_ros.viewer.scales import CLOSE_UP_SHARE, MICROMETRES, MILLIMETRES, DrawingScales

GEAR_COLOURS: Final = {"driving": "#E6E6E6", "driven": "#A8A8A8"}
# By meshing state, as channel ``meshing_state``.
STATE_COLOURS: Final = {1: palette.SKY, 0: palette.YELLOW, -1: palette.ORANGE}
STATE_TEXTS: Final = {1: "drive flanks in contact", 0: "contact lost", -1: "back flanks in contact"}
MESH_FORCE_COLOUR: Final = palette.PURPLE
CONTACT_FORCE_COLOUR: Final = palette.ORANGE
FILM_FORCE_COLOUR: Final = palette.GREEN
HUB_COLOUR: Final = palette.GREY
JOURNAL_COLOUR: Final = "#FFFFFF"
NOTES_HEIGHT: Final = 1.25  # tip radii above the centres
CLOSE_UP_HALF: Final = 3.4  # modules from the pitch point to the edges of the close-up
STILL_SHAPE: Final = complex(0.8, 1.25)  # half width and half height of a still, of the close-up's

Points = NDArray[np.complex128]
Values = NDArray[np.float64]


class Frames(NamedTuple):
    """Samples to draw, one picture each."""

    rows: Values  # (n, 28)
    revolutions: Values  # (n,), whole ones of the driving gear before each
    times: Times  # n entries
    note: str = ""  # added to the line of text in each picture


def flank_states(rows: Values) -> list[int]:
    """Meshing states of samples (n, 28): 1, 0 or -1."""
    return [int(np.sign(state)) if math.isfinite(state) else 0 for state in rows[:, COLUMN["meshing_state"]]]


class GearScene:
    """Draws both gears, turning, with the teeth in mesh; lengths in mm."""

    def __init__(self, canvas: Canvas, parameters: Parameters, scales: DrawingScales) -> None:
        self._canvas = canvas
        self._scales = scales
        self._pair = GearPair(parameters, scales)
        self._clearances = {
            gear: getattr(parameters.bearings, gear).clearance * MILLIMETRES * scales.hub for gear in GEARS
        }
        self._nominal = {"driving": 0.0 + 0.0j, "driven": complex(self._pair.centre_distance)}

    @property
    def bounds(self) -> tuple[complex, complex]:
        """Lower left and upper right corner of the whole scene."""
        first, second = self._pair.driving, self._pair.driven
        height = 1.12 * self._top
        return (
            complex(-1.08 * first.tip_radius, -1.08 * max(first.tip_radius, second.tip_radius)),
            complex(self._pair.centre_distance + 1.08 * second.tip_radius, height),
        )

    @property
    def close_up_bounds(self) -> tuple[complex, complex]:
        """Lower left and upper right corner of the teeth in mesh."""
        middle, half = self._pair.driving.reference_radius, CLOSE_UP_HALF * self._pair.driving.module
        return complex(middle - half, -half), complex(middle + half, half)

    @property
    def still_bounds(self) -> tuple[complex, complex]:
        """Lower left and upper right corner of a still of the teeth in mesh."""
        middle, half = self._pair.driving.reference_radius, CLOSE_UP_HALF * self._pair.driving.module
        return middle - half * STILL_SHAPE, middle + half * STILL_SHAPE

    @property
    def _top(self) -> float:
        return NOTES_HEIGHT * max(self._pair.driving.tip_radius, self._pair.driven.tip_radius)

    def draw_fixed(self) -> None:
        """Draw shapes and styles that stay for the whole run."""
        for gear in GEARS:
            self._draw_gear(gear)
            self._draw_hub(gear)
        self._canvas.style_lines(f"{SCENE}/teeth", list(GEAR_COLOURS.values()), 1.8)
        self._canvas.style_lines(f"{SCENE}/flanks", [], 5.0)
        self._canvas.style_lines(f"{SCENE}/line_of_action", [], 1.2)
        self._canvas.style_lines(f"{SCENE}/gap", [palette.YELLOW], 4.0)
        for entity in (f"{SCENE}/mesh_force", f"{SCENE}/close_up_mesh_force"):
            self._canvas.style_arrows(entity, MESH_FORCE_COLOUR)
        self._canvas.style_labels(f"{SCENE}/status")
        self._canvas.style_labels(f"{SCENE}/close_up_status")

    def draw(self, frames: Frames) -> None:
        """Draw the gears at each of ``frames``."""
        pose = self._pair.pose(frames.rows, frames.revolutions)
        contact = self._pair.contact(pose)
        states = flank_states(frames.rows)
        colours = [STATE_COLOURS[state] for state in states]
        times, canvas = frames.times, self._canvas
        canvas.placements(f"{SCENE}/driving", times, pose.driving_centre, pose.driving_angle)
        canvas.placements(f"{SCENE}/driven", times, pose.driven_centre, pose.driven_angle)
        canvas.lines(f"{SCENE}/teeth", times, np.stack(self._pair.teeth_in_mesh(pose), axis=1))
        canvas.lines(f"{SCENE}/flanks", times, self._flanks(pose, contact), colours)
        canvas.lines(f"{SCENE}/line_of_action", times, self._pair.line_of_action(pose), colours)
        canvas.lines(f"{SCENE}/gap", times, gap_lines(contact, states))
        self._draw_mesh_force(frames, contact)
        for gear in GEARS:
            self._draw_journal(gear, frames)
        texts = status_texts(frames, states)
        notes = np.full(len(texts), complex(self._pair.driving.reference_radius, self._top))
        canvas.labels(f"{SCENE}/status", times, notes, texts, colours)
        upper = np.full(len(texts), complex(notes[0].real, 0.95 * self.close_up_bounds[1].imag))
        shorter = [STATE_TEXTS[state] + text for state, text in zip(states, gap_texts(frames), strict=True)]
        canvas.labels(f"{SCENE}/close_up_status", times, upper, shorter, colours)

    def draw_moment(self, name: str, title: str, row: Values) -> None:
        """Draw the teeth in mesh at the sample ``row`` (28,) for the whole run, as the still ``name``."""
        rows = row[None, :]
        pose = self._pair.pose(rows, np.zeros(1))
        contact = self._pair.contact(pose)
        state = flank_states(rows)[0]
        teeth = [gear[0] for gear in self._pair.teeth_in_mesh(pose)]
        entity, colour = f"{MOMENTS}/{name}", STATE_COLOURS[state]
        self._canvas.fix_lines(f"{entity}/teeth", teeth, list(GEAR_COLOURS.values()), 1.8)
        self._canvas.fix_lines(f"{entity}/flanks", list(self._flanks(pose, contact)[0]), [colour] * 2, 5.0)
        self._canvas.fix_lines(f"{entity}/gap", list(gap_lines(contact, [state])[0]), [palette.YELLOW], 4.0)
        self.draw_moment_title(name, title, colour)

    def draw_moment_title(self, name: str, title: str, colour: str) -> None:
        """Write what the still ``name`` shows, or why it shows nothing."""
        place = complex(self._pair.driving.reference_radius, 0.88 * self.still_bounds[1].imag)
        self._canvas.fix_labels(f"{MOMENTS}/{name}/title", {title: place}, colour)

    def _flanks(self, pose: PairPose, contact: MeshContact) -> Points:
        return np.stack(self._pair.flanks_in_mesh(pose, contact), axis=1)

    def _draw_gear(self, gear: str) -> None:
        entity, shape = f"{SCENE}/{gear}", getattr(self._pair, gear)
        outline = shape.outline(self._pair.nominal_clearance)
        mark = np.array([1.15 * self._clearances[gear], 0.97 * shape.root_radius], dtype=np.complex128)
        colour = GEAR_COLOURS[gear]
        self._canvas.fix_lines(f"{entity}/outline", [outline], [colour], 1.4)
        self._canvas.fix_lines(f"{entity}/mark", [mark], [colour], 1.0)
        self._canvas.fix_lines(f"{entity}/base_circle", [circle(shape.base_radius)], [palette.DIM], 1.0)

    def _draw_hub(self, gear: str) -> None:
        entity, middle, radius = f"{SCENE}/hub/{gear}", self._nominal[gear], self._clearances[gear]
        cross = [middle + radius * np.array([-1.0, 1.0]) * turn for turn in (1.0, 1.0j)]
        self._canvas.fix_lines(
            f"{entity}/clearance",
            [circle(radius, middle), *cross],
            [HUB_COLOUR, palette.DIM, palette.DIM],
            1.2,
        )
        self._canvas.fix_labels(
            f"{entity}/name", {f"{gear} gear": middle - 1.9j * radius}, GEAR_COLOURS[gear]
        )
        self._canvas.style_points(f"{entity}/journal", JOURNAL_COLOUR, 9.0)
        self._canvas.style_arrows(f"{entity}/contact_force", CONTACT_FORCE_COLOUR)
        self._canvas.style_arrows(f"{entity}/film_force", FILM_FORCE_COLOUR)

    def _draw_journal(self, gear: str, frames: Frames) -> None:
        entity, rows = f"{SCENE}/hub/{gear}", frames.rows
        moved = MILLIMETRES * self._scales.hub * plane_vector(rows, gear)
        journal = (self._nominal[gear] + moved)[:, None]
        self._canvas.points(f"{entity}/journal", frames.times, journal)
        for kind in ("contact_force", "film_force"):
            arrows = self._arrows(plane_vector(rows, f"{gear}_{kind}"))[:, None]
            self._canvas.arrows(f"{entity}/{kind}", frames.times, journal, arrows)

    def _draw_mesh_force(self, frames: Frames, contact: MeshContact) -> None:
        """Equal and opposite arrows, on each gear at its flank."""
        force = self._arrows(frames.rows[:, COLUMN["mesh_force"]] * contact.direction)
        origins = np.stack([contact.point, contact.point], axis=1)
        arrows = np.stack([-force, force], axis=1)
        self._canvas.arrows(f"{SCENE}/mesh_force", frames.times, origins, arrows)
        shorter = CLOSE_UP_SHARE * arrows
        self._canvas.arrows(f"{SCENE}/close_up_mesh_force", frames.times, origins, shorter)

    def _arrows(self, forces: Points) -> Points:
        """Arrows in mm of ``forces`` in N, no longer than the scales allow."""
        arrows = self._scales.force * forces
        longest = self._scales.longest_arrow
        return np.asarray(arrows * np.minimum(1.0, longest / np.maximum(np.abs(arrows), 1e-12)))


def gap_lines(contact: MeshContact, states: list[int]) -> Points:
    """Lines (n, 1, 2) across the gap along the line of action where contact is lost, else of no length."""
    apart = np.array([state == 0 for state in states])
    side = np.where(np.array(states) < 0, -1.0, 1.0)
    across = np.where(apart, contact.gap, 0.0) * contact.direction * side
    return np.stack([contact.point, contact.point + across], axis=1)[:, None, :]


def gap_texts(frames: Frames) -> list[str]:
    """What the close-up adds to the meshing state: the gaps on both sides, µm."""
    half = frames.rows[:, COLUMN["half_backlash"]] * MICROMETRES
    dte = frames.rows[:, COLUMN["dte"]] * MICROMETRES
    return [
        f"\n{b - q:.1f} µm before the drive flank, {b + q:.1f} µm behind"
        if abs(q) < b
        else f"\npressed together by {abs(q) - b:.1f} µm"
        for b, q in zip(half, dte, strict=True)
    ]


def status_texts(frames: Frames, states: list[int]) -> list[str]:
    """One line for each of ``frames``: time, DTE, state, force."""
    rows = frames.rows
    columns = (rows[:, COLUMN[name]] for name in ("time", "dte", "mesh_force", "driving_speed"))
    return [
        f"{time:.6f} s{frames.note}: {STATE_TEXTS[state]}\nDTE {dte * MICROMETRES:+.1f} µm, "
        f"mesh force {force + 0.0:.0f} N, driving speed {speed:.0f} rad/s"
        for time, dte, force, speed, state in zip(*columns, states, strict=True)
    ]
