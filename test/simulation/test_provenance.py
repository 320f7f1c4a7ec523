"""Provenance: whatever decides the bits is in it, and verify tells what of it differs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import scipy

import gear_dynamics_ros
from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime.model_info import describe_model
from gear_dynamics_ros.simulation import engine
from gear_dynamics_ros.simulation.provenance import current_provenance, provenance_differences
from gear_dynamics_ros.topics import NodeNames
from support.paths import CONFIG
from support.processes import executable

PACKAGE = Path(gear_dynamics_ros.__file__).parent
ENGINE = Path(engine.__file__).relative_to(PACKAGE)
HASHES = """
import json

from gear_dynamics_ros.simulation.provenance import model_hash
from gear_dynamics_ros.physics.kernel.sources import kernel_hash

print(json.dumps([kernel_hash(), model_hash()]))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package; what is compiled comes with it."""
    return shutil.copytree(PACKAGE, tmp_path / "source" / PACKAGE.name)


def with_copy(package: Path, command: list[str]) -> str:
    environment = os.environ | {"PYTHONPATH": str(package.parent)}
    done = subprocess.run(
        command, env=environment, cwd=package.parent, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def simulate(bag: Path) -> list[str]:
    words = ["--params-file", str(CONFIG / "gearbox.yaml"), "--duration", "0.004", "--output", str(bag)]
    return [executable("simulate"), *words]


def edit(path: Path, before: str, after: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1
    path.write_text(text.replace(before, after), encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "before", "after", "kernel_differs", "model_differs"),
    [
        ("physics/surface.py", "SAMPLES_PER_WAVE = 64", "SAMPLES_PER_WAVE = 65", False, True),
        ("physics/constants.py", "0.5 * math.pi * length", "0.51 * math.pi * length", False, True),
        ("physics/restitution.py", "brentq", "bisect", False, True),
        ("physics/kernel/film.py", "3.0 * ex * v", "3.1 * ex * v", True, True),
        (ENGINE, "IMPACTS_A_CALL = 256", "IMPACTS_A_CALL = 257", False, True),
        ("parameters/groups.py", "NANOSECOND: Final", "NANOSECOND: Final", False, True),
        ("simulation/run.py", '"load_torque": 0.0', '"load_torque": 0.1', False, True),
        ("palette.py", '"""', '"""', False, False),
    ],
)
def test_the_hashes_cover_what_decides_the_bits(
    package: Path, file: str | Path, before: str, after: str, kernel_differs: bool, model_differs: bool
) -> None:
    path = package / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after) + "\n# edited\n" * (before == after), encoding="utf-8")
    kernel_hash, model_hash = json.loads(with_copy(package, [sys.executable, "-c", HASHES]))
    present = current_provenance()
    assert (kernel_hash != present.kernel_hash) is kernel_differs
    assert (model_hash != present.model_hash) is model_differs


def test_the_libraries_are_those_that_compute() -> None:
    names = [entry.split()[0] for entry in current_provenance().libraries.split(", ")]
    assert names[:2] == ["numpy", "scipy"] and len(names) == 3
    assert f"scipy {scipy.__version__}" in current_provenance().libraries


def test_the_model_info_holds_both_hashes() -> None:
    told = json.loads(describe_model(Parameters(), 0, NodeNames()))
    present = current_provenance()
    assert (told["kernel_hash"], told["model_hash"]) == (present.kernel_hash, present.model_hash)


def test_verify_tells_that_another_model_recorded(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(package / "physics" / "constants.py", "0.5 * math.pi * length", "0.51 * math.pi * length")
    bag = tmp_path / "bag"
    with_copy(package, simulate(bag))
    capsys.readouterr()
    assert replay_main(["verify", str(bag)]) == 1
    difference, *origins = capsys.readouterr().err.splitlines()
    assert difference.startswith("replay: error: ")
    recorded = recording.open(bag).run.provenance.model_hash
    assert origins == [
        f"replay: model hash: recorded by {recorded}, this is {current_provenance().model_hash}"
    ]


def test_verify_tells_another_scipy(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with_copy(PACKAGE, simulate(bag))
    read = recording.open(bag)
    libraries = read.run.provenance.libraries
    older = libraries.replace(f"scipy {scipy.__version__}", "scipy 1.0.0")
    read.run = read.run._replace(provenance=read.run.provenance._replace(libraries=older))
    assert provenance_differences(read.run.provenance) == [
        f"libraries: recorded by {older}, this is {libraries}"
    ]
