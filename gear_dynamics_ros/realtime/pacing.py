"""Wall time to simulated time: when the next chunk is due, and how well that is kept."""

from __future__ import annotations

from typing import NamedTuple

from gear_dynamics_ros.parameters import PacingParameters


class Pace(NamedTuple):
    """Figures of the wall time between two reports; ``overruns`` and ``slipped`` are those of all time."""

    real_time_factor: float  # reached
    overruns: int  # chunks that were not done when the next was due
    worst_lateness: float  # s, the latest end of a chunk's wait after the chunk was due
    slipped: float  # s by which deadlines were put off


class Pacer:
    """Deadlines of chunks at a real-time factor; the caller brings the time in ns of a monotonic clock.

    A chunk is due when its last moment has passed on the wall, so that no stamp lies in the future. With
    factor 0 each is due at once. Deadlines follow from the time of the last ``restart``, so that being woken
    late does not add up. A chunk that is not done when the next is due is an overrun: all later deadlines
    move by the lateness, save what ``pacing.on_overrun: catch_up`` lets the next chunks make good.
    """

    def __init__(self, pacing: PacingParameters, now_ns: int) -> None:
        self._overruns = 0
        self._worst_ns = 0
        self._slipped_ns = 0
        self.change(pacing, now_ns)

    def change(self, pacing: PacingParameters, now_ns: int) -> None:
        """Go on as ``pacing`` says from ``now_ns`` on."""
        self._factor = pacing.real_time_factor
        self._allowed_ns = round(pacing.catch_up_limit * 1e9) if pacing.on_overrun == "catch_up" else 0
        self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """Count deadlines, and the time of the next report, from ``now_ns`` on, as after a pause."""
        self._base_ns = self._report_began_ns = now_ns
        self._simulated_ns = self._report_simulated_ns = 0

    def excuse(self, time_ns: int) -> None:
        """Put deadlines off by ``time_ns`` that something asked for has taken, save what may be caught up."""
        self._slip(time_ns - self._allowed_ns)

    def wait_ns(self, chunk_ns: int, now_ns: int) -> int:
        """Wall time until the chunk of ``chunk_ns`` is due; 0 if it is."""
        if self._factor == 0.0:
            return 0
        return max(0, self._due_ns(chunk_ns) - now_ns)

    def begun(self, chunk_ns: int, now_ns: int) -> None:
        """Note that the chunk has been begun."""
        if self._factor != 0.0:
            self._worst_ns = max(self._worst_ns, now_ns - self._due_ns(chunk_ns))

    def done(self, chunk_ns: int, now_ns: int) -> int:
        """Note that the chunk has been made and handed on; returns by how many ns the next is late, or 0."""
        self._simulated_ns += chunk_ns
        self._report_simulated_ns += chunk_ns
        if self._factor == 0.0:
            return 0
        late_ns = max(0, now_ns - self._due_ns(chunk_ns))
        if late_ns:
            self._overruns += 1
            self._slip(late_ns - self._allowed_ns)
        return late_ns

    def report(self, now_ns: int) -> Pace:
        """Figures since the last report."""
        elapsed_ns = now_ns - self._report_began_ns
        pace = Pace(
            self._report_simulated_ns / elapsed_ns if elapsed_ns > 0 else 0.0,
            self._overruns,
            self._worst_ns * 1e-9,
            self._slipped_ns * 1e-9,
        )
        self._report_began_ns = now_ns
        self._report_simulated_ns = self._worst_ns = 0
        return pace

    def _slip(self, time_ns: int) -> None:
        if time_ns > 0:
            self._base_ns += time_ns
            self._slipped_ns += time_ns

    def _due_ns(self, chunk_ns: int) -> int:
        return self._base_ns + round((self._simulated_ns + chunk_ns) / self._factor)
