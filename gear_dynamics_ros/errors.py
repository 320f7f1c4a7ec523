"""Errors that a user can mend: one line that tells name, value, limit and what to do."""


class GearboxError(Exception):
    """A failure while working (exit code 1)."""


class UsageError(GearboxError):
    """A request that can't be meant: a bad option, file or parameter (exit code 2)."""
