"""Shows runs in Rerun, live or from recordings. Rerun is imported only when a viewer is opened."""

from __future__ import annotations

import importlib

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.stream import Viewer

__all__ = ["Viewer", "open_viewer", "require_rerun"]


def open_viewer(parameters: Parameters) -> Viewer | None:
    """The viewer for ``rerun.mode``, None for ``none``.

    Raises UsageError as ``Viewer`` does, and if Rerun can't be imported.
    """
    if parameters.rerun.mode == "none":
        return None
    require_rerun(f"rerun.mode is {parameters.rerun.mode}", ", or set rerun.mode to none")
    return Viewer(parameters)


def require_rerun(wanted: str, otherwise: str = "") -> None:
    """Raise UsageError if Rerun can't be imported: ``wanted`` needs it, ``otherwise`` is what else to do."""
    try:
        importlib.import_module("rerun")
    except ImportError as error:
        raise UsageError(
            f"{wanted}, but Rerun can't be imported ({error}): pip install rerun-sdk{otherwise}"
        ) from error
