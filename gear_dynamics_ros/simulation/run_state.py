"""State of a run: running, paused, or ended for a reason. ``Run`` alone changes it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Ending(Enum):
    """What ended a run."""

    COMPLETED = "completed"  # pacing.duration has been simulated
    STOPPED = "stopped"  # on request
    TRIPPED = "tripped"  # by the model: over-speed, a state that is not finite, centres pressed together
    FAILED = "failed"  # by an error of a sink, or by an overrun with pacing.on_overrun: error


class RunState(NamedTuple):
    """State of a run. ``Run`` replaces it as a whole, so any thread may read it.

    A run that ends while it is paused and stepped is paused again after a reset.
    """

    paused: bool = False
    ending: Ending | None = None
    reason: str = ""  # of the end, for the operator; empty if the run has not ended

    @property
    def ended(self) -> bool:
        """Whether the run needs a reset, or a restored checkpoint, before its next chunk."""
        return self.ending is not None

    @property
    def completed(self) -> bool:
        """Whether ``pacing.duration`` has been simulated without a failure."""
        return self.ending is Ending.COMPLETED

    @property
    def name(self) -> str:
        """One of running, paused, ended."""
        return "ended" if self.ended else "paused" if self.paused else "running"
