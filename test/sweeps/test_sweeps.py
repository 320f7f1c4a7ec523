"""The numbers of a sweep: the same whatever computes them, in whatever order, however often interrupted."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from gear_dynamics_ros.cli.sweeping import sweep_main
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.sweeps import Measurement, SweepPlan, measure, parse_axis, run
from gear_dynamics_ros.sweeps.execution import run_in_folder
from gear_dynamics_ros.sweeps.point import ARRAYS, DONE, SCALARS
from gear_dynamics_ros.sweeps.store import NOT_COMPUTED, SweepFolder
from support.paths import CONFIG
from support.processes import Process, StartProcess, until
from support.published import published_gearbox

SPEEDS = "operation.speed=5000:7000:5rpm"
OPTIONS = ("--params-file", str(CONFIG / "paper.yaml"), "--over", SPEEDS, "--transient", "20", "--keep", "40")


def plan(direction: str = "independent", over: str = SPEEDS, keep: int = 40, **settings: object) -> SweepPlan:
    overrides = [f"{name.replace('__', '.')}={value}" for name, value in settings.items()]
    return SweepPlan(
        load_parameters(CONFIG / "paper.yaml", overrides),
        (parse_axis(over),),
        ("traditional", "compared"),
        Measurement(20, keep),
        direction,
    )


def same(one: xr.Dataset, other: xr.Dataset) -> bool:
    return bool(one.identical(other))


def test_points_are_what_single_runs_give() -> None:
    swept = plan()
    dataset = run(swept)
    alone = measure(swept.parameters_at((1, 0, 3)), swept.measurement)
    point = dataset.isel(model=1, **{"operation.speed": 3})
    np.testing.assert_equal({name: float(point[name]) for name in SCALARS}, alone.scalars)
    assert all(np.array_equal(point[name].values, alone.arrays[name]) for name in ARRAYS)


@pytest.mark.parametrize("direction", ["independent", "up", "both"])
def test_the_numbers_do_not_depend_on_the_number_of_workers(direction: str) -> None:
    assert same(run(plan(direction), workers=1), run(plan(direction), workers=3))


@pytest.mark.parametrize("direction", ["independent", "down", "both"])
def test_an_interrupted_sweep_is_finished_with_the_same_numbers(tmp_path: Path, direction: str) -> None:
    swept = plan(direction)
    folder = SweepFolder.begin(tmp_path / "sweep", swept)

    class Stop(Exception):
        pass

    def stop_at_four(done: int) -> None:
        if done == 4:
            raise Stop

    with pytest.raises(Stop):
        run_in_folder(folder, stop_at_four, workers=2)
    partial = folder.dataset()
    states = partial["status"].values.ravel().tolist()
    assert 4 <= states.count(DONE) < swept.size and states.count(NOT_COMPUTED) == swept.size - states.count(
        DONE
    )
    assert bool(np.isnan(partial["dte_max"]).sum() == states.count(NOT_COMPUTED))
    again = SweepFolder.resume(tmp_path / "sweep", swept)
    run_in_folder(again, lambda done: None, workers=1)
    assert same(again.dataset(), run(swept))


def test_sweeping_up_and_down_shows_the_hysteresis_of_lost_contact() -> None:
    """Below its resonance a pair with backlash moves far when it comes from above, little from below."""
    smooth = ["mesh.error_cos=[2e-6]", "mesh.damping_ratio=0.03", "surface.driving.roughness=1e-7"]
    swept = SweepPlan(
        published_gearbox([*smooth, "surface.driven.roughness=1e-7"]),
        (parse_axis("operation.speed=5200:7400:23rpm"),),
        ("traditional",),
        Measurement(150, 100),
        "both",
    )
    dataset = run(swept).sel(model="traditional")
    up, down = (dataset.sel(direction=way) for way in ("up", "down"))
    above = (down["dte_max"] - up["dte_max"]).values
    apart = np.flatnonzero(above > 2e-6)
    assert len(apart) >= 8 and np.all(np.diff(apart) == 1)
    outside = np.delete(above, apart)
    assert np.abs(outside).max() < 5e-7
    assert float(up["apart_share"][apart].max()) < 0.2 < 0.5 < float(down["apart_share"][apart].min())


def test_coexisting_motions_are_found_from_a_grid_of_starts() -> None:
    swept = SweepPlan(
        published_gearbox(["mesh.error_cos=[4e-6]"]),
        (parse_axis("start.dte=-30:30:4um"), parse_axis("start.dte_rate=-0.3:0.3:4")),
        ("traditional",),
        Measurement(200, 40),
    )
    dataset = run(swept)
    assert dataset["dte_max"].dims == ("model", "start.dte", "start.dte_rate")
    assert dataset["start.dte"].attrs["units"] == "m"
    assert (dataset["status"] == DONE).all()


def test_a_point_that_cannot_be_is_marked_while_the_others_go_on() -> None:
    dataset = run(plan(over="bearings.*.clearance=27,160,300um"))
    states = dataset["status"].sel(model="compared").values.tolist()
    assert states[0] == DONE and "oil_clearance" in states[2]
    assert np.isnan(dataset["dte_max"].sel(model="compared").values).tolist() == [False, True, True]
    tripped = run(plan(over="operation.drive_torque=30,3e5"))
    assert str(tripped["status"].sel(model="compared").values[1]).startswith("over-speed: ")


def test_the_dataset_is_opened_without_this_package(tmp_path: Path) -> None:
    folder = SweepFolder.begin(tmp_path / "sweep", plan())
    run_in_folder(folder, lambda done: None)
    path = folder.write_dataset(folder.dataset())
    import netCDF4

    with netCDF4.Dataset(path) as stored:
        assert (
            stored.variables["dte_max"].units == "m" and stored.variables["operation.speed"].units == "rad/s"
        )
        assert json.loads(stored.parameters)["mesh_geometry"] == "published"
        assert stored.kept_periods == 40 and len(stored.provenance_model_hash) == 64
        speeds = stored.variables["operation.speed"][:]
        assert speeds[-1] == pytest.approx(7000 * math.pi / 30)
        assert stored.variables["section_dte"].shape == (2, 5, 40)


def test_a_sweep_tells_periodic_from_chaotic_motion() -> None:
    speeds = parse_axis("operation.speed=7000,10500,15500rpm")
    parameters = published_gearbox()
    dataset = run(SweepPlan(parameters, (speeds,), ("traditional",), Measurement(1000, 400))).squeeze()
    assert dataset["period"].values.tolist() == [2.0, 0.0, 1.0]
    meanings = dataset["regime"].attrs["flag_meanings"].split()
    assert [meanings[int(code)] for code in dataset["regime"]] == ["periodic", "chaotic", "periodic"]
    assert dataset["lyapunov"][1] > 500.0 and dataset["zero_one"][1] > 0.9
    assert dataset["section_phase_error"].max() < 1e-12


def test_the_spectrum_shows_a_line_of_the_mesh_at_its_amplitude() -> None:
    quiet = ["mesh.error_cos=[1e-6]", "mesh.stiffness_cos=[0.0]", "surface.driving.roughness=0.0"]
    parameters = published_gearbox(
        [*quiet, "surface.driven.roughness=0.0", "model=traditional", "operation.speed=100.0"]
    )
    result = measure(parameters, Measurement(200, 40))
    amplitude = result.arrays["dte_spectrum"]
    assert int(np.argmax(amplitude)) == 40  # order 1
    assert amplitude[40] == pytest.approx(
        0.5 * (result.scalars["dte_max"] - result.scalars["dte_min"]), rel=1e-2
    )


def test_another_sweep_or_a_used_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sweep"
    SweepFolder.begin(path, plan())
    with pytest.raises(UsageError, match="exists already: give --resume"):
        SweepFolder.begin(path, plan())
    with pytest.raises(UsageError, match=r"another sweep, which differs in parameters oil\.viscosity"):
        SweepFolder.resume(path, plan(oil__viscosity=0.05))
    with pytest.raises(UsageError, match="another sweep, which differs in direction"):
        SweepFolder.resume(path, plan("up"))
    with pytest.raises(UsageError, match="holds no sweep to resume"):
        SweepFolder.resume(tmp_path, plan())


def test_a_damaged_point_is_told(tmp_path: Path) -> None:
    folder = SweepFolder.begin(tmp_path / "sweep", plan())
    run_in_folder(folder, lambda done: None)
    damaged = tmp_path / "sweep/points/0-0-2.npz"
    damaged.write_bytes(damaged.read_bytes()[:100])
    with pytest.raises(GearboxError, match=r"0-0-2\.npz' is damaged .* remove it and give --resume"):
        folder.dataset()
    damaged.unlink()
    run_in_folder(folder, lambda done: None)
    assert same(folder.dataset(), run(plan()))


def test_a_full_disk_ends_the_sweep_in_words(tmp_path: Path) -> None:
    folder = SweepFolder.begin(tmp_path / "sweep", plan())
    os.chmod(tmp_path / "sweep/points", 0o500)
    if os.access(tmp_path / "sweep/points", os.W_OK):  # root may write everywhere
        (tmp_path / "sweep/points").rmdir()
    with pytest.raises(GearboxError, match="can't write "):
        run_in_folder(folder, lambda done: None, workers=2)


def test_the_command_writes_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "sweep"
    assert sweep_main([*OPTIONS, "--models", "traditional,compared", "--output", str(output)]) == 0
    assert f"{output}/sweep.nc: 10 of 10 points, 0 of which ended early" in capsys.readouterr().out
    with xr.open_dataset(output / "sweep.nc") as stored:
        np.testing.assert_array_equal(stored["dte_max"], run(plan())["dte_max"])
    assert (output / "bifurcation.png").stat().st_size > 10_000
    assert sweep_main([*OPTIONS, "--models", "traditional,compared", "--output", str(output)]) == 2


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("--over", "operation.sped=1,2"), "did you mean operation.speed"),
        (("--keep", "0"), "keep = 0 periods of the mesh: must be 1 to"),
        (("--transient", "-1"), "transient = -1"),
        (("--steps", "30"), "steps = 30"),
        (("--workers", "0"), "--workers = 0: must be 1 to 1024"),
        (("--models", "improved,worse"), "'worse' must be one of"),
        (("--resume",), "holds no sweep to resume"),
    ],
)
def test_bad_options_are_refused_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], error: str
) -> None:
    assert sweep_main([*OPTIONS, "--output", str(tmp_path / "sweep"), *words]) == 2
    told = capsys.readouterr().err
    assert error in told and told.count("\n") == 1
    assert not (tmp_path / "sweep").exists()


def test_ctrl_c_leaves_a_result_that_resume_finishes(tmp_path: Path, process: StartProcess) -> None:
    output = tmp_path / "sweep"
    command = ("sweep", *OPTIONS[:2], "--over", "operation.speed=5000:7000:200rpm", "--transient", "3000")
    running = process(*command, "--output", output)
    until(lambda: len(list(output.glob("points/*.npz"))) >= 3, "some points")
    running.signal(signal.SIGINT)
    assert running.wait() == 130, running.output
    assert "points; --resume computes the others" in running.stderr
    with xr.open_dataset(output / "sweep.nc") as stored:
        done = int((stored["status"] == DONE).sum())
    assert 3 <= done < 200


@pytest.fixture
def cluster(process: StartProcess, tmp_path: Path) -> Iterator[tuple[str, list[Process]]]:
    """Address of a Dask scheduler on 127.0.0.1, and its two worker processes."""
    pytest.importorskip("distributed")
    address = tmp_path / "scheduler.json"
    local = ("--host", "127.0.0.1", "--no-dashboard")
    process(
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        *local,
        "--port",
        "0",
        "--scheduler-file",
        address,
    )
    until(address.exists, "the scheduler")
    place = json.loads(address.read_text())["address"]
    workers = [
        process(
            sys.executable, "-m", "distributed.cli.dask_worker", place, "--nthreads", "1", "--no-dashboard",
            "--host", "127.0.0.1", "--no-nanny", "--local-directory", tmp_path / f"worker{number}",
        )
        for number in range(2)
    ]  # fmt: skip
    yield place, workers


def test_a_cluster_that_loses_a_worker_gives_the_same_numbers(
    cluster: tuple[str, list[Process]], tmp_path: Path
) -> None:
    scheduler, workers = cluster
    swept = plan(over="operation.speed=5000:7000:30rpm", keep=400)
    folder = SweepFolder.begin(tmp_path / "sweep", swept)

    def kill_half_way(done: int) -> None:
        if done == 20:
            workers[0].signal(signal.SIGKILL)

    run_in_folder(folder, kill_half_way, scheduler=scheduler)
    assert same(folder.dataset(), run(swept))


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gear_dynamics_ros.sweeps.workers.CONNECT_TIMEOUT", 0.5)
    with pytest.raises(GearboxError, match=r"the Dask scheduler tcp://127\.0\.0\.1:9 does not answer"):
        run(plan(), scheduler="tcp://127.0.0.1:9")
    with pytest.raises(GearboxError, match="the Dask scheduler nonsense does not answer"):
        run(plan(), scheduler="nonsense")
