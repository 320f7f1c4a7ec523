"""The package installs by pip and by colcon, and both leave what ``ros2 run`` and a shell look for."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import pytest
from catkin_pkg.package import parse_package
from packaging.requirements import Requirement

import gear_dynamics_ros
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.system import share
from support.paths import ROOT
from support.processes import executable

PACKAGE = "gear_dynamics_ros"
EXECUTABLES = ("analyze", "drive", "gearbox", "identify", "replay", "reproduce", "simulate", "sweep")
SHARED = (
    "package.xml",
    "config/fastdds_local.xml",
    "config/gearbox.yaml",
    "config/paper.yaml",
    "config/profiles/demo.yaml",
    "examples/identify_clearance.py",
    "examples/speed_controller.py",
    "launch/gearbox.launch.py",
    "sros2/policy.xml",
    "urdf/gearbox.urdf",
)


# The dependency in package.xml that provides an import of another name.
PROVIDERS: Mapping[str, str] = {
    "PIL": "python3-pil",
    "catkin_pkg": "python3-catkin-pkg-modules",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "numpy": "python3-numpy",
    "packaging": "python3-packaging",
    "pytest": "python3-pytest",
    "scipy": "python3-scipy",
    "urdf_parser_py": "urdfdom_py",
    "yaml": "python3-yaml",
}
# The distribution that pip installs, because Ubuntu 24.04 has it too old or not at all.
FROM_PIP: Mapping[str, str] = {
    "distributed": "distributed",
    "llvmlite": "llvmlite",
    "matplotlib": "matplotlib",
    "mcap": "mcap",
    "mcap_ros2": "mcap-ros2-support",
    "netCDF4": "netCDF4",
    "numba": "numba",
    "pyarrow": "pyarrow",
    "rosbags": "rosbags",
    "xarray": "xarray",
    "zstandard": "zstandard",
}
# Needs NumPy 2, which ROS 2 Jazzy's message packages do not work with.
NOT_ON_UBUNTU_24_04 = {"rerun"}


class Installation(NamedTuple):
    """A prefix with the package, and the environment that prefers it to any other copy."""

    prefix: Path
    environment: dict[str, str]

    def run(self, *command: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, env=self.environment, cwd=self.prefix, capture_output=True, text=True, timeout=120
        )


def checked(command: list[str], environment: dict[str, str] | None = None) -> None:
    done = subprocess.run(
        command, env=os.environ | (environment or {}), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr


def installation(prefix: Path) -> Installation:
    library = sysconfig.get_path("purelib", vars={"base": str(prefix), "platbase": str(prefix)})
    assert (Path(library) / PACKAGE).is_dir()
    return Installation(prefix, os.environ | {"PYTHONPATH": library})


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy without leftovers: setuptools builds inside the tree and installs what it finds there."""
    copy = tmp_path_factory.mktemp("source") / PACKAGE
    made = ("__pycache__", "*.egg-info", "build", "install", "log", "demo", "node_modules")
    ignored = shutil.ignore_patterns(".*", *made)
    shutil.copytree(ROOT, copy, ignore=ignored)
    return copy


@pytest.fixture(scope="module", params=["pip", "colcon"])
def installed(
    request: pytest.FixtureRequest, source: Path, tmp_path_factory: pytest.TempPathFactory
) -> Installation:
    place = tmp_path_factory.mktemp(request.param)
    if request.param == "pip":
        offline = ["--no-index", "--no-deps", "--no-build-isolation", "--ignore-installed"]
        pip = [sys.executable, "-m", "pip", "install", "--quiet", *offline]
        checked([*pip, "--prefix", str(place), str(source)])
        return installation(place)
    colcon = [executable("colcon"), "--log-base", str(place / "log"), "build"]
    places = ["--build-base", str(place / "build"), "--install-base", str(place / "install")]
    checked(
        [*colcon, "--base-paths", str(source), *places],
        {"AMENT_PREFIX_PATH": sys.prefix, "COLCON_HOME": str(place / "home")},
    )
    return installation(place / "install" / PACKAGE)


@pytest.mark.parametrize("name", EXECUTABLES)
def test_executable_runs_for_ros2_run_and_from_the_shell(installed: Installation, name: str) -> None:
    assert os.access(installed.prefix / "bin" / name, os.X_OK)
    done = installed.run(installed.prefix / "lib" / PACKAGE / name, "--help")
    assert done.returncode == 0, done.stderr
    assert f"usage: {name}" in done.stdout


def test_only_the_documented_executables(installed: Installation) -> None:
    found = sorted(path.name for path in (installed.prefix / "lib" / PACKAGE).iterdir())
    assert found == sorted(EXECUTABLES)


def test_executable_passes_arguments_and_exit_code_on(installed: Installation) -> None:
    simulate = installed.prefix / "lib" / PACKAGE / "simulate"
    done = installed.run(simulate, "--output", "unused", "--set", "no such=1")
    assert done.returncode == 2
    assert "no such" in done.stderr


def test_shared_files_are_found(installed: Installation) -> None:
    assert (installed.prefix / "share/ament_index/resource_index/packages" / PACKAGE).is_file()
    code = f"from {PACKAGE}.system.share import share_file; print(*map(share_file, {SHARED}), sep='\\n')"
    done = installed.run(sys.executable, "-c", code)
    share = installed.prefix / "share" / PACKAGE
    assert done.stdout.splitlines() == [str(share / name) for name in SHARED], done.stderr


def test_templates_of_reports_are_found(installed: Installation) -> None:
    code = (
        f"from {PACKAGE}.reporting import rendering; "
        "print(*sorted(rendering._environment().list_templates()))"
    )
    done = installed.run(sys.executable, "-c", code)
    shipped = sorted(path.name for path in (ROOT / PACKAGE / "reporting/templates").iterdir())
    assert done.stdout.split() == shipped, done.stderr


def test_shared_file_of_a_checkout() -> None:
    assert share.share_file("config/gearbox.yaml") == ROOT / "config/gearbox.yaml"


def test_missing_shared_file_is_named() -> None:
    with pytest.raises(GearboxError, match=r"config/none\.yaml: not found"):
        share.share_file("config/none.yaml")


def test_manifest_agrees_with_the_package() -> None:
    warnings: list[str] = []
    manifest = parse_package(str(ROOT), warnings=warnings)
    manifest.validate(warnings=warnings)
    assert warnings == []
    assert manifest.name == PACKAGE
    assert manifest.version == gear_dynamics_ros.__version__ == metadata.version(PACKAGE)
    assert [str(license) for license in manifest.licenses] == ["Apache-2.0"]
    assert [export.content for export in manifest.exports] == ["ament_python"]


def syntax(*folders: str) -> Iterator[ast.AST]:
    """Every node of the Python files below ``folders``."""
    for folder in folders:
        for path in (ROOT / folder).rglob("*.py"):
            yield from ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def imports(*folders: str) -> set[str]:
    """Top-level names that the Python files below ``folders`` import from elsewhere."""
    own = {path.stem for folder in ("scripts", "benchmarks") for path in (ROOT / folder).glob("*.py")}
    own |= {PACKAGE, "support"}
    found: set[str] = set()
    for node in syntax(*folders):
        match node:
            case ast.Import(names=names):
                found |= {alias.name for alias in names}
            case ast.ImportFrom(module=str(module), level=0):
                found.add(module)
    return {name.partition(".")[0] for name in found} - sys.stdlib_module_names - own


@pytest.mark.parametrize(
    ("folders", "kinds"),
    [
        (("gear_dynamics_ros", "launch", "examples"), ("exec_depends",)),
        (("test",), ("exec_depends", "test_depends")),
    ],
    ids=["package", "tests"],
)
def test_manifest_names_what_is_imported(folders: tuple[str, ...], kinds: tuple[str, ...]) -> None:
    manifest = parse_package(str(ROOT))
    declared = {dependency.name for kind in kinds for dependency in getattr(manifest, kind)}
    used = imports(*folders)
    assert used >= {"numpy", "rclpy", "std_msgs"}
    from_rosdep = used - FROM_PIP.keys() - NOT_ON_UBUNTU_24_04
    assert {PROVIDERS.get(name, name) for name in from_rosdep} - declared == set()


def test_manifest_names_the_packages_of_all_message_types() -> None:
    texts = (node.value for node in syntax(PACKAGE) if isinstance(node, ast.Constant))
    types = (re.fullmatch(r"(\w+)/msg/[A-Z]\w*", text) for text in texts if isinstance(text, str))
    packages = {found[1] for found in types if found}
    assert packages >= {"geometry_msgs", "std_msgs"}
    assert packages - {dependency.name for dependency in parse_package(str(ROOT)).exec_depends} == set()


def test_constraints_for_ubuntu_pin_what_pip_installs() -> None:
    lines = (ROOT / "constraints-ubuntu-24.04.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert set(FROM_PIP.values()) <= pinned.keys()
    assert int(pinned["numpy"].partition(".")[0]) < 2
    required = (Requirement(text) for text in metadata.requires(PACKAGE) or ())
    unmarked = {requirement.name: requirement for requirement in required if not requirement.marker}
    assert {"matplotlib", "numba", "numpy", "rosbags"} <= unmarked.keys()
    versions = {name.lower(): version for name, version in pinned.items()}
    assert [
        str(each) for each in unmarked.values() if not each.specifier.contains(versions[each.name.lower()])
    ] == []


def test_entry_points_are_the_executables() -> None:
    scripts = metadata.distribution(PACKAGE).entry_points.select(group="console_scripts")
    assert sorted(scripts.names) == sorted(EXECUTABLES)
    assert all(callable(script.load()) for script in scripts)


@pytest.mark.parametrize("name", EXECUTABLES)
def test_ctrl_c_while_a_command_is_loaded_is_told_in_a_line(tmp_path: Path, name: str) -> None:
    slow = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60.0)\n"
    (tmp_path / "yaml.py").write_text(slow)  # every command loads it, the node beyond its help
    arguments = [] if name == "gearbox" else ["--help"]
    script = Path(sys.executable).with_name(name)
    done = subprocess.run(
        [script, *arguments], capture_output=True, text=True, timeout=120, env={"PYTHONPATH": str(tmp_path)}
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{name}: interrupted by SIGINT\n")


def test_engine_analysis_and_recording_need_neither_ros_nor_viewer() -> None:
    modules = ", ".join(
        f"{PACKAGE}.{name}" for name in ("simulation.engine", "analysis", "recording", "cli.simulate")
    )
    code = f"import sys; sys.modules.update(rclpy=None, rerun=None); import {modules}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
