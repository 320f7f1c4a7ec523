"""Runs the command of a program: errors become one line on stderr and an exit code."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence

from gear_dynamics_ros.errors import GearboxError, UsageError

FAILURE = 1
USAGE = 2
SIGNALLED = 128  # added to the number of the signal, as shells do
INTERRUPTED = SIGNALLED + signal.SIGINT


def run_command(
    command: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser, argv: Sequence[str] | None
) -> int:
    """Parse ``argv`` and run ``command``; returns its exit code.

    If it raises an error: USAGE for UsageError, FAILURE for GearboxError, OSError and a closed stdout,
    INTERRUPTED for Ctrl-C.
    """
    arguments = parser.parse_args(argv)
    try:
        return command(arguments)
    except UsageError as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return USAGE
    except BrokenPipeError:
        # The reader of stdout has closed it. Without this, Python reports the error again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILURE
    except (GearboxError, OSError) as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return FAILURE
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        return INTERRUPTED
