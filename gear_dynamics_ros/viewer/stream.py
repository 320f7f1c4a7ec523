"""The viewer's thread and queue: the engine hands chunks over without waiting."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from gear_dynamics_ros.chunk import Chunk
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.system.threads import begin_thread

if TYPE_CHECKING:
    import rerun as rr

    from gear_dynamics_ros.viewer.scene import Scene

APPLICATION: Final = "gear_dynamics_ros"
QUEUE_SPAN: Final = 1.0  # s of simulated time that the queue holds
BATCH_SPAN: Final = 0.25  # s of simulated time drawn at once
IDLE: Final = 0.5  # s of wall time after which a smaller batch is drawn
FLUSH_INTERVAL: Final = 1.0  # s of wall time
FLUSH_TIMEOUT: Final = 5.0
CLOSE_TIMEOUT: Final = 20.0


class Viewer:
    """Sends chunks to Rerun from a thread of its own.

    Modes (``rerun.mode``): ``save`` writes a new .rrd file, ``serve`` listens on 127.0.0.1, ``connect`` sends
    to the viewer at ``rerun.url`` as soon as it answers. Raises UsageError if Rerun isn't installed, the file
    exists or can't be made, the port is taken, or the URL has no host and port. ``write`` never waits: chunks
    are dropped and counted while the queue is full or no viewer answers. ``viewer.scene`` says what is drawn.
    """

    def __init__(self, parameters: Parameters) -> None:
        try:
            from gear_dynamics_ros.viewer import scene, sinks
        except ImportError as error:
            raise UsageError(
                f"rerun.mode is {parameters.rerun.mode}, but Rerun can't be imported ({error}): "
                "pip install rerun-sdk, or set rerun.mode to none"
            ) from error
        import rerun as rr

        self._sink: rr.FileSink | rr.GrpcServerSink | rr.GrpcSink
        self._address: tuple[str, int] | None = None
        if parameters.rerun.mode == "save":
            self._sink = sinks.file_sink(parameters.rerun.path)
        elif parameters.rerun.mode == "serve":
            self._sink = sinks.server_sink(parameters.rerun.port)
        elif parameters.rerun.mode == "connect":
            self._address = sinks.viewer_address(parameters.rerun.url)
            self._sink = rr.GrpcSink(parameters.rerun.url)
        else:
            raise UsageError(f"rerun.mode {parameters.rerun.mode!r} shows nothing: use save, serve, connect")
        self._is_listening = sinks.is_listening
        self._stream = rr.RecordingStream(APPLICATION)
        self._scene: Scene = scene.Scene(self._stream, parameters)
        self._limit = round(QUEUE_SPAN / parameters.solver.sample_interval)
        self._batch = round(BATCH_SPAN / parameters.solver.sample_interval)
        self._waiting: deque[Chunk] = deque()
        self._waiting_samples = 0
        self._closing = False
        self._changed = threading.Condition()
        self._dropped = 0
        self._error: str | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

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
            full = self._waiting and self._waiting_samples + len(chunk) > self._limit
            if full or self._closing or self._error is not None:
                self._dropped += 1
                return
            self._waiting.append(chunk)
            self._waiting_samples += len(chunk)
            # Woken up for each chunk, the thread would take the lock of Python from the engine as often.
            if len(self._waiting) == 1 or self._waiting_samples >= self._batch:
                self._changed.notify()

    def close(self) -> None:
        """Draw what is queued, flush, and end the thread; may be called again."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSE_TIMEOUT)

    def _run(self) -> None:
        begin_thread()
        try:
            if self._open():
                self._show()
        except Exception as error:  # whatever Rerun raises, the gearbox goes on
            self._fail(f"viewer stopped: {error}")
        finally:
            # Without a flush the last chunks never reach the file; flushing a lost connection raises.
            with contextlib.suppress(Exception):
                self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
            with contextlib.suppress(Exception):
                self._stream.disconnect()

    def _open(self) -> bool:
        """Start the sink, in mode ``connect`` once the viewer answers; False if closed before that."""
        while self._address is not None and not self._is_listening(*self._address):
            with self._changed:
                self._drop_waiting()
                if self._closing:
                    return False
                self._changed.wait_for(lambda: self._closing, timeout=FLUSH_INTERVAL)
        self._stream.set_sinks(self._sink, default_blueprint=self._scene.layout())
        self._scene.draw_fixed()
        return True

    def _show(self) -> None:
        flushed = time.monotonic()
        while chunks := self._take():
            for samples in contiguous_blocks(chunks):
                self._scene.draw(samples)
            if time.monotonic() - flushed > FLUSH_INTERVAL:
                self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
                flushed = time.monotonic()

    def _take(self) -> list[Chunk]:
        """Everything queued, once a batch is complete or IDLE is over; empty only when closed and done."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing)
            self._changed.wait_for(lambda: self._closing or self._waiting_samples >= self._batch, IDLE)
            chunks = list(self._waiting)
            self._waiting.clear()
            self._waiting_samples = 0
            return chunks

    def _drop_waiting(self) -> None:
        self._dropped += len(self._waiting)
        self._waiting.clear()
        self._waiting_samples = 0

    def _fail(self, reason: str) -> None:
        with self._changed:
            self._error = reason
            self._drop_waiting()


def contiguous_blocks(chunks: list[Chunk]) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """The samples of ``chunks``, joined up to where a chunk is missing; shape (n, 28) each."""
    runs: list[list[Chunk]] = []
    for chunk in chunks:
        if runs and runs[-1][-1].first_sample + len(runs[-1][-1]) == chunk.first_sample:
            runs[-1].append(chunk)
        else:
            runs.append([chunk])
    return [np.concatenate([chunk.samples for chunk in run]) for run in runs]
