"""The example that finds a clearance, as a user runs it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from gear_dynamics_ros.parameters import load_parameters
from support.paths import ROOT
from support.processes import StartProcess


def test_the_example_finds_the_clearance_of_its_rig(process: StartProcess, tmp_path: Path) -> None:
    output = tmp_path / "clearance"
    script = process(sys.executable, ROOT / "examples/identify_clearance.py", "--output", output)
    assert script.wait(120.0) == 0, script.output
    assert "Fit by identify, complete" in script.stdout
    clearance, viscosity = json.loads((output / "result.json").read_text())["unknowns"]
    assert abs(clearance["value"] - 31e-6) < 3.0 * clearance["standard_error"] < 0.1e-6
    assert abs(viscosity["value"] - 2.28e-2) < 3.0 * viscosity["standard_error"]
    assert load_parameters(output / "parameters.yaml").bearings.driven.clearance == clearance["value"]
