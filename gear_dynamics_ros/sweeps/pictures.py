"""The figures of a dataset as files."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from gear_dynamics_ros.analysis.figures import write_png
from gear_dynamics_ros.sweeps.figures import sweep_figures
from gear_dynamics_ros.system.files import output_file


def draw_figures(dataset: xr.Dataset, folder: Path) -> list[Path]:
    """Draw every figure of a sweep's ``dataset`` into ``folder``; returns the files.

    Raises GearboxError if one can't be written.
    """
    paths = []
    for name, draw in sweep_figures(dataset).items():
        path = folder / f"{name}.png"
        with output_file(path) as stream:
            write_png(draw(), stream)
        paths.append(path)
    return paths
