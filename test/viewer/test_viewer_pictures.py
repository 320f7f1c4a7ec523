"""What the viewer shows of a run, looked at: every view of every layout."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.cli.simulate import simulate_main
from support.paths import CONFIG
from support.processes import until
from support.rerun_viewer import RerunWindow, ShownView, needs_viewer, rerun_window, shown_share

pytestmark = needs_viewer
# The views of each layout that no earlier one has: these are looked at.
LAYOUTS = {
    "overview": (
        *("Gears: driving left, driven right (mm)", "Teeth in mesh (mm)", "Drive flanks carry"),
        *("Contact lost", "Back flanks strike", "DTE between the flanks (µm)", "Meshing state"),
        *("Mesh force (N)", "What you see", "The run"),
    ),
    "dynamics": (
        *("Spectrum of DTE over mesh orders", "Phase portrait, Poincaré points (normalised)"),
        *("Energy balance (J)", "Pressure angle (°)", "Speeds (rad/s)", "Torques (N m)"),
    ),
    "bearings": (
        "Journal orbit in the clearance, driving gear (µm)",
        "Clearance in the film, driven gear (µm)",
        "Bearing force, driving gear (N)",
        "Penetration, negative = gap left (µm)",
        "Impacts: closing speed (m/s)",
    ),
    "operator": ("Bearing forces (N)",),
}
LEAST_SHOWN = 0.2  # of the columns of a view


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the teeth lose contact and strike with their back flanks."""
    folder = tmp_path_factory.mktemp("viewer")
    bag, file = folder / "bag", folder / "run.rrd"
    words = ["--params-file", str(CONFIG / "gearbox.yaml"), "--set", "operation.speed=600"]
    assert simulate_main([*words, "--duration", "0.3", "--output", str(bag)]) == 0
    assert replay_main(["view", str(bag), "--output", str(file)]) == 0
    return file


@pytest.fixture(scope="module")
def window(saved: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RerunWindow]:
    """A viewer that shows the run, on the layout that is in its file."""
    with rerun_window(tmp_path_factory.mktemp("rerun")) as shown:
        shown.show(saved, LAYOUTS["overview"][0])
        yield shown


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_view_of_the_layout_shows_something(layout: str, saved: Path, window: RerunWindow) -> None:
    window.show(saved.with_name(f"run.{layout}.rbl"), LAYOUTS[layout][0])
    views = {view.name: view for view in window.views()}
    for name in LAYOUTS[layout]:
        until(partial(shows_something, window, views[name]), f"{name} shows something")
    assert [view for view in window.views() if view.complaints] == []
    assert window.errors() == []


def shows_something(window: RerunWindow, view: ShownView) -> bool:
    picture = window.picture(view)
    return picture is not None and shown_share(view, picture) > LEAST_SHOWN
