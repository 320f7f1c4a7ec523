"""The compiled kernel on disk: what is edited is compiled afresh, what is not comes from the cache."""

from __future__ import annotations

import ast
import json
import os
import pickle
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numba
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


# Whatever is wrong with the cache of this one would be wrong with that of the kernel, and it compiles fast.
ENTRY = """
from gear_dynamics_ros.physics.kernel.compiling import entry_point


@entry_point
def double(x):
    return x + x


print(double(2.0), len(double.stats.cache_hits))
"""


class SmallKernel(NamedTuple):
    """A module with one entry point, and an empty home."""

    folder: Path

    @property
    def cache(self) -> Path:
        return self.folder / "__pycache__"

    def run(self, **environment: str) -> tuple[str, str]:
        """What a process that calls it prints: result and hits of the cache, and what it logs."""
        home = str(self.folder / "home")
        done = subprocess.run(
            [sys.executable, str(self.folder / "small.py")],
            env=os.environ | {"HOME": home, "XDG_CACHE_HOME": home} | environment,
            capture_output=True,
            text=True,
            timeout=120,
            preexec_fn=self._limit_files if "FULL" in environment else None,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip(), done.stderr

    @staticmethod
    def _limit_files() -> None:
        """No file may grow beyond 1000 bytes: as on a full disk, a write ends in an OSError."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))


@pytest.fixture
def small(tmp_path: Path) -> SmallKernel:
    kernel = SmallKernel(tmp_path / "small")
    (kernel.folder / "home").mkdir(parents=True)
    (kernel.folder / "small.py").write_text(ENTRY, encoding="utf-8")
    return kernel


def test_nowhere_to_keep_the_kernel_is_one_line(small: SmallKernel) -> None:
    small.cache.touch()
    (small.folder / "home").rmdir()
    (small.folder / "home").touch()
    result, log = small.run()
    assert result == "4.0 0" and log.count("\n") == 1
    assert str(small.cache) in log and "every start compiles it anew; set NUMBA_CACHE_DIR" in log
    (small.folder / "elsewhere").mkdir()
    elsewhere = str(small.folder / "elsewhere")
    assert small.run(NUMBA_CACHE_DIR=elsewhere) == ("4.0 0", "")
    assert small.run(NUMBA_CACHE_DIR=elsewhere) == ("4.0 1", "")


def test_a_full_disk_is_one_line(small: SmallKernel) -> None:
    result, log = small.run(FULL="")
    assert result == "4.0 0" and log.count("\n") == 1
    assert "(File too large): every start compiles it anew; set NUMBA_CACHE_DIR" in log
    assert small.run() == ("4.0 0", "")


def cut_to_nothing(path: Path) -> None:
    os.truncate(path, 0)


def cut_to_half(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def flip_a_bit_of_the_code(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[data.index(b"\x7fELF") + 4096] ^= 1
    path.write_bytes(data)


def replace_by_another(path: Path) -> None:
    path.write_bytes(pickle.dumps(numba.__version__) + pickle.dumps(7))


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [
        ("nbi", cut_to_nothing),
        ("nbc", cut_to_half),
        ("nbc", flip_a_bit_of_the_code),
        ("nbi", replace_by_another),
    ],
)
def test_a_damaged_cache_is_one_line_and_is_replaced(
    small: SmallKernel, suffix: str, damage: Callable[[Path], None]
) -> None:
    assert small.run() == ("4.0 0", "")
    (path,) = small.cache.glob(f"*.{suffix}")
    damage(path)
    result, log = small.run()
    assert result == "4.0 0" and log.count("\n") == 1
    assert f"in '{small.cache}' is damaged (" in log and "NUMBA_CACHE_DIR" in log
    assert small.run() == ("4.0 1", "")


def test_a_cache_that_can_only_be_read_is_read(small: SmallKernel) -> None:
    assert small.run() == ("4.0 0", "")
    (small.folder / "home").rmdir()
    (small.folder / "home").touch()
    # Root may write anywhere: leave out the places where it could.
    unwritable = "gear_dynamics_ros.physics.kernel.compiling._UnwritableLocator"
    assert small.run(NUMBA_CACHE_LOCATOR_CLASSES=unwritable) == ("4.0 1", "")


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
