"""Figures of recordings. Each is a matplotlib Figure drawn without pyplot or any other global state."""

from __future__ import annotations

from gear_dynamics_ros.analysis.figures.catalogue import (
    CAPTIONS,
    FIGURE_NAMES,
    RUN_FIGURES,
    lacking_figures,
    recording_figures,
)
from gear_dynamics_ros.analysis.figures.divergence import Overlay, divergence_figure
from gear_dynamics_ros.analysis.figures.style import small_png, write_png, write_small_png, write_svg

__all__ = [
    "CAPTIONS",
    "FIGURE_NAMES",
    "RUN_FIGURES",
    "Overlay",
    "divergence_figure",
    "lacking_figures",
    "recording_figures",
    "small_png",
    "write_png",
    "write_small_png",
    "write_svg",
]
