"""Shared fixtures: a ROS domain of one's own, and processes that are always ended."""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import subprocess
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import hypothesis
import pytest

# On Linux, domains above 101 share their UDP ports with the ephemeral range.
DOMAINS = range(1, 102)

hypothesis.settings.register_profile("suite", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("suite")


def executable(name: str) -> str:
    """Path of an installed console script, of this interpreter if it has one."""
    own = Path(sysconfig.get_path("scripts")) / name
    found = str(own) if own.exists() else shutil.which(name)
    if found is None:
        pytest.fail(f"{name}: not installed: run make setup")
    return found


class Process:
    """A command in a process group of its own, its output collected line by line as it comes."""

    def __init__(
        self, command: list[str], environment: dict[str, str], directory: Path | None = None
    ) -> None:
        self.command = command
        self._lines: list[tuple[str, str]] = []
        self._changed = threading.Condition()
        self._child = subprocess.Popen(
            command,
            env=os.environ | environment,
            cwd=directory,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self._child.stdout is not None and self._child.stderr is not None
        streams = {"stdout": self._child.stdout, "stderr": self._child.stderr}
        self._readers = [
            threading.Thread(target=self._read, args=item, daemon=True) for item in streams.items()
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, name: str, stream: IO[str]) -> None:
        for line in stream:
            with self._changed:
                self._lines.append((name, line))
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def _text(self, *names: str) -> str:
        with self._changed:
            return "".join(line for name, line in self._lines if name in names)

    @property
    def pid(self) -> int:
        return self._child.pid

    @property
    def returncode(self) -> int | None:
        """Exit code, negative for a signal; None while the command runs."""
        return self._child.poll()

    @property
    def stdout(self) -> str:
        return self._text("stdout")

    @property
    def stderr(self) -> str:
        return self._text("stderr")

    @property
    def output(self) -> str:
        """Both streams, in the order their lines came."""
        return self._text("stdout", "stderr")

    def wait_for(self, text: str, timeout: float = 60.0) -> str:
        """Wait until ``text`` stands in the output; returns the output, fails the test if it never comes."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            ended = not any(reader.is_alive() for reader in self._readers)
            if ended and text not in self.output:
                pytest.fail(
                    f"{self.command[0]} ended ({self._child.wait()}) without {text!r}:\n{self.output}"
                )
            if time.monotonic() > deadline:
                pytest.fail(f"{self.command[0]}: no {text!r} within {timeout} s:\n{self.output}")
            with self._changed:
                self._changed.wait(0.05)
        return self.output

    def wait(self, timeout: float = 60.0) -> int:
        """Wait for the end and all output; returns the exit code, fails the test if it does not come."""
        try:
            code = self._child.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.command[0]}: still running after {timeout} s:\n{self.output}")
        for reader in self._readers:
            reader.join(5.0)
        return code

    def signal(self, number: int) -> None:
        """Signal to the command alone."""
        self._child.send_signal(number)

    def signal_group(self, number: int) -> None:
        """Signal to the command and all its children, as Ctrl-C in a terminal does."""
        try:
            os.killpg(self._child.pid, number)
        except ProcessLookupError:
            return

    def stop(self, patience: float = 10.0) -> int:
        """End the command: SIGINT, and SIGKILL to the group if it does not go; returns the exit code."""
        if self._child.poll() is None:
            self.signal_group(signal.SIGINT)
        try:
            code = self._child.wait(patience)
        except subprocess.TimeoutExpired:
            code = None
        # Children of the command may outlive it.
        self.signal_group(signal.SIGKILL)
        return self.wait() if code is None else code


StartProcess = Callable[..., Process]
Rerun = Callable[..., str]


@contextmanager
def _processes() -> Iterator[StartProcess]:
    with ExitStack() as started:

        def start(*command: str | Path, directory: Path | None = None, **environment: str) -> Process:
            name, *arguments = map(str, command)
            path = name if os.sep in name else executable(name)
            process = Process([path, *arguments], environment, directory)
            started.callback(process.stop)
            return process

        yield start


@contextmanager
def _domain() -> Iterator[int]:
    """Reserve a domain against every other test on this machine, for this process and its children."""
    with ExitStack() as held:
        lock = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        environment = held.enter_context(pytest.MonkeyPatch.context())
        for domain in random.Random().sample(DOMAINS, len(DOMAINS)):
            try:
                lock.bind(f"\0gear_dynamics_ros.test.domain.{domain}")
            except OSError:
                continue
            environment.setenv("ROS_DOMAIN_ID", str(domain))
            environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            yield domain
            return
        pytest.fail(f"all {len(DOMAINS)} ROS domains are taken by other tests")


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
    with _processes() as start:
        yield start


@pytest.fixture(scope="module")
def module_process() -> Iterator[StartProcess]:
    """As ``process``, ended with the module."""
    with _processes() as start:
        yield start


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """A ROS domain of this test's own, in the environment of this process and of those it starts."""
    with _domain() as domain:
        yield domain


@pytest.fixture(scope="module")
def module_ros_domain() -> Iterator[int]:
    """As ``ros_domain``, for a module. Name it before ``module_process``: a domain outlives its processes."""
    with _domain() as domain:
        yield domain
