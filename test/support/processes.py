"""Commands that tests start, wait for and end."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import pytest

from support.paths import TESTS


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


@contextmanager
def processes() -> Iterator[StartProcess]:
    """``start("simulate", "--help")`` starts a command; all of them are ended with the context."""
    with ExitStack() as started:

        def start(*command: str | Path, directory: Path | None = None, **environment: str) -> Process:
            name, *arguments = map(str, command)
            path = name if os.sep in name else executable(name)
            process = Process([path, *arguments], environment, directory)
            started.callback(process.stop)
            return process

        yield start


def run_python(code: str, *arguments: object, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in an interpreter of its own that finds this package of helpers, to its end."""
    return subprocess.run(
        python_command(code, *arguments),
        env=os.environ | {"PYTHONPATH": python_path()},
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def python_command(code: str, *arguments: object) -> list[str]:
    return [sys.executable, "-c", code, *map(str, arguments)]


def python_path() -> str:
    """PYTHONPATH of a process that imports this package of helpers."""
    known = os.environ.get("PYTHONPATH")
    return os.pathsep.join([str(TESTS), *([known] if known else [])])


def until(condition: Callable[[], object], what: str, timeout: float = 60.0) -> None:
    """Wait until ``condition`` holds; fails the test, naming ``what``, if it never does."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"not within {timeout:g} s: {what}")
        time.sleep(0.01)
