"""One run of the node, from its first activation to its end, and what an operator may ask of it; no ROS."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.events import PAUSE, RESUME
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, differences
from gear_dynamics_ros.realtime import model_info
from gear_dynamics_ros.realtime.condition import ConditionSink
from gear_dynamics_ros.realtime.engine_thread import Live
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.realtime.pacing import Pace
from gear_dynamics_ros.realtime.recording_control import RecordingControl
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.ring import Excerpt
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.engine import Engine, require_resumable
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.simulation.sinks import Sink


class Session:
    """Engine thread, sinks and recordings of one run.

    Simulated time 0 is the moment it is made, so that stamps run along with the wall clock at real-time
    factor 1.
    """

    def __init__(
        self,
        engine: Engine,
        mailbox: Mailbox,
        sinks: Sequence[Sink],
        node: str,
        ended: Callable[[Session], None],
    ) -> None:
        """``node`` is the full name; ``ended`` is called on the engine's thread when the run has ended."""
        parameters = engine.parameters
        self.epoch_ns = time.time_ns()
        self.condition = ConditionSink()
        self._node = node
        self._ended = ended
        self._encoder = Encoder(parameters, self.epoch_ns)
        self._run = Run(engine, self._encoder, [*sinks, self.condition], duration=parameters.pacing.duration)
        self.recordings = RecordingControl(self._run, self.epoch_ns, node)
        self.live = Live(self._run, mailbox, self._run_ended)
        self._started = False
        self._cut_recording = False  # the end of the run, and not the operator, ended the recording
        # A disk may take its time: neither the engine nor whoever serves the operator waits for it.
        self._writers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="snapshot")

    @property
    def parameters(self) -> Parameters:
        """Parameters in force."""
        return self._run.engine.parameters

    @property
    def completed(self) -> bool:
        """Whether the run ended because ``pacing.duration`` has been simulated."""
        return self._run.completed and not self._run.tripped and not self.live.failed

    @property
    def now_ns(self) -> int:
        """Stamp of the present simulated time."""
        return self.epoch_ns + self._run.engine.sample * self.parameters.solver.sample_interval_ns

    def start(self) -> None:
        """Begin, or go on where ``stop`` left."""
        if not self._started:
            self._started = True
            self._tell()
        elif not self.live.paused:
            self._run.note(RESUME, "activated")
        self.live.start()

    def stop(self) -> None:
        """Stand still without losing a sample."""
        self.live.stop()
        if not self.live.paused:
            self._run.note(PAUSE, "deactivated")

    def finish(self, reason: str) -> None:
        """End the run and close every sink."""
        self.live.stop()
        self._writers.shutdown()
        try:
            self._run.finish(reason)
        finally:
            self._run.close()

    def begin_recording(self, *, beside: bool) -> str:
        """Record, or arm the ring, as the parameters want; returns what was done, in words.

        A recording that can't begin leaves the run without one: ``recordings.errors`` then says why.
        """
        if self.parameters.recording.mode == "ring":
            self.recordings.arm()
            return f"keeping the last {self.parameters.recording.ring_duration:g} s in memory"
        return self._record(beside=beside)

    def change(self, parameters: Parameters) -> None:
        """Go on with ``parameters`` from the next chunk edge on. Raises UsageError where one is fixed."""
        if differences(self.parameters, parameters):
            self.live.call(lambda: self.live.change(parameters))
            self._tell()

    def report(self, pace: Pace, diagnostics: bytes) -> None:
        """Publish and record how well the pace is kept, and ``diagnostics`` in CDR."""
        wanted = self.parameters.pacing.real_time_factor

        def records() -> list[Record]:
            row = (self.live.time, pace.real_time_factor, wanted, *pace[1:])
            return [
                Record("diagnostics", self.now_ns, diagnostics),
                self._encoder.pacing(self.now_ns, row),
            ]

        self.live.post(records)

    # What services ask for: each returns what it did, in words, and raises GearboxError where it can't be.

    def reset(self) -> str:
        """Back to the start state and the commands of the parameters."""
        return f"back at the start state{self._restart(self._run.reset)}"

    def pause(self, paused: bool) -> str:
        """Let simulated time stand, or go on."""
        changed = self.live.call(lambda: self.live.pause(paused))
        return f"{'' if changed else 'already '}{'paused' if paused else 'running'} at {self.live.time:.9g} s"

    def step(self) -> Future[float]:
        """``stepping.chunks`` chunks while paused; the future gets the simulated time reached, s."""
        stepping = self.parameters.stepping
        return self.live.step(stepping.chunks, stepping.timeout)

    def split(self) -> str:
        """Go on recording in a new file."""
        self.live.call(self.recordings.split)
        return "split"

    def start_recording(self) -> str:
        """Record from now on, beside earlier recordings."""
        path = self.live.call(lambda: self.recordings.begin(beside=True))
        self._cut_recording = False
        self._tell()
        return f"recording to {path}"

    def end_recording(self) -> Future[str]:
        """Record no more; the future is done when the recording is complete on the disk."""
        recorder = self.live.call(self.recordings.end)
        return self._writers.submit(self._close, recorder)

    def snapshot(self) -> Future[str]:
        """Make a recording of what the ring holds; the future is done when it is complete on the disk."""
        excerpt = self.live.call(self.recordings.cut)
        return self._writers.submit(self._write, excerpt)

    def save_checkpoint(self) -> str:
        """Write the state of this moment to ``checkpoint.path``."""
        path = self._checkpoint_path()
        taken = self.live.call(self._run.checkpoint)
        checkpoint.save(path, taken)
        taken_ns = taken.sample * self.parameters.solver.sample_interval_ns
        return f"saved {path}, taken at {taken_ns * 1e-9:.9g} s"

    def restore_checkpoint(self) -> str:
        """Resume from the state in ``checkpoint.path``; simulated time goes on."""
        path = self._checkpoint_path()
        stored = checkpoint.load(path)
        parameters = checkpoint.continued(stored, self.parameters)
        require_resumable(stored.checkpoint)

        def resume() -> None:
            self.live.change(parameters)
            self._run.resume(stored.checkpoint, str(path))

        return f"restored {path}{self._restart(resume)}"

    def _restart(self, begin: Callable[[], None]) -> str:
        """Put the run anew where ``begin`` does; record anew if its end had closed the recording."""

        def restart() -> str:
            self.live.restart(begin)
            self.condition.clear(self._run.engine.mesh_loss)
            record_anew, self._cut_recording = self._cut_recording, False
            return f", {self._record(beside=True)}" if record_anew else ""

        more = self.live.call(restart)
        self._tell()
        return more

    def _record(self, *, beside: bool) -> str:
        try:
            return f"recording to {self.recordings.begin(beside=beside)}"
        except GearboxError as error:
            return f"not recorded: {error}"

    def _close(self, recorder: Recorder | None) -> str:
        return "nothing was recorded" if recorder is None else f"recorded {self.recordings.close(recorder)}"

    def _write(self, excerpt: Excerpt) -> str:
        return f"recorded {self.recordings.write(excerpt)}"

    def _checkpoint_path(self) -> Path:
        path = self.parameters.checkpoint.path
        if not path:
            raise GearboxError("checkpoint.path is empty: start the node with a file for checkpoints")
        return Path(path).absolute()

    def _tell(self) -> None:
        """Publish and record what the model is, after whatever changed it."""
        text = model_info.describe(self.parameters, self.epoch_ns, self._node)
        self.live.post(lambda: [self._encoder.model_info(self.now_ns, text)])

    def _run_ended(self) -> None:
        if not self.completed:
            self._keep_the_fault()
        self._ended(self)

    def _keep_the_fault(self) -> None:
        """Finish the recording of a run that ended by a fault; write what the ring holds of it."""
        # ``recordings.errors`` keeps what goes wrong here.
        with contextlib.suppress(GearboxError):
            recorder = self.recordings.end()
            if recorder is not None:
                self._cut_recording = True
                self.recordings.close(recorder)
        with contextlib.suppress(GearboxError):
            if self.recordings.ring is not None:
                self.recordings.write(self.recordings.cut())
