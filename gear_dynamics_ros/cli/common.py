"""The edge of every command: errors become one line on stderr and an exit code."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence

from gear_dynamics_ros.errors import GearboxError, UsageError

FAILURE = 1
USAGE = 2
SIGNALLED = 128  # what shells add to the number of a signal
INTERRUPTED = SIGNALLED + signal.SIGINT


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Let ``--set`` override parameters."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="override a parameter; may be repeated",
    )


def guarded(
    command: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser, argv: Sequence[str] | None
) -> int:
    """Parse ``argv`` and run ``command`` on it; returns the exit code."""
    arguments = parser.parse_args(argv)
    try:
        return command(arguments)
    except UsageError as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return USAGE
    except BrokenPipeError:
        # Whoever read our output has enough; Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILURE
    except (GearboxError, OSError) as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return FAILURE
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        return INTERRUPTED


class Progress:
    """A line of progress on stderr while a terminal watches; silent otherwise."""

    def __init__(self, verb: str, total: int) -> None:
        self._verb = verb
        self._total = max(total, 1)
        self._shown = sys.stderr.isatty()
        self._percent = -1

    def __call__(self, done: int) -> None:
        percent = 100 * done // self._total
        if self._shown and percent != self._percent:
            self._percent = percent
            print(f"\r{self._verb} {percent:3d} %", end="", file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._percent >= 0:
            print("\r" + " " * (len(self._verb) + 8) + "\r", end="", file=sys.stderr, flush=True)
