"""The compiled kernel on disk: what is edited is compiled afresh, what is not comes from the cache."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import gear_dynamics_ros

PACKAGE = Path(gear_dynamics_ros.__file__).parent
FILM = Path("physics", "kernel", "film.py")
BEFORE, AFTER = "3.0 * ex * v", "3.1 * ex * v"

EVALUATE = """
import json

import gear_dynamics_ros
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.constants import aligned_zeros, excitation_table, kernel_constants
from gear_dynamics_ros.physics.kernel.entry import evaluate_state
from gear_dynamics_ros.physics.kernel.records import HERE, POINT, STATE

parameters = Parameters.from_flat({})
table = excitation_table(parameters)
state, points = aligned_zeros((1,), STATE), aligned_zeros((3,), POINT)
state["omega"], state["x"], state["impact_speed"] = 1500.0, 1e-5, 1e-3
evaluate_state(kernel_constants(parameters, table), state, points, *table)
hits = sum(evaluate_state.stats.cache_hits.values())
force = points[HERE]["film_x"].tobytes().hex()
print(json.dumps({"hits": hits, "force": force, "path": gear_dynamics_ros.__file__}))
"""


class Copy(NamedTuple):
    """A copy of the package and a place for caches outside of it."""

    package: Path
    home: Path

    def evaluate(self) -> tuple[str, bool]:
        """Bits of a film force in a new process, and whether the cache held what computes it."""
        environment = os.environ | {
            "PYTHONPATH": str(self.package.parent),
            "XDG_CACHE_HOME": str(self.home),
            "HOME": str(self.home),
        }
        done = subprocess.run(
            [sys.executable, "-c", EVALUATE],
            env=environment,
            cwd=self.home,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        told: dict[str, Any] = json.loads(done.stdout)
        assert Path(told["path"]).parent == self.package
        return told["force"], told["hits"] == 1

    def edit(self, before: str, after: str) -> None:
        """Change the film's source, not its size."""
        path = self.package / FILM
        text = path.read_text(encoding="utf-8")
        assert text.count(before) == 1 and len(before) == len(after)
        path.write_text(text.replace(before, after), encoding="utf-8")


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    home = tmp_path / "home"
    home.mkdir()
    package = tmp_path / "source" / PACKAGE.name
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    return Copy(package, home)


def test_an_edited_callee_is_compiled_afresh(copy: Copy) -> None:
    first, cached = copy.evaluate()
    assert not cached
    assert copy.evaluate() == (first, True)
    copy.edit(BEFORE, AFTER)
    edited, cached = copy.evaluate()
    assert not cached and edited != first
    copy.edit(AFTER, BEFORE)
    assert copy.evaluate() == (first, True)


def test_a_source_that_cannot_be_written_to_is_cached_elsewhere(copy: Copy) -> None:
    # Where __pycache__ is no folder nobody can write into it, root included.
    (copy.package / "physics" / "kernel" / "__pycache__").touch()
    first, cached = copy.evaluate()
    assert not cached
    assert copy.evaluate() == (first, True)
    copy.edit(BEFORE, AFTER)
    edited, cached = copy.evaluate()
    assert not cached and edited != first


def test_the_kernel_depends_on_its_folder_and_the_channel_table_alone() -> None:
    """What else it imported would be missing in the key of the cache."""
    own = "gear_dynamics_ros.physics.kernel"
    outside = set()
    for path in (PACKAGE / "physics" / "kernel").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("gear_dynamics_ros"):
                assert node.module is not None and node.level == 0
                if not node.module.startswith(own):
                    outside.add((path.name, node.module))
    contract = {"gear_dynamics_ros.channels", "gear_dynamics_ros.chunk"}
    assert outside == {("columns.py", module) for module in contract}
