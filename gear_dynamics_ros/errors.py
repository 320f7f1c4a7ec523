"""Errors that a user can correct: one line with name, value, limit and what to do."""


class GearboxError(Exception):
    """An operation failed (exit code 1)."""


class UsageError(GearboxError):
    """An invalid request: an option, file or parameter (exit code 2)."""


def one_line(text: object) -> str:
    """``text``, such as an error of a library, with line breaks and repeated spaces as one space."""
    return " ".join(str(text).split())
