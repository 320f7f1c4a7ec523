"""The page docs/gallery.md and its pictures, made from the code as it stands.

Runs the demo, and looks at its recording in Rerun, in the report and in the figures. Needs Chromium and a
Vulkan driver; no screen.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

from gear_dynamics_ros import palette  # noqa: E402
from gear_dynamics_ros.analysis.figures import CAPTIONS  # noqa: E402
from gear_dynamics_ros.cli.replay import replay_main  # noqa: E402
from support.chromium import CHROMIUM, screenshot  # noqa: E402
from support.processes import until  # noqa: E402
from support.rerun_viewer import Picture, RerunWindow, ShownView, rerun_window, without_viewer  # noqa: E402

PAGE: Final = "gallery.md"
COLOURS: Final = 256
CAPTION_SHARE: Final = 0.2  # of a view's height
SIMILAR: Final = 12  # of 255, by which a pixel of a colour may differ
REPORT_SIZE: Final = (1280, 1500)
FIGURES: Final = ("overview", "meshing_shares", "order_map", "time_series", "phase_portrait", "bearing_force")


class Scene(NamedTuple):
    """A layout, and the one of some times at which one of its views has most of a colour."""

    layout: str
    view: str
    colour: str
    timeline: str
    times: tuple[float, ...]  # s
    title: str
    text: str


SCENES: Final = (
    Scene(
        "overview",
        "Teeth in mesh (mm)",
        palette.YELLOW,  # contact lost
        "slow_motion",
        tuple(0.1 + 0.15 * step for step in range(26)),
        "The gears in mesh",
        "The layout that a recording opens with: both gears, the teeth in mesh with backlash and "
        "transmission error enlarged, the moments in which the drive flanks carry, contact is lost and the "
        "back flanks strike, and what the run was. The timeline `slow_motion` plays the moments in which "
        "contact is lost.",
    ),
    Scene(
        "dynamics",
        "Spectrum of DTE over mesh orders",
        palette.SKY,
        "sim_time",
        (6.0,),
        "Dynamics",
        "Transmission error between the flanks, forces, torques, energy, phase portrait and spectrum.",
    ),
    Scene(
        "bearings",
        "Penetration, negative = gap left (µm)",
        palette.SKY,
        "sim_time",
        (6.0,),
        "Bearings",
        "Orbits of the journals in clearance and film, forces, penetration, and every impact with its speed.",
    ),
)


def main() -> int:
    """Make the gallery; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--output", type=Path, default=ROOT / "docs", metavar="DIR", help="folder of the page"
    )
    output: Path = parser.parse_args().output
    missing = without_viewer() or ("" if CHROMIUM else "Chromium is not installed: apt-get install chromium")
    if missing:
        print(f"gallery: error: {missing}", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as scratch:
        run_demo(Path(scratch))
        look_at_viewer(Path(scratch), output)
        look_at_report(Path(scratch), output)
        for name in FIGURES:
            picture = Image.open(Path(scratch) / "demo" / "figures" / f"{name}.png")
            write_small(picture, output / picture_name(name))
    (output / PAGE).write_text(page(), encoding="utf-8")
    print(output / PAGE)
    return 0


def run_demo(folder: Path) -> None:
    """Run the demo into ``folder``/demo; a failure ends the gallery."""
    # Its report names the recording as given, so from a place where that is short.
    command = [sys.executable, str(ROOT / "scripts" / "demo.py"), "--output", "demo"]
    done = subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)})
    if done.returncode:
        sys.exit(done.returncode)


def look_at_viewer(scratch: Path, output: Path) -> None:
    """Pictures of SCENES."""
    drawn = scratch / "run.rrd"
    if replay_main(["view", str(scratch / "demo" / "recording"), "--output", str(drawn)]):
        sys.exit(1)
    with rerun_window(scratch / "home") as window:
        window.show(drawn, SCENES[0].view)
        for scene in SCENES:
            window.show(drawn.with_name(f"run.{scene.layout}.rbl"), scene.view)
            window.hold(scene.timeline, best_time(window, scene))
            write_small(
                Image.fromarray(settled_picture(window)), output / picture_name(scene.layout, "scene")
            )


def best_time(window: RerunWindow, scene: Scene) -> float:
    """The one of the times at which the view of ``scene`` has most of its colour."""
    if len(scene.times) == 1:
        return scene.times[0]
    (view,) = [view for view in window.views() if view.name == scene.view]
    colour = np.array([int(scene.colour[place : place + 2], 16) for place in (1, 3, 5)])

    def coloured(time: float) -> int:
        window.hold(scene.timeline, time)
        picture = settled_picture(window, view)
        below = picture[int(CAPTION_SHARE * len(picture)) :].astype(int)
        return int(np.count_nonzero(np.abs(below - colour).max(axis=2) < SIMILAR))

    return max(scene.times, key=coloured)


def settled_picture(window: RerunWindow, view: ShownView | None = None) -> Picture:
    """The first picture that is like the two before: all data are there, no axis moves."""
    taken: list[Picture] = []

    def settled() -> bool:
        picture = window.picture(view)
        if picture is not None:
            taken.append(picture)
        last = taken[-3:]
        return len(last) == 3 and all(np.array_equal(last[0], other) for other in last)

    until(settled, "the viewer shows the same three times")
    return taken[-1]


def look_at_report(scratch: Path, output: Path) -> None:
    """A picture of how the report begins."""
    picture = scratch / "report.png"
    screenshot(scratch / "demo" / "figures" / "report.html", picture, *REPORT_SIZE)
    write_small(Image.open(picture), output / picture_name("report"))


def picture_name(name: str, kind: str = "") -> str:
    """File of a picture of the gallery."""
    return f"gallery_{name}{'_' if kind else ''}{kind}.png"


def write_small(picture: Image.Image, path: Path) -> None:
    """Write ``picture`` in COLOURS colours."""
    with io.BytesIO() as content:
        small = picture.convert("RGB").quantize(colors=COLOURS, dither=Image.Dither.NONE)
        small.save(content, format="PNG", optimize=True)
        path.write_bytes(content.getvalue())


def page() -> str:
    """The page in Markdown."""
    parts = [
        "# Gallery",
        "Pictures of one run, that of `make demo`: a run-up, a load step and a torque reversal. `make "
        "gallery` makes this page and its pictures from the code as it stands.",
        "## Viewer",
        "[ros.md](ros.md) tells how to watch a run live, and `replay view` draws a recording. Each layout "
        "is a `.rbl` file beside the `.rrd` file.",
    ]
    for scene in SCENES:
        parts += [
            f"### {scene.title}",
            f"![{scene.title}]({picture_name(scene.layout, 'scene')})",
            scene.text,
        ]
    parts += [
        "## Report",
        "`analyze` writes one HTML page that needs no other file: what was run, checks, condition, energy, "
        "and the figures of the run and of each steady window. This is how it begins.",
        f"![How the report begins]({picture_name('report')})",
        "## Figures",
        "`analyze` also writes each figure as PNG and as SVG; [report.md](report.md#figures) lists them.",
    ]
    for name in FIGURES:
        parts += [f"### {name}", f"![{name}]({picture_name(name)})", CAPTIONS[name]]
    parts += [
        "## Sweeps",
        "`sweep` draws bifurcations, spectra, meshing shares and exponents over any parameter; "
        "[sweeps.md](sweeps.md) explains them, [paper.md](paper.md) has those of the source paper.",
        "![DTE at mesh phase 0 over speed, three models](paper_figure_5a.png)",
    ]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.exit(main())
