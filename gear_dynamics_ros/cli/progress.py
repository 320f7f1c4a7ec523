"""The one display of progress: a line on stderr, if stderr is a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Self

REDRAW = 0.2  # s of wall time
_CLEAR = "\r\x1b[K"


class ProgressLine:
    """A line on stderr that is rewritten in place and cleared at the end; nothing unless it is a terminal."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._due = 0.0
        self._drawn = False

    def show(self, describe: Callable[[], str]) -> None:
        """Rewrite the line with what ``describe`` returns, at most once every REDRAW."""
        if self._terminal and time.monotonic() >= self._due:
            self._due, self._drawn = time.monotonic() + REDRAW, True
            print(f"{_CLEAR}{describe()}", end="", file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._drawn:
            print(_CLEAR, end="", file=sys.stderr, flush=True)


class Progress(ProgressLine):
    """How much of a known amount of work is done, in per cent."""

    def __init__(self, verb: str, total: int) -> None:
        """``verb`` says what is done; ``total`` is the amount of work in any unit, at least 0."""
        super().__init__()
        self._verb = verb
        self._total = max(total, 1)

    def __call__(self, done: int) -> None:
        """Show that ``done`` of the total is done."""
        self.show(lambda: f"{self._verb} {100 * done // self._total:3d} %")


def stderr_lines(program: str) -> tuple[Callable[[str], None], Callable[[str], None]]:
    """Functions that print what ``program`` says, and what it warns of, as a line on stderr each."""

    def say(line: str) -> None:
        print(f"{program}: {line}", file=sys.stderr)

    return say, lambda line: say(f"warning: {line}")
