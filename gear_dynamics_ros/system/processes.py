"""Signals to this process, and the end of the ``ros2`` command that started it."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final

from gear_dynamics_ros.system.threads import begin_thread

# Signals that ask a program to end.
END_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# s in which further signals do not disturb the cleaning up after the first.
UNDISTURBED: Final = 2.0
_PR_SET_PDEATHSIG: Final = 1  # of prctl(2)


class Interruption(KeyboardInterrupt):
    """A signal asked this process to end."""

    def __init__(self, number: int) -> None:
        """``number`` is that of the signal."""
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def noted_signals() -> Iterator[list[int]]:
    """List of the END_SIGNALS received in the block; they interrupt nothing, so check it regularly.

    SIGHUP stays ignored under nohup. For the main thread.
    """
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)

    with _handled_by(note, [number for number in END_SIGNALS if not _is_ignored_hangup(number)]):
        yield received


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise Interruption in the block at the END_SIGNALS, so that it cleans up, and so for each again later.

    Signals that have a handler already, or are ignored, are left alone. For the main thread.
    """
    last = -math.inf

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > UNDISTURBED:
            last = now
            raise Interruption(number)

    defaults = (signal.SIG_DFL, signal.default_int_handler)
    with _handled_by(interrupt, [number for number in END_SIGNALS if signal.getsignal(number) in defaults]):
        yield


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None], numbers: Sequence[int]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def ignore_signals() -> None:
    """Ignore the END_SIGNALS until the process ends. For the main thread.

    Call it when the exit code is decided: Python takes a while to end, and a signal would replace the code.
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _is_ignored_hangup(number: int) -> bool:
    return number == signal.SIGHUP and signal.getsignal(number) is signal.SIG_IGN


class Signals:
    """Reports the first SIGINT, SIGTERM or SIGHUP on its own thread; further ones are ignored.

    Create it on the main thread. Until ``report_to`` is called there is nothing to finish: a signal ends the
    process at once with exit code 0. SIGINT works also for a background process that the shell started with
    SIGINT ignored; SIGHUP stays ignored under nohup.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stop: Callable[[str], None] | None = None
        # Python calls a handler only after the main thread leaves the wait of rclpy. The wakeup socket gets
        # the signal at once, on whichever thread it arrives.
        self._receiver, self._sender = socket.socketpair()
        self._sender.setblocking(False)
        signal.set_wakeup_fd(self._sender.fileno(), warn_on_full_buffer=False)
        for number in END_SIGNALS:
            if not _is_ignored_hangup(number):
                signal.signal(number, _leave_it_to_the_socket)
        threading.Thread(target=self._work, name="signals", daemon=True).start()

    def report_to(self, stop: Callable[[str], None]) -> None:
        """From now on call ``stop`` with the name of the signal, on the thread of the signals."""
        with self._lock:
            self._stop = stop

    def _work(self) -> None:
        begin_thread()
        while number := self._receiver.recv(1):
            with self._lock:
                stop = self._stop
                if stop is None:
                    os._exit(0)
            stop(signal.Signals(number[0]).name)


def _leave_it_to_the_socket(number: int, frame: FrameType | None) -> None:
    """Do nothing; without a handler the signal would end the process."""


def end_with_ros2() -> None:
    """Have SIGTERM sent to this process when the ``ros2 run`` or ``ros2 launch`` that started it ends.

    They do not pass a SIGTERM on, so that this process would go on unseen. Other parents may end, as a shell
    does after ``nohup gearbox &``. On Linux only.
    """
    parent = os.getppid()
    if sys.platform != "linux" or not _is_ros2(parent):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM))
    if os.getppid() != parent:  # it ended before the call
        os.kill(os.getpid(), signal.SIGTERM)


def start_child(words: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a silent program that, on Linux, ends with the thread that calls this, however that ends.

    Raises OSError if there is no such program.
    """
    if not os.access(words[0], os.X_OK):
        raise FileNotFoundError(f"{words[0]} is no program")
    launcher = (
        "import ctypes, os, sys\n"
        f"if sys.platform == 'linux': ctypes.CDLL(None).prctl({_PR_SET_PDEATHSIG}, {int(signal.SIGTERM)})\n"
        "os.execv(sys.argv[1], sys.argv[1:])"
    )
    # -S leaves out site-packages, which this program doesn't need and which may take long to import.
    return subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", launcher, *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _is_ros2(pid: int) -> bool:
    """Whether the process is ``ros2 run`` or ``ros2 launch``, or ``launch_test``, which is alike."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return False
    names = [Path(word).name for word in words[:2]]
    return "launch_test" in names or ("ros2" in names and not {"run", "launch"}.isdisjoint(words[1:3]))
