"""The kernel is compiled and loaded before a run, and only a compilation says so."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from numba.core.caching import UserProvidedCacheLocator

from gear_dynamics_ros.channels import COLUMN
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.kernel import entry
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.warm_up import warm_up
from support.processes import StartProcess

ENTRY_POINTS = (entry.start_touching, entry.evaluate_before_change, entry.adapt_to_change, entry.integrate)


def test_nothing_is_said_where_nothing_is_compiled() -> None:
    warm_up(lambda _: None, lambda _: None)
    said: list[str] = []
    warm_up(said.append, said.append)
    assert said == []


def test_no_parameters_need_more_than_what_is_warmed_up() -> None:
    warm_up(lambda _: None, lambda _: None)
    before = [len(function.signatures) for function in ENTRY_POINTS]
    assert min(before) >= 1
    for values in (
        {"waveform_channels": tuple(COLUMN)},
        {
            "model": "traditional",
            "mesh_phase": "nominal",
            "solver.chunk": 0.01,
            "mesh.stiffness_cos": (0.1, 0.1),
        },
        {"surface.waves": 1, "surface.driving.roughness": 0.0, "operation.control": "torque"},
    ):
        Engine(Parameters.from_flat(values)).advance(2)
    assert [len(function.signatures) for function in ENTRY_POINTS] == before


def test_a_damaged_cache_delays_a_command_and_no_more(process: StartProcess, tmp_path: Path) -> None:
    warm_up(lambda _: None, lambda _: None)
    source = entry.start_touching.stats.cache_path
    folder = tmp_path / "cache" / UserProvidedCacheLocator.get_suitable_cache_subpath(entry.__file__)
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.pyc"))
    for path in folder.glob("entry.start_touching-*.nbc"):
        os.truncate(path, 1000)

    def simulate(name: str) -> list[str]:
        command = ("simulate", "--duration", "0.002", "--output", tmp_path / name)
        started = process(*command, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert started.wait() == 0, started.output
        return started.stderr.splitlines()

    warning, compiling, compiled = simulate("first")
    assert warning.startswith(f"simulate: warning: the compiled kernel in '{folder}' is damaged (")
    assert compiling == "simulate: compiling the kernel, which can take a minute"
    assert compiled.startswith("simulate: compiled in ")
    assert simulate("second") == []
