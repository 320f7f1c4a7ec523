"""Kinds of operator events: what happens to a run between two samples."""

from __future__ import annotations

# Kinds of events.
START = "start"
RESET = "reset"
PAUSE = "pause"
RESUME = "resume"
CHANGE = "parameters"
RESTORE = "restore"
END = "end"
# All kinds of events.
EVENTS = frozenset({START, RESET, PAUSE, RESUME, CHANGE, RESTORE, END})
