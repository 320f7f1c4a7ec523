"""Fixtures that every test may use: a ROS domain of one's own, and processes that are always ended."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from support.domains import domain
from support.processes import StartProcess, executable, processes
from support.rerun_files import Rerun

# A shell lets its background jobs ignore Ctrl-C, and the processes of the tests would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("suite")


@pytest.fixture(scope="session", autouse=True)
def _log_directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        environment.setenv("MPLBACKEND", "Agg")
        yield


@pytest.fixture(scope="session")
def rerun_command(tmp_path_factory: pytest.TempPathFactory) -> Rerun:
    """``rerun_command("rrd", "stats", path)``: what Rerun's command prints; it reports to nobody."""
    pytest.importorskip("rerun", reason="Rerun is optional at run time")
    home = tmp_path_factory.mktemp("rerun")
    environment = os.environ | {"XDG_CONFIG_HOME": str(home), "XDG_DATA_HOME": str(home)}

    def run(*arguments: str | Path) -> str:
        done = subprocess.run(
            [executable("rerun"), *arguments], env=environment, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("analytics", "disable")
    return run


@pytest.fixture
def process() -> Iterator[StartProcess]:
    """``process("simulate", "--help")`` starts a command; all of them are ended with the test."""
    with processes() as start:
        yield start


@pytest.fixture(scope="module")
def module_process() -> Iterator[StartProcess]:
    """As ``process``, ended with the module."""
    with processes() as start:
        yield start


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """A ROS domain of this test's own, in the environment of this process and of those it starts."""
    with domain() as number:
        yield number


@pytest.fixture(scope="module")
def module_ros_domain() -> Iterator[int]:
    """As ``ros_domain``, for a module. Name it before ``module_process``: a domain outlives its processes."""
    with domain() as number:
        yield number
