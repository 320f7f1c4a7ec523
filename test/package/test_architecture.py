"""The layers of the package: which folder may import which, and one meaning for each name."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Final

import architecture
import pytest

SOURCE: Final = architecture.ROOT / architecture.PACKAGE

# From the ground up: a folder may import what stands in its row, and only what stands above it in this table.
MAY_IMPORT: Final[dict[str, set[str]]] = {
    "contract": set(),
    "system": {"contract"},
    "parameters": {"contract"},
    "physics": {"contract", "parameters"},
    "messages": {"contract", "parameters"},
    "simulation": {"contract", "system", "parameters", "physics", "messages"},
    "recording": {"contract", "system", "parameters", "messages", "simulation"},
    "analysis": {"contract", "parameters", "physics"},
    "viewer": {"contract", "system", "parameters", "physics", "analysis"},
    "realtime": {"contract", "system", "parameters", "messages", "simulation", "recording"},
    "replay": {
        "contract",
        "system",
        "parameters",
        "messages",
        "simulation",
        "recording",
        "analysis",
        "viewer",
    },
    "harness": {"contract", "system", "parameters"},
    "reporting": {"contract", "system", "parameters", "physics", "recording", "analysis", "harness"},
    "sweeps": {"contract", "system", "parameters", "physics", "simulation", "analysis"},
    "identification": {"contract", "system", "parameters", "simulation", "recording", "sweeps"},
    "paper": {
        "contract",
        "system",
        "parameters",
        "physics",
        "simulation",
        "analysis",
        "sweeps",
        "identification",
    },
    "ros": {
        "contract",
        "system",
        "parameters",
        "physics",
        "messages",
        "simulation",
        "recording",
        "viewer",
        "realtime",
        "harness",
    },
    "cli": {
        "contract",
        "system",
        "parameters",
        "physics",
        "simulation",
        "recording",
        "analysis",
        "replay",
        "reporting",
        "sweeps",
        "paper",
        "harness",
        "identification",
        "ros",
    },
    "urdf": {"contract", "system", "parameters", "physics", "messages", "cli"},
}
# Files, by glob below the package, that alone may import a library.
HOMES: Final[dict[str, tuple[str, ...]]] = {
    "rclpy": ("ros/*.py",),
    "rerun": ("viewer/*.py",),
    "matplotlib": ("analysis/figures/*.py", "sweeps/figures.py", "paper/figures.py"),
    "dask": (),
    "distributed": ("sweeps/workers.py",),
    "xarray": ("sweeps/*.py",),
    "numba": ("physics/kernel/*.py", "simulation/provenance.py"),
    "llvmlite": ("physics/kernel/*.py", "simulation/provenance.py"),
    "mcap": ("recording/**/*.py",),
    "rosbags": ("messages/*.py",),
    "jinja2": ("reporting/rendering.py",),
    "pyarrow": ("recording/export/*.py",),
}
MESSAGE_PACKAGES: Final = (
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
)
# What these do must work where the libraries for a live node and for pictures are missing.
WITHOUT_ROS_AND_PICTURES: Final = (
    "simulation.engine",
    "simulation.run",
    "recording",
    "recording.recorder",
    "recording.recover",
    "replay.verify",
    "analysis.summary",
)


def test_folders_import_what_the_table_allows_and_the_table_allows_no_more() -> None:
    used: dict[str, set[str]] = {room: set() for room in MAY_IMPORT}
    for importer, imported in architecture.edges():
        used[importer].add(imported)
    assert used == MAY_IMPORT


def test_imports_go_down_the_table() -> None:
    rooms = list(MAY_IMPORT)
    for room, allowed in MAY_IMPORT.items():
        assert all(rooms.index(other) < rooms.index(room) for other in allowed), room


def test_no_modules_import_each_other_in_a_circle() -> None:
    uses: dict[str, set[str]] = defaultdict(set)
    for importer, imported in architecture.imports():
        module = importer.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        uses[module].add(imported)
    resolved: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join([*trail[trail.index(module) :], module])
        if module not in resolved:
            for other in uses.get(module, ()):
                if other != module:
                    visit(other, (*trail, module))
            resolved.add(module)

    for module in list(uses):
        visit(module, ())


def imports(path: Path, library: str) -> bool:
    return any(name.split(".")[0] == library for name in architecture.imported_names(path))


@pytest.mark.parametrize("library", [*HOMES, *MESSAGE_PACKAGES])
def test_a_library_is_imported_in_its_own_room_only(library: str) -> None:
    homes = {path for pattern in HOMES.get(library, ("ros/*.py",)) for path in SOURCE.glob(pattern)}
    users = {path for path in SOURCE.rglob("*.py") if imports(path, library)}
    assert users <= homes, sorted(str(path.relative_to(SOURCE)) for path in users - homes)


def test_engine_recordings_verification_and_analysis_need_neither_ros_nor_pictures() -> None:
    blocked = "import sys; sys.modules.update(dict.fromkeys(['rclpy', 'rerun', 'matplotlib', 'dask']))\n"
    code = blocked + "".join(f"import gear_dynamics_ros.{name}\n" for name in WITHOUT_ROS_AND_PICTURES)
    subprocess.run([sys.executable, "-c", code], check=True)


def test_no_two_public_classes_or_functions_share_a_name() -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            named = isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            if named and not node.name.startswith("_"):
                found[node.name].append(str(path.relative_to(SOURCE)))
    assert {name: files for name, files in found.items() if len(files) > 1} == {}


def test_no_module_is_named_as_another_with_an_s() -> None:
    names = {path.stem for path in SOURCE.rglob("*.py")} | {
        path.name for path in SOURCE.rglob("*") if path.is_dir()
    }
    assert {name for name in names if f"{name}s" in names} == set()


def test_the_page_of_the_architecture_is_of_today() -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert architecture.page(text, architecture.edges()) == text, "run: python scripts/architecture.py"


def test_the_picture_shows_every_folder() -> None:
    axes = architecture.draw(architecture.edges()).axes[0]
    shown = {text.get_text() for text in axes.texts}
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders | {architecture.CONTRACT} <= shown


def test_the_picture_points_down_from_each_folder_to_what_it_needs_directly() -> None:
    pairs = {("top", "middle"): 1, ("middle", "ground"): 2, ("top", "ground"): 5}
    assert architecture.direct(pairs) == [("top", "middle"), ("middle", "ground")]
    assert architecture.floors(pairs) == {"ground": 0, "middle": 1, "top": 2}
    with pytest.raises(ValueError, match="in a circle"):
        architecture.floors(pairs | {("ground", "top"): 1})
    assert Path(architecture.PICTURE).is_file()
