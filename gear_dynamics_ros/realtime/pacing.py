"""Pacing: at which wall time the next chunk is due, and how well these deadlines are kept."""

from __future__ import annotations

from typing import NamedTuple

from gear_dynamics_ros.parameters import PacingParameters


class Pace(NamedTuple):
    """Figures between two reports; ``overruns`` and ``slipped`` are totals since the start."""

    real_time_factor: float  # reached
    overruns: int  # chunks that were not finished when the next was due
    worst_lateness: float  # s, largest delay of the start of a chunk after it was due
    slipped: float  # s, by which deadlines were moved


class Pacer:
    """Deadlines of chunks at a real-time factor. All wall times are ns of one monotonic clock.

    A chunk is due when the wall clock has reached its end, so that no stamp lies in the future. With factor 0
    each chunk is due at once. Deadlines are computed from the last ``restart``, so that late wake-ups do not
    add up. A chunk that is not finished when the next is due is an overrun: all later deadlines move by the
    lateness, except for the part that ``pacing.on_overrun: catch_up`` lets the next chunks recover.
    """

    def __init__(self, pacing: PacingParameters, now_ns: int) -> None:
        self._overruns = 0
        self._worst_ns = 0
        self._slipped_ns = 0
        self.change(pacing, now_ns)

    def change(self, pacing: PacingParameters, now_ns: int) -> None:
        """Use the settings ``pacing`` from ``now_ns`` on."""
        self._factor = pacing.real_time_factor
        self._allowed_ns = round(pacing.catch_up_limit * 1e9) if pacing.on_overrun == "catch_up" else 0
        self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """Compute deadlines, and the next report, from ``now_ns`` on, as after a pause."""
        self._base_ns = self._report_began_ns = now_ns
        self._simulated_ns = self._report_simulated_ns = 0

    def excuse(self, time_ns: int) -> None:
        """Move deadlines by ``time_ns`` that a request took, except for the part that may be recovered."""
        self._slip(time_ns - self._allowed_ns)

    def wait_ns(self, chunk_ns: int, now_ns: int) -> int:
        """Wall time in ns until the chunk of ``chunk_ns`` is due; 0 if it is due already."""
        if self._factor == 0.0:
            return 0
        return max(0, self._due_ns(chunk_ns) - now_ns)

    def chunk_started(self, chunk_ns: int, now_ns: int) -> None:
        """Note that a chunk of ``chunk_ns`` starts."""
        if self._factor != 0.0:
            self._worst_ns = max(self._worst_ns, now_ns - self._due_ns(chunk_ns))

    def chunk_finished(self, chunk_ns: int, now_ns: int) -> int:
        """Note that a chunk of ``chunk_ns`` is finished; returns the lateness of the next one in ns, or 0."""
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
