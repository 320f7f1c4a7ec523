"""A run paced by the wall clock, on its own thread; no ROS."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeVar

from gear_dynamics_ros.chunk import Chunk, Counters
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.messages.encoder import Record
from gear_dynamics_ros.parameters import (
    OperationParameters,
    ParameterChange,
)
from gear_dynamics_ros.realtime.mailbox import Delivery, Mailbox
from gear_dynamics_ros.realtime.pacing import Pace, Pacer
from gear_dynamics_ros.realtime.scheduling import schedule
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.system.threads import Doorbell, begin_thread

T = TypeVar("T")


@dataclass(slots=True)
class Steps:
    """A request for chunks while paused."""

    chunks: int  # requested
    timeout: float  # wall time, s
    began_ns: int  # wall time
    done: Future[float]  # gets the simulated time in s, or the reason of a failure
    made: int = 0  # chunks computed

    def expired(self, now_ns: int) -> bool:
        """Whether the time limit has passed at the wall time ``now_ns``."""
        return now_ns - self.began_ns > self.timeout * 1e9

    def abort(self, reason: str) -> None:
        """Fail with ``reason`` and the number of chunks computed."""
        self.done.set_exception(GearboxError(f"{reason} after {self.made} of {self.chunks} chunks"))


class EngineThread:
    """Paces a run. Only this thread uses the run; others call ``request`` to act between two chunks."""

    def __init__(
        self,
        run: Run,
        mailbox: Mailbox,
        on_end: Callable[[], None],
        collect: Callable[[], None] = lambda: None,
    ) -> None:
        """``on_end`` is called on the engine's thread when the run has ended.

        ``collect`` is called before ``mailbox`` is emptied, to bring in what has not reached it.
        """
        self.run = run
        self.mailbox = mailbox
        self._on_end = on_end
        self._collect = collect
        solver = run.engine.parameters.solver
        self._interval_ns = solver.sample_interval_ns
        self._chunk_ns = solver.samples_per_chunk * self._interval_ns
        self._pacer = Pacer(run.engine.parameters.pacing, time.monotonic_ns())
        self._requests: deque[Callable[[], None]] = deque()
        self._bell = Doorbell()
        self._pacer_lock = threading.Lock()
        self._stopping = False
        self._thread: threading.Thread | None = None
        self._steps: Steps | None = None
        self._timed_out = False
        self._end_reported = False
        self.counters = Counters(0, 0, 0, 0, 0)

    @property
    def active(self) -> bool:
        """Whether the thread is running."""
        return self._thread is not None

    @property
    def time(self) -> float:
        """Simulated time in s."""
        return self.run.engine.sample * self._interval_ns * 1e-9

    @property
    def timed_out(self) -> bool:
        """Whether the last command is older than ``operation.command_timeout``."""
        return self._timed_out

    def start(self) -> None:
        """Start the thread; after ``stop`` the run continues where it stopped."""
        self._stopping = False
        self._forget_commands()
        self._restart_clocks()
        self._thread = threading.Thread(target=self._work, name="engine", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the present chunk, serve all requests and end the thread."""
        if self._thread is None:
            return
        self._stopping = True
        self._bell.ring()
        self._thread.join()
        self._thread = None

    def request(self, action: Callable[[], T]) -> Future[T]:
        """Call ``action`` between two chunks, in the order of the requests; the future gets its result.

        Callbacks of the future run on the engine's thread. The time that ``action`` takes does not count as
        an overrun: deadlines slip by it. If the thread is not running, ``action`` is called at once.
        """
        future: Future[T] = Future()

        def serve() -> None:
            began = time.monotonic_ns()
            try:
                result = action()
            except Exception as error:
                future.set_exception(error)
            else:
                future.set_result(result)
            with self._pacer_lock:
                self._pacer.excuse(time.monotonic_ns() - began)

        if self.active:
            self._enqueue(serve)
        else:
            serve()
        return future

    def call(self, action: Callable[[], T]) -> T:
        """Result of ``action``, called as by ``request``. Raises what ``action`` raises."""
        return self.request(action).result()

    def post(self, make: Callable[[], Sequence[Record]]) -> None:
        """Write the messages that ``make`` returns to the sinks between two chunks, without waiting."""
        if self.active:
            self._enqueue(lambda: self.run.write_records(make()))
        else:
            self.run.write_records(make())

    def step(self) -> Future[float]:
        """Compute ``stepping.chunks`` chunks while paused, as fast as possible.

        The future gets the simulated time reached, s. It fails with GearboxError if the run is not paused, is
        stepping already or has ended; if it is unpaused, reset, stopped or ends meanwhile; and after
        ``stepping.timeout`` s of wall time.
        """
        done: Future[float] = Future()

        def begin() -> None:
            try:
                self._begin_steps(done)
            except GearboxError as error:
                done.set_exception(error)

        self.request(begin)
        return done

    def pause(self) -> bool:
        """``Run.pause``, to be called by ``request``."""
        changed = self.run.pause()
        if changed:
            self._restart_clocks()
        return changed

    def unpause(self) -> bool:
        """``Run.unpause``, to be called by ``request``; aborts steps in progress."""
        changed = self.run.unpause()
        if changed:
            self._abort_steps("aborted: resumed")
            self._restart_clocks()
        return changed

    def restart(self, begin: Callable[[], None]) -> None:
        """Call ``begin``, which resets or restores the run, and restart clocks and mailbox.

        To be called by ``request``.
        """
        begin()
        self._abort_steps("aborted: the run was reset or a checkpoint restored")
        self._end_reported = False
        self._timed_out = False
        self._forget_commands()
        self._restart_clocks()

    def change(self, change: ParameterChange) -> None:
        """Put ``change`` in force, to be called by ``request``. Raises GearboxError as ``Engine.change``."""
        self.run.change(change)
        self.mailbox.limit(change.new)
        if change.new.pacing != change.old.pacing:
            with self._pacer_lock:
                self._pacer.change(change.new.pacing, time.monotonic_ns())

    def pace(self) -> Pace:
        """Figures of the pacing since the last call."""
        with self._pacer_lock:
            return self._pacer.report(time.monotonic_ns())

    @property
    def _operation(self) -> OperationParameters:
        return self.run.engine.parameters.operation

    def _delivery(self) -> Delivery:
        """Every command that has arrived."""
        self._collect()
        return self.mailbox.take(time.monotonic_ns())

    def _forget_commands(self) -> None:
        self._collect()
        self.mailbox.forget()

    def _restart_clocks(self) -> None:
        now = time.monotonic_ns()
        with self._pacer_lock:
            self._pacer.restart(now)
        self.mailbox.restart(now)

    def _begin_steps(self, done: Future[float]) -> None:
        if not self.run.state.paused:
            raise GearboxError("not paused: ~/step makes chunks while paused, call ~/pause first")
        self.run.require_not_ended()
        if self._steps is not None:
            raise GearboxError(
                f"stepping already, {self._steps.made} of {self._steps.chunks} chunks are made: wait for it"
            )
        stepping = self.run.engine.parameters.stepping
        self._steps = Steps(stepping.chunks, stepping.timeout, time.monotonic_ns(), done)

    def _abort_steps(self, reason: str) -> None:
        steps, self._steps = self._steps, None
        if steps is not None:
            steps.abort(reason)

    def _enqueue(self, serve: Callable[[], None]) -> None:
        self._requests.append(serve)
        self._bell.ring()

    def _work(self) -> None:
        begin_thread()
        try:
            schedule(self.run.engine.parameters.pacing)
        except GearboxError as error:
            self._fail(error)
        while True:
            try:
                if not self._wait():
                    break
                self._make()
            except Exception as error:
                self._fail(error)
            if self.run.state.ended and not self._end_reported:
                self._report_end()
        self._abort_steps("aborted: deactivated")

    def _report_end(self) -> None:
        self._end_reported = True
        self._abort_steps(f"aborted: {self.run.state.reason}")
        try:
            self._on_end()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """End the run because of ``error``. The thread continues: a reset can recover."""
        with contextlib.suppress(Exception):  # the sink that failed may fail again
            self.run.fail(str(error) or repr(error))

    def _make(self) -> None:
        if self._steps is None:
            self._paced_chunk()
        else:
            self._stepped_chunk(self._steps)

    def _wait(self) -> bool:
        """Serve requests until a chunk is due; returns False if the thread must end."""
        while True:
            # One at a time: if one fails, the others stay in the queue.
            while self._requests:
                self._requests.popleft()()
            if self._stopping:
                return False
            patience = self._patience()
            if patience == 0.0 or not self._bell.wait(patience):
                return True

    def _patience(self) -> float | None:
        """Wall time in s until the next chunk is due; None if no chunk is to be computed."""
        state = self.run.state
        if state.ended:
            return None
        if state.paused:
            return None if self._steps is None else 0.0
        return self._pacer.wait_ns(self._chunk_ns, time.monotonic_ns()) * 1e-9

    def _paced_chunk(self) -> None:
        now = time.monotonic_ns()
        with self._pacer_lock:
            self._pacer.chunk_started(self._chunk_ns, now)
        delivery = self._delivery()
        self._check_timeout(delivery)
        chunk = self._chunk(delivery)
        with self._pacer_lock:
            late_ns = self._pacer.chunk_finished(len(chunk) * self._interval_ns, time.monotonic_ns())
        if late_ns:
            self._overrun(late_ns)

    def _stepped_chunk(self, steps: Steps) -> None:
        now = time.monotonic_ns()
        if steps.expired(now):
            self._abort_steps(f"timed out: {steps.timeout:g} s (stepping.timeout) are over")
            return
        self._chunk(self._delivery())
        steps.made += 1
        if steps.made == steps.chunks and not self.run.state.ended:
            self._steps = None
            steps.done.set_result(self.time)

    def _check_timeout(self, delivery: Delivery) -> None:
        """Time out when no commands arrive, and again if something else puts torques in force meanwhile."""
        timeout = self._operation.command_timeout
        before = self._timed_out
        self._timed_out = timeout > 0.0 and not delivery.changes and delivery.age_ns > timeout * 1e9
        if self._timed_out and (not before or self.run.timeout_changes_torques):
            self.run.time_out()

    def _chunk(self, delivery: Delivery) -> Chunk:
        changes = delivery.changes
        commands = self.run.engine.commands._replace(**changes) if changes else None
        chunk = self.run.step(commands, delivery.received)
        self.counters = chunk.counters
        return chunk

    def _overrun(self, late_ns: int) -> None:
        pacing = self.run.engine.parameters.pacing
        if pacing.on_overrun == "error" and not self.run.state.ended:
            self.run.fail(
                f"overrun: at {self.time:.9g} s a chunk was {late_ns * 1e-6:.3g} ms late and "
                "pacing.on_overrun = 'error': lower pacing.real_time_factor or take 'slip'"
            )
