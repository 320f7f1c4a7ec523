"""What the viewer shows of a run, looked at: every view of every layout."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.simulation.engine import Engine
from support.paths import CONFIG
from support.processes import until
from support.rerun_viewer import RerunWindow, ShownView, needs_viewer, rerun_window, shown_share

pytestmark = needs_viewer
CHUNKS, BATCHES = 150, 3
# A view that only this layout has: the one in the recording is shown first.
LAYOUTS = {
    "overview": "Drive flanks carry",
    "dynamics": "Spectrum of DTE over mesh orders",
    "bearings": "Penetration, negative = gap left (µm)",
    "operator": "Bearing forces (N)",
}
# What only a node has.
WITHOUT_NODE = ("Real-time factor", "Operator events")
LEAST_SHOWN = 0.2  # of the columns of a view


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the teeth lose contact and strike with their back flanks."""
    from gear_dynamics_ros.viewer import Viewer

    path = tmp_path_factory.mktemp("viewer") / "run.rrd"
    settings = ["operation.speed=600.0", "rerun.mode=save", f"rerun.path={path}"]
    parameters = load_parameters(CONFIG / "gearbox.yaml", settings)
    engine, viewer = Engine(parameters), Viewer(parameters)
    for _ in range(BATCHES):
        for _ in range(CHUNKS // BATCHES):
            viewer.write(engine.advance())
        # The energies are drawn once a batch.
        until(lambda: viewer.queued == 0, "the batch is drawn")
    viewer.close()
    return path


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_view_of_the_layout_shows_something(layout: str, saved: Path, tmp_path: Path) -> None:
    with rerun_window(tmp_path, saved, saved.with_name(f"run.{layout}.rbl")) as window:
        until(lambda: LAYOUTS[layout] in {view.name for view in window.views()}, f"layout {layout}")
        views = [view for view in window.views() if view.name not in WITHOUT_NODE]
        assert len(views) >= 4
        for view in views:
            until(partial(shows_something, window, view), f"{view.name} shows something")
        assert [view for view in window.views() if view.complaints] == []
        assert window.errors() == []


def shows_something(window: RerunWindow, view: ShownView) -> bool:
    picture = window.picture(view)
    return picture is not None and shown_share(view, picture) > LEAST_SHOWN
