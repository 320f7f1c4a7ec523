"""The viewer's thread and queue: the engine hands chunks and events over without waiting."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import one_line
from gear_dynamics_ros.events import OperatorEvent
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.system.threads import begin_thread

if TYPE_CHECKING:
    from gear_dynamics_ros.viewer.run_display import RunDisplay

QUEUE_SPAN: Final = 2.0  # s of simulated time that the queue holds
BATCH_SPAN: Final = 0.5  # s of simulated time drawn at once
IDLE: Final = 0.5  # s of wall time after which a smaller batch is drawn
FLUSH_INTERVAL: Final = 1.0  # s of wall time
FLUSH_TIMEOUT: Final = 5.0
CLOSE_TIMEOUT: Final = 20.0


class PaceReport(NamedTuple):
    """What the pacing reached."""

    time: float  # s, simulated
    real_time_factor: float


class Viewer:
    """Sends chunks to Rerun from a thread of its own.

    Modes (``rerun.mode``): ``save`` writes a new .rrd file, ``serve`` listens on 127.0.0.1 and hosts a web
    page there, ``connect`` sends to the viewer at ``rerun.url`` as soon as it answers. Raises UsageError if
    the file exists or can't be made, a port is taken, or the URL has no host and port.
    ``write`` never waits: chunks are dropped and counted while the queue is full or no viewer answers.
    ``viewer.run_display`` says what is drawn.
    """

    def __init__(self, parameters: Parameters) -> None:
        from gear_dynamics_ros.viewer import destinations

        self._destination = destinations.destination(parameters)
        self._display: RunDisplay = self._destination.display
        self._limit = round(QUEUE_SPAN / parameters.solver.sample_interval)
        self._batch = round(BATCH_SPAN / parameters.solver.sample_interval)
        self._waiting: deque[Chunk | OperatorEvent | PaceReport] = deque()
        self._waiting_samples = 0
        self._closing = False
        self._changed = threading.Condition()
        self._dropped = 0
        self._error: str | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where to look at the run: a file or a URL."""
        return self._destination.address

    @property
    def dropped(self) -> int:
        """Number of chunks that were not shown."""
        return self._dropped

    @property
    def queued(self) -> int:
        """Number of samples waiting to be drawn."""
        return self._waiting_samples

    @property
    def error(self) -> str | None:
        """Why nothing is shown any more, or None."""
        return self._error

    def write(self, chunk: Chunk) -> None:
        """Hand one chunk over; returns at once."""
        with self._changed:
            full = self._waiting_samples and self._waiting_samples + len(chunk) > self._limit
            if full or self._stopped:
                self._dropped += 1
                return
            self._waiting.append(chunk)
            woken = self._waiting_samples == 0
            self._waiting_samples += len(chunk)
            # Woken up for each chunk, the thread would take the lock of Python from the engine as often.
            if woken or self._waiting_samples >= self._batch:
                self._changed.notify()

    def write_event(self, event: OperatorEvent) -> None:
        """Hand an operator event over; returns at once."""
        self._append(event)

    def write_pace(self, time: float, real_time_factor: float) -> None:
        """Hand over what the pacing reached at the simulated ``time``, s; returns at once."""
        self._append(PaceReport(time, real_time_factor))

    def close(self) -> None:
        """Draw what is queued, flush, and end the thread; may be called again."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSE_TIMEOUT)
        self._destination.close()

    def _append(self, report: OperatorEvent | PaceReport) -> None:
        with self._changed:
            if not self._stopped:
                self._waiting.append(report)
                self._changed.notify()

    @property
    def _stopped(self) -> bool:
        return self._closing or self._error is not None

    def _run(self) -> None:
        begin_thread()
        try:
            if self._open():
                self._show()
        except Exception as error:  # whatever Rerun raises, the gearbox goes on
            self._fail(f"viewer stopped: {one_line(error)}")
        finally:
            # Without a flush the last chunks never reach the file; flushing a lost connection raises.
            with contextlib.suppress(Exception):
                self._destination.flush(FLUSH_TIMEOUT)
            with contextlib.suppress(Exception):
                self._destination.disconnect()

    def _open(self) -> bool:
        """Start the sink, in mode ``connect`` once the viewer answers; False if closed before that."""
        while not self._destination.ready():
            with self._changed:
                self._drop_waiting()
                if self._closing:
                    return False
                self._changed.wait_for(lambda: self._closing, timeout=FLUSH_INTERVAL)
        self._destination.open()
        return True

    def _show(self) -> None:
        from gear_dynamics_ros.viewer.run_block import blocks_of

        sent = flushed = time.monotonic()
        while waiting := self._take():
            for item in waiting:
                if isinstance(item, OperatorEvent):
                    self._display.log_event(item)
                elif isinstance(item, PaceReport):
                    self._display.draw_pace(item.time, item.real_time_factor)
            for block in blocks_of([item for item in waiting if isinstance(item, Chunk)]):
                self._display.draw(block)
            now = time.monotonic()
            if now - sent >= self._destination.send_interval:
                self._display.canvas.send()
                sent = now
            if now - flushed > FLUSH_INTERVAL:
                self._destination.flush(FLUSH_TIMEOUT)
                flushed = now
        self._display.finish()
        self._display.canvas.send()

    def _take(self) -> list[Chunk | OperatorEvent | PaceReport]:
        """Everything queued, once a batch is complete or IDLE is over; empty only when closed and done."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing)
            self._changed.wait_for(lambda: self._closing or self._waiting_samples >= self._batch, IDLE)
            waiting = list(self._waiting)
            self._waiting.clear()
            self._waiting_samples = 0
            return waiting

    def _drop_waiting(self) -> None:
        self._dropped += sum(isinstance(item, Chunk) for item in self._waiting)
        self._waiting.clear()
        self._waiting_samples = 0

    def _fail(self, reason: str) -> None:
        with self._changed:
            self._error = reason
            self._drop_waiting()
