"""The examples run as they stand, with fewer points."""

from __future__ import annotations

from importlib import util
from pathlib import Path
from types import ModuleType

import pytest

from gear_dynamics_ros.sweeps import Measurement
from support.paths import ROOT


def example(name: str) -> ModuleType:
    spec = util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_bifurcations_of_another_pair(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("bifurcation").main(tmp_path / "pair", "operation.speed=1000:9000:5rpm", Measurement(40, 120))
    told = capsys.readouterr().out
    assert (tmp_path / "pair/sweep.nc").exists() and (tmp_path / "pair/bifurcation.png").exists()
    assert "compared: chaotic at " in told and " of 5 speeds" in told


def test_hysteresis_of_lost_contact(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("hysteresis").main(tmp_path, "operation.speed=5200:7400:12rpm")
    assert "two motions from 5800 to 6800 rpm" in capsys.readouterr().out
    assert (tmp_path / "hysteresis.png").exists()
