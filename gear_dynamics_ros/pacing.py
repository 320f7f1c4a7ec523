"""Wall time to simulated time: when the next chunk is due, and how well that is kept."""

from __future__ import annotations

from typing import NamedTuple


class Pace(NamedTuple):
    """Figures of one stretch of wall time."""

    real_time_factor: float  # reached
    overruns: int  # chunks that were not done when the next was due
    worst_lateness: float  # s, the latest begin of a chunk after it was due


class Pacer:
    """Deadlines of chunks at a real-time factor; the caller brings the time in ns of a monotonic clock.

    A chunk is due when its last moment has passed on the wall, so that no stamp lies in the future. A chunk
    that comes too late slips: later deadlines move by its lateness, nothing is caught up. With factor 0 each
    is due at once.
    """

    def __init__(self, real_time_factor: float, now_ns: int) -> None:
        self._factor = real_time_factor
        self._stretch_began_ns = now_ns
        self._stretch_simulated_ns = 0
        self._overruns = 0
        self._worst_ns = 0
        self.restart(now_ns)

    def restart(self, now_ns: int, real_time_factor: float | None = None) -> None:
        """Count deadlines from ``now_ns`` on, as after a pause, if wanted with another factor."""
        if real_time_factor is not None:
            self._factor = real_time_factor
        self._base_ns = now_ns
        self._simulated_ns = 0

    def wait_ns(self, chunk_ns: int, now_ns: int) -> int:
        """Wall time until the chunk of ``chunk_ns`` is due; 0 if it is."""
        if self._factor == 0.0:
            return 0
        return max(0, self._due_ns(chunk_ns) - now_ns)

    def begun(self, chunk_ns: int, now_ns: int) -> None:
        """Note that the chunk has been begun."""
        if self._factor != 0.0:
            self._worst_ns = max(self._worst_ns, now_ns - self._due_ns(chunk_ns))

    def done(self, chunk_ns: int, now_ns: int) -> None:
        """Note that the chunk has been made and handed on."""
        self._simulated_ns += chunk_ns
        self._stretch_simulated_ns += chunk_ns
        if self._factor != 0.0 and now_ns > self._due_ns(chunk_ns):
            self._overruns += 1
            self._base_ns += now_ns - self._due_ns(chunk_ns)

    def report(self, now_ns: int) -> Pace:
        """Figures since the last report; overruns are those of all time."""
        elapsed_ns = now_ns - self._stretch_began_ns
        pace = Pace(
            self._stretch_simulated_ns / elapsed_ns if elapsed_ns > 0 else 0.0,
            self._overruns,
            self._worst_ns * 1e-9,
        )
        self._stretch_began_ns = now_ns
        self._stretch_simulated_ns = self._worst_ns = 0
        return pace

    def _due_ns(self, chunk_ns: int) -> int:
        return self._base_ns + round((self._simulated_ns + chunk_ns) / self._factor)
