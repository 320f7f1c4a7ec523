"""Condition of the machine over the last second of simulated time: meshing, transmission error, bearings."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import COLUMN, ENERGIES
from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.messages.encoder import Record

INTERVALS: Final = 50
INTERVAL_NS: Final = 20_000_000
_MESH_LOSS: Final = [energy.name for energy in ENERGIES].index("mesh_loss")


class Condition(NamedTuple):
    """Figures from the samples of the last second of simulated time."""

    span: float  # time evaluated, s; less than a second after the start, a reset or a restore
    dte_mean: float  # m, of the dynamic transmission error
    dte_rms: float  # m, its mean included
    drive_share: float  # of the samples, with the drive flanks in mesh
    apart_share: float  # loss of contact
    back_share: float
    driving_peak_force: float  # N, greatest bearing force, contact and film
    driven_peak_force: float  # N
    drive_power: float  # W, mean power of the drive torque
    mesh_loss: float  # W, mean power lost in the mesh


class _Totals(NamedTuple):
    samples: int
    time_ns: int
    dte_sum: float
    dte_squares: float
    drive: int
    back: int
    peaks: tuple[float, float]
    drive_work: float  # J
    mesh_loss: float  # J


class ConditionSink:
    """Evaluates the condition of a run; ``report`` may be called from another thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._intervals: deque[_Totals] = deque(maxlen=INTERVALS)
        self._chunks: list[Chunk] = []
        self._mesh_loss = 0.0  # J at the end of the last interval

    def wanted(self) -> Collection[str]:
        return ()

    def write(self, chunk: Chunk | None, _: Sequence[Record]) -> None:
        if chunk is None or not len(chunk):
            return
        self._chunks.append(chunk)
        # Several chunks are evaluated at once, because each evaluation takes a dozen calls of NumPy. They are
        # not too many, so that the evaluation does not delay the present chunk.
        if chunk.last_ns - self._chunks[0].start_ns + chunk.interval_ns >= INTERVAL_NS:
            totals = self._evaluate()
            with self._lock:
                self._intervals.append(totals)

    def close(self) -> None:
        """Nothing to finish."""

    def clear(self, mesh_loss: float) -> None:
        """Start again after a reset or a restore; ``mesh_loss`` is the present value of that energy, J.

        On the thread that writes.
        """
        self._chunks.clear()
        self._mesh_loss = mesh_loss
        with self._lock:
            self._intervals.clear()

    def report(self) -> Condition | None:
        """Figures of the last second; None before the end of the first interval."""
        with self._lock:
            intervals = list(self._intervals)
        if not intervals:
            return None
        samples = sum(totals.samples for totals in intervals)
        span = sum(totals.time_ns for totals in intervals) * 1e-9
        mean = math.fsum(totals.dte_sum for totals in intervals) / samples
        square = sum(totals.dte_squares for totals in intervals) / samples
        drive = sum(totals.drive for totals in intervals) / samples
        back = sum(totals.back for totals in intervals) / samples
        return Condition(
            span=span,
            dte_mean=mean,
            dte_rms=math.sqrt(square),
            drive_share=drive,
            apart_share=1.0 - drive - back,
            back_share=back,
            driving_peak_force=max(totals.peaks[0] for totals in intervals),
            driven_peak_force=max(totals.peaks[1] for totals in intervals),
            drive_power=sum(totals.drive_work for totals in intervals) / span,
            mesh_loss=sum(totals.mesh_loss for totals in intervals) / span,
        )

    def _evaluate(self) -> _Totals:
        """Totals over the chunks that wait for evaluation."""
        chunks, self._chunks = self._chunks, []
        rows = np.concatenate([chunk.samples for chunk in chunks])
        dte, state = rows[:, COLUMN["dte"]], rows[:, COLUMN["meshing_state"]]
        interval = chunks[0].interval_ns * 1e-9
        power = np.dot(rows[:, COLUMN["drive_torque"]], rows[:, COLUMN["driving_speed"]])
        before, self._mesh_loss = self._mesh_loss, float(chunks[-1].energies[_MESH_LOSS])
        return _Totals(
            samples=len(rows),
            time_ns=len(rows) * chunks[0].interval_ns,
            dte_sum=float(dte.sum()),
            dte_squares=float(np.dot(dte, dte)),
            drive=int(np.count_nonzero(state > 0.0)),
            back=int(np.count_nonzero(state < 0.0)),
            peaks=(_peak_force(rows, "driving"), _peak_force(rows, "driven")),
            drive_work=float(power) * interval,
            mesh_loss=self._mesh_loss - before,
        )


def _peak_force(rows: NDArray[np.float64], gear: str) -> float:
    x, y = (
        rows[:, COLUMN[f"{gear}_contact_force_{axis}"]] + rows[:, COLUMN[f"{gear}_film_force_{axis}"]]
        for axis in ("x", "y")
    )
    return float(np.sqrt((x * x + y * y).max()))
