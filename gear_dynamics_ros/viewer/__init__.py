"""Chunks into Rerun, live or into an .rrd file; Rerun itself is imported only once a viewer is opened."""

from __future__ import annotations

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.stream import Viewer

__all__ = ["Viewer", "open_viewer"]


def open_viewer(parameters: Parameters) -> Viewer | None:
    """The viewer that ``rerun.mode`` asks for, None for ``none``; raises what ``Viewer`` raises."""
    return None if parameters.rerun.mode == "none" else Viewer(parameters)
