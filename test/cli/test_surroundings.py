"""Odd surroundings: names that are not text, closed streams, no place for logs, a clock beyond ROS."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.offline import StrictRecorderSink
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from support.paths import CONFIG
from support.processes import StartProcess, executable

PROFILE = CONFIG / "profiles" / "coast_down.yaml"
SIMULATE = ("--duration", "0.002", "--output")


def run(*words: str | bytes, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """The command's end; the first word is its name."""
    command = [executable(str(words[0])), *words[1:]]
    return subprocess.run(
        command, env=os.environ | environment, capture_output=True, timeout=120, check=False
    )


def test_a_folder_whose_name_is_not_text_can_hold_recordings_but_not_be_one(tmp_path: Path) -> None:
    folder = os.fsencode(tmp_path) + b"/odd\xff"
    os.mkdir(folder)
    strict = {"PYTHONIOENCODING": "utf-8:strict"}
    refused = run("simulate", *SIMULATE, folder + b"/bag\xff", **strict)
    assert refused.returncode == 2 and refused.stderr.count(b"\n") == 1
    assert b"is not UTF-8 text, which metadata.yaml needs: choose another name" in refused.stderr
    assert os.listdir(folder) == []
    for words in (("simulate", *SIMULATE), ("replay", "info"), ("replay", "verify")):
        done = run(*words, folder + b"/bag", **strict)
        assert done.returncode == 0, done.stderr
        assert b"bag" in done.stdout and b"Traceback" not in done.stderr
    missing = run("replay", "info", folder + b"/no", **strict)
    assert missing.returncode == 2 and b"no recording at" in missing.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("gearbox", "--ros-args", "-p", b"recording.path:=odd\xff"),
        ("drive", str(PROFILE), "--ros-args", "-r", b"odd:=odd\xff"),
        ("drive", str(PROFILE), "--node", b"odd\xff"),
    ],
)
def test_names_for_ros_that_are_not_text_are_told(words: tuple[str | bytes, ...]) -> None:
    refused = run(*words)
    assert refused.returncode == 2 and refused.stderr.count(b"\n") == 1
    assert (
        b"odd\\udcff' is not UTF-8 text" in refused.stderr or b"not the name of a ROS node" in refused.stderr
    )


def test_closed_streams_do_no_harm(tmp_path: Path) -> None:
    for words, closed, code in (
        (("simulate", *SIMULATE, str(tmp_path / "bag")), "<&- >&- 2>&-", 0),
        (("replay", "verify", str(tmp_path / "bag")), "2>&-", 0),
        (("replay", "info", str(tmp_path / "none")), "2>&-", 2),
    ):
        line = " ".join([executable(words[0]), *words[1:]])
        done = subprocess.run(["sh", "-c", f"exec {line} {closed}"], capture_output=True, timeout=120)
        assert (done.returncode, done.stderr) == (code, b"")
        assert b"error" not in done.stdout


def test_no_place_for_the_logs_of_ros_is_told_with_a_remedy(
    ros_domain: int, process: StartProcess, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    node = process("gearbox", ROS_LOG_DIR=str(tmp_path / "file"))
    assert node.wait() == 2
    assert node.stderr.count("\n") == 1 and "set ROS_LOG_DIR to a folder that can be written" in node.stderr


def test_a_clock_beyond_the_stamps_of_ros_is_told() -> None:
    last = 2**31 * 10**9 - 1
    Encoder(Parameters(), last)
    beyond = pytest.raises(GearboxError, match=r"2147483648 s since 1970 does not fit .*: set the clock")
    with beyond:
        Encoder(Parameters(), last + 1)
    Encoder(Parameters(), last).require_stampable(0)
    with beyond:
        Encoder(Parameters(), last).require_stampable(1)


def test_a_run_into_2038_ends_in_words_and_its_recording_is_complete(tmp_path: Path) -> None:
    parameters = Parameters()
    chunk_ns = parameters.solver.samples_per_chunk * parameters.solver.sample_interval_ns
    epoch_ns = 2**31 * 10**9 - 2 * chunk_ns
    bag = tmp_path / "bag"
    engine = Engine(parameters)
    recorder = Recorder(bag, engine.checkpoint(), epoch_ns)
    run = Run(engine, Encoder(parameters, epoch_ns), [StrictRecorderSink(recorder, engine)])
    run.step()
    with pytest.raises(GearboxError) as refused:
        run.step()
    run.fail(str(refused.value))
    run.close()
    recorded = recording.open(bag)
    assert recorded.complete and recorded.samples == parameters.solver.samples_per_chunk
    (end,) = [event for event in recorded.events if event.kind == "end"]
    assert "set the clock" in end.message
    assert verify_recording(recorded).difference is None
