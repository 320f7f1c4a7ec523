"""The edge of every command: errors become one line on stderr and an exit code."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from gear_dynamics_ros.errors import GearboxError, UsageError

FAILURE = 1
USAGE = 2
INTERRUPTED = 130


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
    except (GearboxError, OSError) as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return FAILURE
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        return INTERRUPTED
