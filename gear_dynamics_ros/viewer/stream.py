"""The viewer's thread and queue: the engine hands chunks over and never waits."""

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
from gear_dynamics_ros.system.threads import name_thread

if TYPE_CHECKING:
    import rerun as rr

    from gear_dynamics_ros.viewer.scene import Scene

APPLICATION: Final = "gear_dynamics_ros"
QUEUE_SPAN: Final = 1.0  # s of simulated time that may wait
BATCH_SPAN: Final = 0.25  # s of simulated time drawn at once
IDLE: Final = 0.5  # s of wall time after which less is drawn
FLUSH_INTERVAL: Final = 1.0  # s of wall time
FLUSH_TIMEOUT: Final = 5.0
CLOSE_TIMEOUT: Final = 20.0


class Viewer:
    """Sends chunks to Rerun from a thread of its own.

    Modes (``rerun.mode``): ``save`` writes a new .rrd file, ``serve`` listens on 127.0.0.1, ``connect`` feeds
    a viewer that runs at ``rerun.url`` as soon as it answers. Raises UsageError if Rerun isn't installed, the
    file exists or can't be made, the port is taken, or the URL is none. ``write`` never waits: what finds the
    queue full, or no viewer to connect to, is dropped and counted. What is drawn, and how finely:
    ``viewer.scene``.
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
            self._address = sinks.address(parameters.rerun.url)
            self._sink = rr.GrpcSink(parameters.rerun.url)
        else:
            raise UsageError(f"rerun.mode {parameters.rerun.mode!r} shows nothing: use save, serve, connect")
        self._answers = sinks.answers
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
        """Chunks that were not shown."""
        return self._dropped

    @property
    def queued(self) -> int:
        """Samples waiting to be drawn."""
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
            self._changed.notify()

    def close(self) -> None:
        """Draw what waits, flush, and end the thread; may be called again."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSE_TIMEOUT)

    def _run(self) -> None:
        name_thread()
        try:
            if self._open():
                self._show()
        except Exception as error:  # the gearbox runs on without pictures, whatever Rerun raises
            self._fail(f"viewer stopped: {error}")
        finally:
            # Without this the file's last chunks stay in memory; a sink that is gone can't be flushed.
            with contextlib.suppress(Exception):
                self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
            with contextlib.suppress(Exception):
                self._stream.disconnect()

    def _open(self) -> bool:
        """Start the sink, after a viewer answers if one is to be connected to; False if closed before."""
        while self._address is not None and not self._answers(*self._address):
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
            for run in contiguous(chunks):
                self._scene.draw(run)
            if time.monotonic() - flushed > FLUSH_INTERVAL:
                self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
                flushed = time.monotonic()

    def _take(self) -> list[Chunk]:
        """All that waits once it is worth drawing; empty only when closed and done."""
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


def contiguous(chunks: list[Chunk]) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Samples of ``chunks`` joined, shape (n, 28), cut where one was dropped between them."""
    runs: list[list[Chunk]] = []
    for chunk in chunks:
        if runs and runs[-1][-1].first_sample + len(runs[-1][-1]) == chunk.first_sample:
            runs[-1].append(chunk)
        else:
            runs.append([chunk])
    return [np.concatenate([chunk.samples for chunk in run]) for run in runs]
