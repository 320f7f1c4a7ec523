"""Files and folders appear whole or not at all, and what stood there before is kept or refused."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from gear_dynamics_ros.cli.simulate import simulate_main
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.system.files import new_file, new_folder, replace_file, replace_text

NEW: list[Callable[[Path], AbstractContextManager[Any]]] = [new_file, new_folder]


def test_a_file_is_replaced_when_the_block_ends_and_not_before(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("old")
    with replace_file(path) as stream:
        stream.write(b"new")
        stream.flush()
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["x.txt"]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_the_earlier_file_outlives_a_failure(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(error), replace_file(path) as stream:
        stream.write(b"new")
        raise error
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]


def test_a_draft_left_by_a_killed_process_does_not_keep_a_file_from_being_replaced(tmp_path: Path) -> None:
    (tmp_path / ".x.txt.part").write_text("half")
    replace_text(tmp_path / "x.txt", "größer\n")
    assert (tmp_path / "x.txt").read_bytes() == "größer\n".encode()
    assert os.listdir(tmp_path) == ["x.txt"]


@pytest.mark.parametrize("create", NEW)
@pytest.mark.parametrize("name", ["there", "there.part"])
def test_what_exists_is_refused_and_kept(
    tmp_path: Path, create: Callable[[Path], AbstractContextManager[Any]], name: str
) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(UsageError, match=rf"{name}' exists already"), create(tmp_path / "there"):
        pass
    assert (tmp_path / name).read_text() == "mine"
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("create", NEW)
def test_what_another_process_made_meanwhile_is_kept(
    tmp_path: Path, create: Callable[[Path], AbstractContextManager[Any]]
) -> None:
    path = tmp_path / "x"
    with pytest.raises(UsageError, match="exists already"), create(path):
        path.write_text("mine")
    assert path.read_text() == "mine"
    assert os.listdir(tmp_path) == ["x"]


@pytest.mark.parametrize("create", NEW)
@pytest.mark.parametrize(
    ("error", "raised"),
    [(KeyboardInterrupt(), KeyboardInterrupt), (OSError(28, "disk is full"), GearboxError)],
)
def test_a_failure_leaves_nothing(
    tmp_path: Path,
    create: Callable[[Path], AbstractContextManager[Any]],
    error: BaseException,
    raised: type[BaseException],
) -> None:
    with pytest.raises(raised) as caught, create(tmp_path / "x"):
        raise error
    assert raised is not GearboxError or str(caught.value).startswith(
        f"can't write '{tmp_path}/x': disk is full"
    )
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("create", NEW)
def test_a_missing_folder_is_named(
    tmp_path: Path, create: Callable[[Path], AbstractContextManager[Any]]
) -> None:
    with pytest.raises(UsageError, match=rf"the folder '{tmp_path}/none' does not exist"):
        create(tmp_path / "none" / "x").__enter__()


def test_a_full_disk_keeps_what_an_earlier_analysis_wrote(tmp_path: Path) -> None:
    bag, output = tmp_path / "bag", tmp_path / "output"
    assert simulate_main(["--duration", "0.01", "--output", str(bag)]) == 0
    output.mkdir()
    for name in ("summary.json", "overview.png"):
        (output / name).write_text("earlier")
    done = subprocess.run(
        [sys.executable, "-m", "gear_dynamics_ros.cli.analyze", str(bag), "--output", str(output)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"analyze: error: can't write '{output}/")
    assert "File too large: free space" in done.stderr and done.stderr.count("\n") == 1
    assert {path.name: path.read_text() for path in output.iterdir()} == {
        "summary.json": "earlier",
        "overview.png": "earlier",
    }
