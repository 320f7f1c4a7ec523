"""How long the teeth were on each flank, over the run and in the window."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.figures.overview import ends_of, mark_changes, number_windows
from gear_dynamics_ros.analysis.figures.style import styled
from gear_dynamics_ros.analysis.meshing import MeshingTimeline
from gear_dynamics_ros.analysis.sections import MeshingShares
from gear_dynamics_ros.chunk import Samples

COURSE_INTERVALS: Final = 200
LEAST_NUMBERED: Final = 0.005  # share that gets a number
STATES: Final = (  # label, colour and hatch, from below, in the order of MeshingShares
    ("drive flank", palette.BLUE, ""),
    ("apart", "#F2F2F2", ""),
    ("back flank", palette.ORANGE, "////"),
)


@styled
def meshing_shares_figure(
    timeline: MeshingTimeline, changes: Sequence[float], windows: Sequence[Samples]
) -> Figure:
    """Shares of the meshing states over the run, which ``timeline`` holds, and in ``windows``.

    Raises ValueError if ``timeline`` is empty.
    """
    shares = timeline.shares()
    if shares is None:
        raise ValueError("the timeline has no meshing states")
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    course, bars = figure.subplots(1, 2, width_ratios=(4, 0.6 + 0.25 * len(windows)), sharey=True)
    edges, values = timeline.edges(COURSE_INTERVALS), 100.0 * timeline.course(COURSE_INTERVALS)
    base = np.zeros(len(values))
    for (label, colour, hatch), values_of_state in zip(STATES, values.T, strict=True):
        course.stairs(
            base + values_of_state,
            edges,
            baseline=base,
            fill=True,
            facecolor=colour,
            hatch=hatch,
            edgecolor="black",
            linewidth=0.4,
            label=label,
        )
        base = base + values_of_state
    mark_changes(course, changes)
    for window in windows:
        course.axvspan(*ends_of(window), fill=False, edgecolor="black", linewidth=1.2)
    number_windows(course, [ends_of(window) for window in windows])
    course.set(xlim=(edges[0], edges[-1]), ylim=(0.0, 100.0))
    course.set_xlabel("simulated time (s)")
    course.set_ylabel("share of time (%)")
    marks = " (grey: commands and events)" if changes else ""
    how = "from event times" if timeline.from_events else "from samples"
    course.set_title(f"Meshing states over the run, {how}{marks}", pad=22.0)
    course.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=3, borderaxespad=0.2)
    for place, found in enumerate((shares, *map(_shares_in, windows))):
        if found is not None:
            _draw_bar(bars, place, found)
    names = ["window"] if len(windows) == 1 else [str(number) for number in range(1, len(windows) + 1)]
    bars.set_xticks(range(1 + len(windows)), ["run", *names])
    bars.set_xlabel("" if len(windows) == 1 else "window")
    bars.grid(visible=False)
    return figure


def _shares_in(window: Samples) -> MeshingShares | None:
    timeline = MeshingTimeline()
    timeline.add(window)
    return timeline.shares()


def _draw_bar(axis: Axes, place: int, shares: MeshingShares) -> None:
    base = 0.0
    for (_, colour, hatch), share in zip(STATES, shares, strict=True):
        axis.bar(
            place, 100.0 * share, 0.72, base, color=colour, hatch=hatch, edgecolor="black", linewidth=0.6
        )
        if share > LEAST_NUMBERED:
            axis.annotate(
                f"{100.0 * share:.1f}",
                (place, base + 50.0 * share),
                ha="center",
                va="center",
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
                annotation_clip=False,
            )
        base += 100.0 * share
