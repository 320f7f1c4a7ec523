"""Odd surroundings: names that are not text, closed streams, no place for logs, a clock beyond ROS."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from support.processes import StartProcess, executable

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
    with pytest.raises(GearboxError, match=r"2147483648 s since 1970 does not fit .*: set the clock"):
        Encoder(Parameters(), last + 1)
