"""A Sankey diagram of two lists of energies: ribbons whose heights are the energies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from gear_dynamics_ros import palette
from gear_dynamics_ros.reporting.charts import Text
from gear_dynamics_ros.reporting.rendering import percent, quantity

WIDTH: Final = 1000.0
TOTAL_HEIGHT: Final = 200.0  # of the sum
GAP: Final = 14.0
TOP: Final = 12.0
LEAST: Final = 1.5  # height of a ribbon
LINE: Final = 40.0  # distance of two labels, which have two lines
SIDE: Final = 330.0  # room for the labels
BAR: Final = 16.0
COLOURS: Final = (palette.BLUE, palette.ORANGE, palette.GREEN, palette.PURPLE, palette.SKY, palette.GREY)


class Ribbon(NamedTuple):
    """One energy: its outline, and its label of two lines."""

    path: str
    colour: str
    name: Text
    amount: Text


class Sankey(NamedTuple):
    """Shapes of a diagram."""

    width: float
    height: float
    ribbons: Sequence[Ribbon]
    bar: tuple[float, float, float, float]  # x, y, width, height of the sum in the middle


def draw_sankey(put_in: Mapping[str, float], went_to: Mapping[str, float], total: float) -> Sankey:
    """Diagram of energies in J by their labels: ``put_in`` from the left, ``went_to`` to the right."""
    sides = [sorted(side.items(), key=lambda entry: -entry[1]) for side in (put_in, went_to)]
    height = max(_side_height([energy for _, energy in side], total) for side in sides)
    bar_top = TOP + (height - TOTAL_HEIGHT) / 2.0
    ribbons = [
        *_ribbons(sides[0], total, height, bar_top, left=SIDE, right=(WIDTH - BAR) / 2.0, mirrored=False),
        *_ribbons(
            sides[1], total, height, bar_top, left=WIDTH - SIDE, right=(WIDTH + BAR) / 2.0, mirrored=True
        ),
    ]
    return Sankey(WIDTH, height + 2.0 * TOP, ribbons, ((WIDTH - BAR) / 2.0, bar_top, BAR, TOTAL_HEIGHT))


def _slots(energies: Sequence[float], total: float) -> list[float]:
    """Height that each energy takes at the side, label included."""
    return [max(TOTAL_HEIGHT * energy / total + GAP, LINE) for energy in energies]


def _side_height(energies: Sequence[float], total: float) -> float:
    return max(TOTAL_HEIGHT, sum(_slots(energies, total)))


def _ribbons(
    side: Sequence[tuple[str, float]],
    total: float,
    height: float,
    bar_top: float,
    *,
    left: float,
    right: float,
    mirrored: bool,
) -> list[Ribbon]:
    """Ribbons from the side at ``left`` to the bar at ``right``, with labels outside of ``left``."""
    slots = _slots([energy for _, energy in side], total)
    top = TOP + (height - sum(slots)) / 2.0
    reached = bar_top
    ribbons: list[Ribbon] = []
    for (label, energy), slot, colour in zip(side, slots, _cycle(len(side)), strict=True):
        thick = TOTAL_HEIGHT * energy / total
        outside = top + (slot - max(thick, LEAST)) / 2.0
        path = _ribbon(left, outside, right, reached, max(thick, LEAST))
        middle, anchor = top + slot / 2.0, "start" if mirrored else "end"
        place = left + (8.0 if mirrored else -8.0)
        text = f"{quantity(energy, 'J')}, {percent(energy / total)} %"
        ribbons.append(
            Ribbon(
                path,
                colour,
                Text(place, middle - 2.0, label, anchor),
                Text(place, middle + 15.0, text, anchor),
            )
        )
        top += slot
        reached += thick
    return ribbons


def _cycle(count: int) -> list[str]:
    return [COLOURS[place % len(COLOURS)] for place in range(count)]


def _ribbon(x1: float, y1: float, x2: float, y2: float, thick: float) -> str:
    """Outline of a band of height ``thick`` from (x1, y1) to (x2, y2), its upper corners."""
    half = (x1 + x2) / 2.0
    return (
        f"M{x1:.1f},{y1:.1f} C{half:.1f},{y1:.1f} {half:.1f},{y2:.1f} {x2:.1f},{y2:.1f} "
        f"L{x2:.1f},{y2 + thick:.1f} C{half:.1f},{y2 + thick:.1f} {half:.1f},{y1 + thick:.1f} "
        f"{x1:.1f},{y1 + thick:.1f} Z"
    )
