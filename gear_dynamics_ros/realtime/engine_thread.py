"""A run paced by the wall clock, on a thread of its own; no ROS."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TypeVar

from gear_dynamics_ros.chunk import Chunk, Counters
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import PAUSE, RESUME
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import OperationParameters, Parameters, updated
from gear_dynamics_ros.realtime.mailbox import Delivery, Mailbox
from gear_dynamics_ros.realtime.pacing import Pace, Pacer
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.system.threads import name_thread

PATIENCE = 2.0  # s of silence while the kernel compiles
T = TypeVar("T")


@dataclass(slots=True)
class Steps:
    """Chunks to make while paused; ``done`` gets the simulated time in s, or why they were given up."""

    chunks: int
    timeout: float  # s of wall time
    began_ns: int
    made: int = 0
    done: Future[float] = field(default_factory=Future)

    def expired(self, now_ns: int) -> bool:
        """Whether the time is up."""
        return now_ns - self.began_ns > self.timeout * 1e9

    def give_up(self, reason: str) -> None:
        """Fail with the reason."""
        self.done.set_exception(GearboxError(f"{reason} after {self.made} of {self.chunks} chunks"))


class Live:
    """Paces a run. Only its thread touches the run; others ask through ``call``, served between chunks."""

    def __init__(
        self,
        run: Run,
        mailbox: Mailbox,
        on_end: Callable[[], None],
    ) -> None:
        """``on_end`` is called at the end, on the thread."""
        self.run = run
        self.mailbox = mailbox
        self._on_end = on_end
        solver = run.engine.parameters.solver
        self._interval_ns = solver.sample_interval_ns
        self._chunk_ns = solver.samples_per_chunk * self._interval_ns
        self._pacer = Pacer(run.engine.parameters.pacing, time.monotonic_ns())
        self._requests: deque[Callable[[], None]] = deque()
        self._wake = threading.Condition()
        self._figures = threading.Lock()
        self._stopping = False
        self._thread: threading.Thread | None = None
        self._paused = False
        self._steps: Steps | None = None
        self._timed_out = False
        self._failure = ""
        self._end_told = False
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
    def failed(self) -> bool:
        """Whether something else than the model ended the run."""
        return bool(self._failure)

    @property
    def ended(self) -> str:
        """Why the run ended or failed; empty while it can go on."""
        return self._failure or self.run.end

    def start(self) -> None:
        """Begin, or go on where ``stop`` left."""
        self._stopping = False
        self.mailbox.forget()
        self._restart_clocks()
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
        """Result of ``action``, done between two chunks; raises what it raises.

        What it takes is no overrun: deadlines slip by it.
        """
        if not self.active:
            return action()
        future: Future[T] = Future()

        def serve() -> None:
            began = time.monotonic_ns()
            try:
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)
            with self._figures:
                self._pacer.excuse(time.monotonic_ns() - began)

        self._request(serve)
        return future.result()

    def post(self, make: Callable[[], Sequence[Record]]) -> None:
        """Let what ``make`` makes go to the sinks between two chunks, without waiting for it."""
        if self.active:
            self._request(lambda: self.run.emit(make()))
        else:
            self.run.emit(make())

    def step(self, chunks: int, timeout: float) -> Future[float]:
        """Make ``chunks`` chunks while paused, as fast as possible; the future gets the simulated time in s.

        Raises GearboxError if the run isn't paused, steps already or has ended; the future fails with it if
        the run is resumed, reset, stopped or ends meanwhile, or after ``timeout`` s of wall time.
        """
        steps = Steps(chunks, timeout, time.monotonic_ns())
        self.call(lambda: self._begin(steps))
        return steps.done

    def pause(self, paused: bool) -> bool:
        """Stand still, or go on; returns whether that changed anything. For ``call``.

        Raises GearboxError if the run has ended.
        """
        self._require_going()
        if paused == self._paused:
            return False
        self._paused = paused
        self._give_up_steps("aborted: resumed")
        self.run.note(PAUSE if paused else RESUME)
        self._restart_clocks()
        return True

    def restart(self, begin: Callable[[], None]) -> None:
        """Let ``begin`` put the run somewhere; clocks and mailbox are as at the beginning. For ``call``."""
        begin()
        self._give_up_steps("aborted: put elsewhere by a reset or a restore")
        self._failure = ""
        self._end_told = False
        self._timed_out = False
        self.mailbox.forget()
        self._restart_clocks()

    def change(self, parameters: Parameters) -> None:
        """Go on with ``parameters``. For ``call``; raises UsageError where one of them is fixed."""
        pacing = self.run.engine.parameters.pacing
        self.run.change(parameters)
        self.mailbox.limit(parameters)
        if parameters.pacing != pacing:
            with self._figures:
                self._pacer.change(parameters.pacing, time.monotonic_ns())

    def pace(self) -> Pace:
        """Figures since the last call."""
        with self._figures:
            return self._pacer.report(time.monotonic_ns())

    @property
    def _operation(self) -> OperationParameters:
        return self.run.engine.parameters.operation

    def _restart_clocks(self) -> None:
        now = time.monotonic_ns()
        with self._figures:
            self._pacer.restart(now)
        self.mailbox.restart(now)

    def _begin(self, steps: Steps) -> None:
        if not self._paused:
            raise GearboxError("not paused: ~/step makes chunks while paused, call ~/pause first")
        self._require_going()
        if self._steps is not None:
            raise GearboxError(
                f"stepping already, {self._steps.made} of {self._steps.chunks} chunks are made: wait for it"
            )
        self._steps = steps

    def _require_going(self) -> None:
        if self.ended:
            raise GearboxError(f"the run has ended ({self.ended}): call ~/reset first")

    def _give_up_steps(self, reason: str) -> None:
        steps, self._steps = self._steps, None
        if steps is not None:
            steps.give_up(reason)

    def _request(self, action: Callable[[], None]) -> None:
        with self._wake:
            self._requests.append(action)
            self._wake.notify_all()

    def _work(self) -> None:
        name_thread()
        while True:
            try:
                if not self._wait():
                    break
                self._make()
            except Exception as error:
                self._fail(error)
            if self.ended and not self._end_told:
                self._end_told = True
                self._give_up_steps(f"aborted: {self.ended}")
                try:
                    self._on_end()
                except Exception as error:
                    self._fail(error)
        self._give_up_steps("aborted: deactivated")

    def _fail(self, error: Exception) -> None:
        """End the run: the node must stay to tell, and a reset may recover."""
        self._failure = self._failure or str(error) or repr(error)
        with contextlib.suppress(Exception):  # the sink that failed may fail again
            self.run.finish(self._failure)

    def _make(self) -> None:
        if self._steps is None:
            self._paced_chunk()
        else:
            self._stepped_chunk(self._steps)

    def _wait(self) -> bool:
        """Serve requests until a chunk is due; False if the thread is to end."""
        while True:
            with self._wake:
                if not self._requests and not self._stopping:
                    self._wake.wait(self._patience())
            # One by one: if one fails, those behind it are still there.
            while self._requests:
                self._requests.popleft()()
            if self._stopping:
                return False
            if self._patience() == 0.0:
                return True

    def _patience(self) -> float | None:
        """Wall time until a chunk is due in s; None while there is nothing to do."""
        if self.ended:
            return None
        if self._paused:
            return None if self._steps is None else 0.0
        return self._pacer.wait_ns(self._chunk_ns, time.monotonic_ns()) * 1e-9

    def _paced_chunk(self) -> None:
        now = time.monotonic_ns()
        with self._figures:
            self._pacer.begun(self._chunk_ns, now)
        delivery = self.mailbox.take(now)
        self._heed_timeout(delivery)
        chunk = self._chunk(delivery)
        with self._figures:
            late_ns = self._pacer.done(len(chunk) * self._interval_ns, time.monotonic_ns())
        if late_ns:
            self._overrun(late_ns)

    def _stepped_chunk(self, steps: Steps) -> None:
        now = time.monotonic_ns()
        if steps.expired(now):
            self._give_up_steps(f"timed out: {steps.timeout:g} s (stepping.timeout) are over")
            return
        self._chunk(self.mailbox.take(now))
        steps.made += 1
        if steps.made == steps.chunks and not self.ended:
            self._steps = None
            steps.done.set_result(self.time)

    def _heed_timeout(self, delivery: Delivery) -> None:
        """Time out when commands cease to come, and again if something else has put torques in force."""
        timeout = self._operation.command_timeout
        before = self._timed_out
        self._timed_out = timeout > 0.0 and not delivery.changes and delivery.age_ns > timeout * 1e9
        if self._timed_out and (not before or self.run.unreleased):
            self.run.time_out()

    def _chunk(self, delivery: Delivery) -> Chunk:
        changes = delivery.changes
        commands = self.run.engine.commands._replace(**changes) if changes else None
        chunk = self.run.step(commands, delivery.received)
        self.counters = chunk.counters
        return chunk

    def _overrun(self, late_ns: int) -> None:
        pacing = self.run.engine.parameters.pacing
        if pacing.on_overrun == "error":
            self.run.finish(
                f"overrun: at {self.time:.9g} s a chunk was {late_ns * 1e-6:.3g} ms late and "
                "pacing.on_overrun = 'error': lower pacing.real_time_factor or take 'slip'"
            )


def warm_up(parameters: Parameters, say: Callable[[str], object]) -> None:
    """Do once all that a run does, so that no chunk pays for what is compiled or loaded at first use.

    ``say`` so, and how long it took, if it takes long: the first time on a machine the kernel is compiled.
    """
    notice = threading.Timer(PATIENCE, say, ["compiling the kernel; only a first start takes this long"])
    notice.daemon = True
    began = time.perf_counter()
    notice.start()
    try:
        run = Run(Engine(parameters), Encoder(parameters, 0))
        run.step()
        opposite = "hold" if parameters.operation.on_timeout == "release" else "release"
        run.change(updated(parameters, {"operation.on_timeout": opposite}))
    finally:
        notice.cancel()
    elapsed = time.perf_counter() - began
    if elapsed > PATIENCE:
        say(f"compiled in {elapsed:.0f} s")
