"""Windows of simulated time that a user asks for."""

from __future__ import annotations

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.recording.reader import Recording


def checked(recording: Recording, start: float | None, end: float | None) -> tuple[int, int]:
    """The samples [first, beyond) at times in [start, end) s, as far as ``recording`` holds them.

    Raises UsageError on a time that is not finite, and on a window that is empty or lies outside.
    """
    first, beyond = recording.clip(start, end)
    if first < beyond or (start is None and end is None):
        return first, beyond
    if start is not None and end is not None and start >= end:
        raise UsageError(f"from {start:.9g} s to {end:.9g} s is no time at all: let it end after it starts")
    interval = recording.parameters.solver.sample_interval
    asked = " ".join(
        f"{word} {time:.9g} s" for word, time in (("from", start), ("to", end)) if time is not None
    )
    raise UsageError(
        f"{recording.path} has no sample {asked}: "
        f"take from {recording.first_sample * interval:.9g} s to {recording.end_sample * interval:.9g} s"
    )
