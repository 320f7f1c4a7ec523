"""One run of the node, from its first activation to its end, and the requests of an operator; no ROS."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import PAUSE, RESUME
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import ParameterChange, Parameters, change_to
from gear_dynamics_ros.realtime.condition import ConditionSink
from gear_dynamics_ros.realtime.engine_thread import EngineThread
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.realtime.model_info import describe_model
from gear_dynamics_ros.realtime.pacing import Pace
from gear_dynamics_ros.realtime.recording_control import RecordingControl
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.ring import Excerpt, ring_size
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.checkpoint import Checkpoint
from gear_dynamics_ros.simulation.engine import Engine, require_resumable
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.run_state import RunState
from gear_dynamics_ros.simulation.sinks import Sink
from gear_dynamics_ros.system.futures import then, then_start
from gear_dynamics_ros.system.threads import begin_thread
from gear_dynamics_ros.topics import NodeNames


class Session:
    """Engine thread, sinks and recordings of one run.

    Simulated time 0 is the time of its creation, so that stamps agree with the wall clock at real-time
    factor 1. Its methods are for one thread, which serves the operator.
    """

    def __init__(
        self,
        engine: Engine,
        mailbox: Mailbox,
        sinks: Sequence[Sink],
        names: NodeNames,
        on_end: Callable[[Session], None],
        collect: Callable[[], None] = lambda: None,
    ) -> None:
        """``names`` are the node's; ``on_end`` is called on the engine's thread when the run has ended.

        ``collect`` is called before ``mailbox`` is emptied, to bring in what has not reached it.
        """
        parameters = engine.parameters
        self.epoch_ns = time.time_ns()
        self.condition = ConditionSink()
        self._names = names
        self._on_end = on_end
        self._encoder = Encoder(parameters, self.epoch_ns)
        self._run = Run(engine, self._encoder, [*sinks, self.condition], duration=parameters.pacing.duration)
        self.recordings = RecordingControl(self._run, self.epoch_ns, names)
        self.engine_thread = EngineThread(self._run, mailbox, self._run_ended, collect)
        self._started = False
        self._record_after_restart = False  # whether a fault, not the operator, ended the recording
        # A slow disk must not delay the engine, or the thread that serves the operator.
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="disk", initializer=begin_thread)

    @property
    def parameters(self) -> Parameters:
        """Parameters in force."""
        return self._run.engine.parameters

    @property
    def state(self) -> RunState:
        """State of the run."""
        return self._run.state

    @property
    def now_ns(self) -> int:
        """Stamp of the present simulated time."""
        return self.epoch_ns + self._run.engine.sample * self.parameters.solver.sample_interval_ns

    def start(self) -> None:
        """Start the run, or continue after ``stop``."""
        if not self._started:
            self._started = True
            self._write_model_info()
        elif not self.state.paused:
            self._run.write_event(RESUME, "activated")
        self.engine_thread.start()

    def stop(self) -> None:
        """Stop the engine thread without losing a sample."""
        self.engine_thread.stop()
        if not self.state.paused:
            self._run.write_event(PAUSE, "deactivated")

    def finish(self, reason: str) -> None:
        """End the run and close every sink."""
        self.engine_thread.stop()
        self._disk.shutdown()
        try:
            self._run.finish(reason)
        finally:
            self._run.close()

    def begin_recording(self, *, beside: bool) -> str:
        """Record, or arm the ring, as the parameters say; returns what was done, as text.

        If the recording can't begin, the run continues without it; ``recordings.errors`` has the reason.
        """
        if self.parameters.recording.mode == "ring":
            self.recordings.arm()
            megabytes = ring_size(self.parameters) / 1e6
            duration = self.parameters.recording.ring_duration
            return f"keeping the last {duration:g} s in memory, up to {megabytes:.0f} MB"
        return self._record(beside=beside)

    def report(self, pace: Pace, diagnostics: bytes) -> None:
        """Publish and record a report of the pacing, and the message ``diagnostics`` (CDR)."""
        requested = self.parameters.pacing.real_time_factor

        def records() -> list[Record]:
            row = (self.engine_thread.time, pace.real_time_factor, requested, *pace[1:])
            return [
                Record("diagnostics", self.now_ns, diagnostics),
                self._encoder.pacing(self.now_ns, row),
            ]

        self.engine_thread.post(records)

    # Requests of the operator. Each acts between two chunks and returns at once; its future gets a text about
    # what was done, or fails with GearboxError.

    def change(self, change: ParameterChange) -> Future[None]:
        """Put changed parameters in force from the next chunk on."""

        def apply() -> None:
            if change.values:
                self.engine_thread.change(change)
                self._write_model_info()

        return self.engine_thread.request(apply)

    def reset(self) -> Future[str]:
        """Return to the start state and to the commands of the parameters."""
        return self._restart("back at the start state", self._run.reset)

    def pause(self) -> Future[str]:
        """Stop simulated time."""
        return self.engine_thread.request(lambda: self._paused("paused", self.engine_thread.pause()))

    def unpause(self) -> Future[str]:
        """Continue after a pause."""
        return self.engine_thread.request(lambda: self._paused("running", self.engine_thread.unpause()))

    def step(self) -> Future[str]:
        """Compute ``stepping.chunks`` chunks while paused; done after the last one."""
        return then(self.engine_thread.step(), lambda reached: f"simulated {reached:.9g} s")

    def split(self) -> Future[str]:
        """Begin a new part of the recording."""
        return then(self.engine_thread.request(self.recordings.split), lambda _: "split")

    def start_recording(self) -> Future[str]:
        """Begin a new recording, beside earlier ones."""

        def begin() -> str:
            path = self.recordings.begin(beside=True)
            self._record_after_restart = False
            self._write_model_info()
            return f"recording to {path}"

        return self.engine_thread.request(begin)

    def end_recording(self) -> Future[str]:
        """Stop recording; done when the recording is complete on the disk."""

        def end() -> Recorder | None:
            self._record_after_restart = False
            return self.recordings.end()

        ended = self.engine_thread.request(end)
        return then_start(ended, lambda recorder: self._disk.submit(self._close, recorder))

    def snapshot(self) -> Future[str]:
        """Make a recording of the content of the ring; done when it is complete on the disk."""
        cut = self.engine_thread.request(self.recordings.cut)
        return then_start(cut, lambda excerpt: self._disk.submit(self._write, excerpt))

    def save_checkpoint(self) -> Future[str]:
        """Write the present state to ``checkpoint.path``. Raises GearboxError if that is empty."""
        path = self._checkpoint_path()
        taken = self.engine_thread.request(self._run.checkpoint)
        return then_start(taken, lambda state: self._disk.submit(self._save, path, state))

    def restore_checkpoint(self) -> Future[str]:
        """Resume from the checkpoint in ``checkpoint.path``; simulated time continues.

        Raises GearboxError if there is no valid one.
        """
        path = self._checkpoint_path()
        stored = checkpoint.load_checkpoint(path)
        require_resumable(stored.checkpoint)

        def resume() -> None:
            running = self.parameters
            self.engine_thread.change(change_to(running, checkpoint.parameters_to_continue(stored, running)))
            self._run.resume(stored.checkpoint, str(path))

        return self._restart(f"restored {path}", resume)

    def _restart(self, answer: str, begin: Callable[[], None]) -> Future[str]:
        """Reset or restore the run by ``begin``; record again if a fault had ended the recording."""

        def restart() -> str:
            self.engine_thread.restart(begin)
            self.condition.clear(self._run.engine.mesh_loss)
            record_again, self._record_after_restart = self._record_after_restart, False
            recorded = f", {self._record(beside=True)}" if record_again else ""
            self._write_model_info()
            return answer + recorded

        return self.engine_thread.request(restart)

    def _paused(self, state: str, changed: bool) -> str:
        return f"{'' if changed else 'already '}{state} at {self.engine_thread.time:.9g} s"

    def _record(self, *, beside: bool) -> str:
        try:
            return f"recording to {self.recordings.begin(beside=beside)}"
        except GearboxError as error:
            return f"not recorded: {error}"

    def _close(self, recorder: Recorder | None) -> str:
        return "nothing was recorded" if recorder is None else f"recorded {self.recordings.close(recorder)}"

    def _write(self, excerpt: Excerpt) -> str:
        return f"recorded {self.recordings.write(excerpt)}"

    def _save(self, path: Path, state: Checkpoint) -> str:
        checkpoint.save_checkpoint(path, state)
        taken_ns = state.sample * state.parameters.solver.sample_interval_ns
        return f"saved {path}, taken at {taken_ns * 1e-9:.9g} s"

    def _checkpoint_path(self) -> Path:
        path = self.parameters.checkpoint.path
        if not path:
            raise GearboxError("checkpoint.path is empty: start the node with a file for checkpoints")
        return Path(path).absolute()

    def _write_model_info(self) -> None:
        """Publish and record the description of the model, after a change."""
        text = describe_model(self.parameters, self.epoch_ns, self._names)
        self._run.write_records([self._encoder.model_info(self.now_ns, text)])

    def _run_ended(self) -> None:
        if not self.state.completed:
            self._keep_fault_recording()
        self._on_end(self)

    def _keep_fault_recording(self) -> None:
        """Finish the recording of a run that ended by a fault, and write the content of the ring."""
        # ``recordings.errors`` has the errors that are suppressed here.
        with contextlib.suppress(GearboxError):
            recorder = self.recordings.end()
            if recorder is not None:
                self._record_after_restart = True
                self.recordings.close(recorder)
        with contextlib.suppress(GearboxError):
            if self.recordings.ring is not None:
                self.recordings.write(self.recordings.cut())
