"""Style and types, by the tools and settings of ``make lint``."""

from __future__ import annotations

import subprocess

import pytest

from support.paths import ROOT
from support.processes import executable


@pytest.mark.parametrize(
    "command",
    [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy", "gear_dynamics_ros")],
    ids=" ".join,
)
def test_clean(command: tuple[str, ...]) -> None:
    tool, *arguments = command
    done = subprocess.run([executable(tool), *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
