"""Signals to this process, and the end of the ``ros2 run`` that started it."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from gear_dynamics_ros.system.threads import name_thread


@contextmanager
def noted_signals() -> Iterator[list[int]]:
    """List of the SIGINT and SIGTERM received in the block; they interrupt nothing, so check it regularly.

    For the main thread.
    """
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _leave_it_to_the_socket)
        threading.Thread(target=self._work, name="signals", daemon=True).start()

    def report_to(self, stop: Callable[[str], None]) -> None:
        """From now on call ``stop`` with the name of the signal, on the thread of the signals."""
        with self._lock:
            self._stop = stop

    def _work(self) -> None:
        name_thread()
        while number := self._receiver.recv(1):
            with self._lock:
                stop = self._stop
                if stop is None:
                    os._exit(0)
            stop(signal.Signals(number[0]).name)


def _leave_it_to_the_socket(number: int, frame: FrameType | None) -> None:
    """Do nothing; without a handler the signal would end the process."""


class Parent:
    """The process that started this one.

    ``ros2 run`` does not pass SIGTERM on: it ends and this process must notice. Other parents may end, as a
    shell does after ``nohup gearbox &``, so only ``ros2 run`` is watched. Needs /proc.
    """

    def __init__(self) -> None:
        self._pid = os.getppid()
        self._watched = _is_ros2_run(self._pid)

    def gone(self) -> bool:
        """Whether the parent was ``ros2 run`` and has ended."""
        return self._watched and os.getppid() != self._pid


def _is_ros2_run(pid: int) -> bool:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return False
    names = [Path(word).name for word in words[:2]]
    return "ros2" in names and "run" in words[1:3]
