"""How processes end: signals, and the end of the `ros2 run` that started the node."""

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
    """The signals that came, which so break nothing off by themselves: look there between short waits.

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
    """SIGINT, SIGTERM and SIGHUP, told on a thread of their own; all after the first are ignored.

    To be made on the main thread. Until ``hand_to`` is called there is nothing to finish, and a signal ends
    the process at once with exit code 0. Works where the shell has SIGINT ignored for a process in the
    background; SIGHUP stays ignored under nohup.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stop: Callable[[str], None] | None = None
        # Python's handlers wait until the main thread leaves rclpy's wait; the wakeup socket has the signal
        # at once, whichever thread the system gave it to.
        self._receiver, self._sender = socket.socketpair()
        self._sender.setblocking(False)
        signal.set_wakeup_fd(self._sender.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _leave_it_to_the_socket)
        threading.Thread(target=self._work, name="signals", daemon=True).start()

    def hand_to(self, stop: Callable[[str], None]) -> None:
        """From now on call ``stop`` with the signal's name, on the thread of the signals."""
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
    """Keep the signal from ending the process."""


class Parent:
    """The ``ros2 run`` that started this process: SIGTERM to it ends it and leaves this process an orphan.

    Only such a parent is watched. Any other may end, as a shell does after ``nohup gearbox &``. Needs /proc.
    """

    def __init__(self) -> None:
        self._pid = os.getppid()
        self._watched = _is_ros2_run(self._pid)

    def gone(self) -> bool:
        """Whether it was there and is no more."""
        return self._watched and os.getppid() != self._pid


def _is_ros2_run(pid: int) -> bool:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return False
    names = [Path(word).name for word in words[:2]]
    return "ros2" in names and "run" in words[1:3]
