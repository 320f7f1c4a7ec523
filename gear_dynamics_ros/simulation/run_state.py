"""State of a run: running, paused, or ended for a reason. ``Run`` alone changes it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Ending(Enum):
    """What ended a run."""

    COMPLETED = "completed"  # pacing.duration has been simulated
    STOPPED = "stopped"  # on request
    TRIPPED = "tripped"  # by the engine: over-speed, a state that is not finite, centres pressed together
    FAILED = "failed"  # by an error of a sink, or by an overrun that pacing.on_overrun makes one


class RunState(NamedTuple):
    """State of a run. ``Run`` replaces it as a whole, so any thread may read it.

    A run that is paused and ends while it is stepped is paused again after a reset.
    """

    paused: bool = False
    ending: Ending | None = None
    reason: str = ""  # of the end, for the operator; empty while the run goes on

    @property
    def ended(self) -> bool:
        """Whether no chunk can be made before a reset or a restored checkpoint."""
        return self.ending is not None

    @property
    def completed(self) -> bool:
        """Whether ``pacing.duration`` has been simulated, and nothing failed."""
        return self.ending is Ending.COMPLETED

    @property
    def name(self) -> str:
        """One of running, paused, ended."""
        return "ended" if self.ended else "paused" if self.paused else "running"
