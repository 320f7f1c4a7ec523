"""A run paced by the wall clock, on a thread of its own; no ROS."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import TypeVar

from gear_dynamics_ros.commands import Mailbox
from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages import Record
from gear_dynamics_ros.pacing import Pace, Pacer
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.run import PAUSE, RESUME, Run
from gear_dynamics_ros.signals import Chunk, Counters
from gear_dynamics_ros.threads import name_thread

PATIENCE = 2.0  # s of silence while the kernel compiles
T = TypeVar("T")
RELEASED = {"drive_torque": 0.0, "load_torque": 0.0}


class Live:
    """Paces a run. Only its thread touches the run; others ask through ``call``, served between chunks."""

    def __init__(
        self,
        run: Run,
        mailbox: Mailbox,
        after_chunk: Callable[[Chunk], Sequence[Record]],
        on_end: Callable[[], None],
    ) -> None:
        """``after_chunk`` may add messages to a chunk's; ``on_end`` is called at the end, on the thread."""
        self.run = run
        self.mailbox = mailbox
        self._after_chunk = after_chunk
        self._on_end = on_end
        self._operation = run.engine.parameters.operation
        solver = run.engine.parameters.solver
        self._interval_ns = solver.sample_interval_ns
        self._chunk_ns = solver.samples_per_chunk * self._interval_ns
        self._pacer = Pacer(run.engine.parameters.pacing.real_time_factor, time.monotonic_ns())
        self._requests: deque[Callable[[], None]] = deque()
        self._wake = threading.Condition()
        self._figures = threading.Lock()
        self._stopping = False
        self._thread: threading.Thread | None = None
        self._paused = False
        self._timed_out = False
        self._failure = ""
        self.counters = Counters(0, 0, 0, 0, 0)

    @property
    def active(self) -> bool:
        """Whether the thread runs."""
        return self._thread is not None

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still on request."""
        return self._paused

    @property
    def time(self) -> float:
        """Simulated time in s."""
        return self.run.engine.sample * self._interval_ns * 1e-9

    @property
    def timed_out(self) -> bool:
        """Whether the last command is older than ``operation.command_timeout``."""
        return self._timed_out

    @property
    def ended(self) -> str:
        """Why the run ended or failed; empty while it can go on."""
        return self._failure or self.run.end

    def start(self) -> None:
        """Begin, or go on where ``stop`` left."""
        self._stopping = False
        now = time.monotonic_ns()
        self._pacer.restart(now)
        self.mailbox.restart(now)
        self._thread = threading.Thread(target=self._work, name="engine", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the chunk in hand and end the thread."""
        if self._thread is None:
            return
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        self._thread.join()
        self._thread = None

    def call(self, action: Callable[[], T]) -> T:
        """Result of ``action``, done on the engine's thread between two chunks; raises what it raises."""
        if not self.active:
            raise GearboxError("the gearbox is not active: activate it first")
        future: Future[T] = Future()

        def serve() -> None:
            try:
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)

        self._request(serve)
        return future.result()

    def post(self, records: Sequence[Record]) -> None:
        """Let ``records`` go to the sinks between two chunks, without waiting for it."""
        self._request(lambda: self.run.emit(records))

    def pause(self, paused: bool) -> bool:
        """Stand still, or go on; returns whether that changed anything. For ``call``."""
        if paused == self._paused:
            return False
        self._paused = paused
        self.run.note(PAUSE if paused else RESUME)
        now = time.monotonic_ns()
        self._pacer.restart(now)
        self.mailbox.restart(now)
        return True

    def single_step(self) -> None:
        """One chunk while paused. For ``call``; raises GearboxError if not paused or ended."""
        if not self._paused:
            raise GearboxError("not paused: ~/step makes one chunk while paused, call ~/pause first")
        self._step()

    def reset(self) -> None:
        """Start state, commands and clockwork of the beginning. For ``call``."""
        now = time.monotonic_ns()
        self._failure = ""
        self._timed_out = False
        self.mailbox.restart(now, forget=True)
        self.run.reset()
        self._pacer.restart(now)

    def set_factor(self, real_time_factor: float) -> None:
        """Go on at another pace from the next chunk edge on."""
        self._request(lambda: self._pacer.restart(time.monotonic_ns(), real_time_factor))

    def pace(self) -> Pace:
        """Figures since the last call."""
        with self._figures:
            return self._pacer.report(time.monotonic_ns())

    def _request(self, action: Callable[[], None]) -> None:
        with self._wake:
            self._requests.append(action)
            self._wake.notify_all()

    def _work(self) -> None:
        name_thread()
        while self._wait():
            try:
                self._step()
            except Exception as error:
                # The node must stay to tell; a reset may recover.
                self._failure = str(error) or repr(error)
                with contextlib.suppress(Exception):  # the sink that failed may fail again
                    self.run.finish(self._failure)
                self._on_end()

    def _wait(self) -> bool:
        """Serve requests until a chunk is due; False if the thread is to end."""
        while True:
            with self._wake:
                if not self._requests and not self._stopping:
                    self._wake.wait(self._patience())
                actions = list(self._requests)
                self._requests.clear()
                stopping = self._stopping
            for action in actions:
                action()
            if stopping:
                return False
            if self._patience() == 0.0:
                return True

    def _patience(self) -> float | None:
        """Wall time until a chunk is due in s; None while there is nothing to do."""
        if self._paused or self.ended:
            return None
        return self._pacer.wait_ns(self._chunk_ns, time.monotonic_ns()) * 1e-9

    def _step(self) -> None:
        now = time.monotonic_ns()
        with self._figures:
            self._pacer.begun(self._chunk_ns, now)
        delivery = self.mailbox.take(now)
        changes = delivery.changes
        timeout = self._operation.command_timeout
        self._timed_out = timeout > 0.0 and delivery.age_ns > timeout * 1e9
        if self._timed_out and self._operation.on_timeout == "release":
            changes = {**changes, **RELEASED}
        commands = self.run.engine.commands._replace(**changes) if changes else None
        chunk = self.run.step(commands, delivery.received)
        self.counters = chunk.counters
        self.run.emit(self._after_chunk(chunk))
        with self._figures:
            self._pacer.done(len(chunk) * self._interval_ns, time.monotonic_ns())
        if self.run.end:
            self._on_end()


def warm_up(parameters: Parameters, say: Callable[[str], object]) -> None:
    """Compile the kernel unless that has been done; ``say`` so, and how long it took, if it takes long."""
    notice = threading.Timer(PATIENCE, say, ["compiling the kernel; only a first start takes this long"])
    notice.daemon = True
    began = time.perf_counter()
    notice.start()
    try:
        Engine(parameters).advance(1)
    finally:
        notice.cancel()
    elapsed = time.perf_counter() - began
    if elapsed > PATIENCE:
        say(f"compiled in {elapsed:.0f} s")
