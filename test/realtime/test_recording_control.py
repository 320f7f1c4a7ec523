"""Recordings of one run, one after another, and the one list of what went wrong with them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime.recording_control import RecordingControl
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import NodeNames
from support.processes import until


def controlled(**values: object) -> tuple[Run, RecordingControl]:
    parameters = Parameters.from_flat({"solver.step": 1e-5, **values})
    run = Run(Engine(parameters), Encoder(parameters, 0))
    return run, RecordingControl(run, 0, NodeNames())


def test_a_refusal_to_begin_stands_in_the_list_once(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    path.mkdir()
    _, control = controlled(**{"recording.path": str(path)})
    for _ in range(2):
        with pytest.raises(UsageError, match="exists already"):
            control.begin(beside=False)
    assert control.errors == (control.refusal,) and str(path) in control.refusal


def test_a_request_that_cannot_be_met_is_no_recording_error(tmp_path: Path) -> None:
    _, control = controlled()
    for ask in (lambda: control.begin(beside=True), control.split, control.cut):
        with pytest.raises(GearboxError):
            ask()
    assert control.end() is None and control.errors == ()
    _, control = controlled(**{"recording.path": str(tmp_path / "bag")})
    control.begin(beside=False)
    with pytest.raises(GearboxError, match="already recording to"):
        control.begin(beside=True)
    recorder = control.end()
    assert recorder is not None and control.close(recorder) == tmp_path / "bag"
    assert control.errors == ()


def test_each_error_stands_once_in_the_order_of_events(tmp_path: Path) -> None:
    run, control = controlled(**{"recording.path": str(tmp_path / "bags" / "bag"), "recording.mode": "ring"})
    (tmp_path / "bags").mkdir()
    control.arm()
    control.begin(beside=True)
    first = control.current
    assert first is not None
    shutil.rmtree(tmp_path / "bags")
    until(lambda: run.step() and control.errors, "an error of the recorder")
    with pytest.raises(GearboxError):
        control.write(control.cut())
    with pytest.raises(GearboxError):
        control.begin(beside=True)  # the first recorder makes way, but the folder is still missing
    (tmp_path / "bags").mkdir()
    control.begin(beside=True)
    second = control.current
    assert second is not None and second is not first and control.refusal == ""
    run.close()
    stopped, missing = control.errors
    assert stopped == first.error and "'" + str(tmp_path / "bags") + "' does not exist" in missing
