"""Runs the command of a program: errors become one line on stderr and an exit code."""

from __future__ import annotations

import argparse
import io
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import nullcontext

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.system.processes import Interruption, end_with_ros2, interruptible

FAILURE = 1
USAGE = 2
SIGNALLED = 128  # added to the number of the signal, as shells do


def open_streams() -> None:
    """Open /dev/null for stdin, stdout and stderr where the caller closed them.

    Otherwise files opened later would get their numbers, and errors be written into these files.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may be no text
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


def run_command(
    command: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser, argv: Sequence[str] | None
) -> int:
    """Parse ``argv`` and run ``command``; returns its exit code.

    If it raises an error: USAGE for UsageError, FAILURE for GearboxError, OSError and a closed stdout,
    SIGNALLED + n for signal n, which ``command`` may note itself; else it is interrupted and cleans up.
    """
    arguments = parser.parse_args(argv)
    return run_reporting(lambda: command(arguments), parser.prog)


def run_reporting(act: Callable[[], int], program: str) -> int:
    """Exit code of ``act``, or of the error that it raises, see ``run_command``.

    The end of a ``ros2`` command that started this program counts as SIGTERM.
    """
    end_with_ros2()
    try:
        with interruptible() if _on_main_thread() else nullcontext():
            return act()
    except UsageError as error:
        print(f"{program}: error: {error}", file=sys.stderr)
        return USAGE
    except BrokenPipeError:
        # The reader of stdout has closed it. Without this, Python reports the error again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILURE
    except (GearboxError, OSError) as error:
        print(f"{program}: error: {error}", file=sys.stderr)
        return FAILURE
    except Interruption as interruption:
        print(f"{program}: interrupted by {interruption}", file=sys.stderr)
        return SIGNALLED + interruption.number


def _on_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
