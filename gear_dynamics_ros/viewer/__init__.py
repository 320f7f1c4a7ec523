"""Shows chunks in Rerun, live or in an .rrd file. Rerun is imported only when a viewer is opened."""

from __future__ import annotations

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.stream import Viewer

__all__ = ["Viewer", "open_viewer"]


def open_viewer(parameters: Parameters) -> Viewer | None:
    """The viewer for ``rerun.mode``, None for ``none``. Raises UsageError as ``Viewer`` does."""
    return None if parameters.rerun.mode == "none" else Viewer(parameters)
