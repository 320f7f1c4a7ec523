"""State of the gearbox as diagnostic_msgs messages."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from gear_dynamics_ros.chunk import Commands, Counters
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.step_check import Check
from gear_dynamics_ros.realtime.condition import Condition
from gear_dynamics_ros.realtime.mailbox import CommandCounts
from gear_dynamics_ros.realtime.pacing import Pace
from gear_dynamics_ros.realtime.session import Session
from gear_dynamics_ros.recording.recorder import RecorderStats
from gear_dynamics_ros.ros.command_receiver import CommandPublishers
from gear_dynamics_ros.simulation.run_state import RunState
from gear_dynamics_ros.viewer import Viewer

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE
FULL_SOON = 60.0  # s of wall time until the disk is full and recording stops
UNITS = {"drive_torque": "N m", "load_torque": "N m", "speed": "rad/s"}


class RunHealth(NamedTuple):
    """State of the run."""

    state: RunState
    active: bool  # whether the engine's thread runs
    time: float  # simulated, s

    @property
    def name(self) -> str:
        """One of running, paused, inactive, ended."""
        return self.state.name if self.active or self.state.ended else "inactive"


class CommandHealth(NamedTuple):
    """Commands in force, and how they were received."""

    counts: CommandCounts
    in_force: Commands
    publishers: CommandPublishers
    timed_out: bool


class RecorderHealth(NamedTuple):
    """State of the present recording, or of one that could not begin."""

    path: str
    stats: RecorderStats | None  # None if the recording could not begin
    error: str | None


class RingHealth(NamedTuple):
    """Content of the ring."""

    held: float  # simulated time, s
    bytes: int
    snapshot: str  # path of the last snapshot written


class ViewerHealth(NamedTuple):
    """Chunks queued for and dropped by the viewer, and its error."""

    queued: int
    dropped: int
    error: str | None


class Health(NamedTuple):
    """State of the run and of everything that serves it."""

    run: RunHealth
    pace: Pace
    requested_factor: float
    commands: CommandHealth
    counters: Counters
    condition: Condition | None
    recorder: RecorderHealth | None
    ring: RingHealth | None
    viewer: ViewerHealth | None


def collect_health(
    session: Session, pace: Pace, viewer: Viewer | None, publishers: CommandPublishers
) -> Health:
    """Collect the state of ``session`` and of everything that serves it.

    ``pace`` is since the last report; ``publishers`` are those of commands.
    """
    thread = session.engine_thread
    counts = thread.mailbox.counts(time.monotonic_ns())
    return Health(
        run=RunHealth(session.state, thread.active, thread.time),
        pace=pace,
        requested_factor=session.parameters.pacing.real_time_factor,
        commands=CommandHealth(counts, thread.run.engine.commands, publishers, thread.timed_out),
        counters=thread.counters,
        condition=session.condition.report(),
        recorder=_recorder_health(session),
        ring=_ring_health(session),
        viewer=None if viewer is None else ViewerHealth(viewer.queued, viewer.dropped, viewer.error),
    )


def _recorder_health(session: Session) -> RecorderHealth | None:
    recorder = session.recordings.current
    if recorder is not None:
        return RecorderHealth(str(recorder.path), recorder.stats, recorder.error)
    refusal = session.recordings.refusal
    return RecorderHealth(session.parameters.recording.path, None, refusal) if refusal else None


def _ring_health(session: Session) -> RingHealth | None:
    ring = session.recordings.ring
    if ring is None:
        return None
    held = ring.samples * session.parameters.solver.sample_interval_ns / 1e9
    return RingHealth(held, ring.size, session.recordings.snapshot_path)


class SurfaceWaves(NamedTuple):
    """Highest frequency of the tooth surfaces, and the highest one that the waveform can resolve, Hz."""

    top_wave: float
    nyquist: float


def surface_waves(parameters: Parameters, speed: float) -> SurfaceWaves:
    """Frequencies at the driving speed ``speed`` in rad/s."""
    gears, ladder = parameters.gears, parameters.surface.scale ** (parameters.surface.waves - 1)
    rough = max(parameters.surface.driving.roughness, parameters.surface.driven.roughness) > 0.0
    waves = gears.driving.teeth * ladder if rough else 0.0
    return SurfaceWaves(waves * abs(speed) / (2.0 * math.pi), 0.5 / parameters.solver.sample_interval)


def diagnostic_statuses(node: str, health: Health, waves: SurfaceWaves, checks: Sequence[Check]) -> list[Any]:
    """One DiagnosticStatus for each task of the node with the full name ``node``.

    Each name begins with it, without the first slash, so that no two gearboxes share a name.
    """
    tasks = {
        "run": _run(health.run),
        "pacing": _pacing(health),
        "commands": _commands(health.commands),
        "contacts": _contacts(health.counters),
        "condition": _condition(health.run, health.condition),
        "step": _step(checks),
        "waveform": _waveform(waves),
        "recorder": _recorder(health.recorder, health.ring),
        "viewer": _viewer(health.viewer),
    }
    return [
        DiagnosticStatus(
            level=level,
            name=f"{node.removeprefix('/')}: {task}",
            message=message,
            hardware_id=node,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        for task, (level, message, values) in tasks.items()
    ]


def diagnostic_array(statuses: list[Any], time_ns: int) -> Any:
    """DiagnosticArray stamped ``time_ns``."""
    message = DiagnosticArray(status=statuses)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    return message


_Task = tuple[bytes, str, Mapping[str, object]]


def _run(run: RunHealth) -> _Task:
    values = {"state": run.name, "simulated time (s)": f"{run.time:.9g}"}
    if run.state.ended and not run.state.completed:
        return ERROR, f"{run.state.reason}; call ~/reset to recover", values
    return OK, run.state.reason or run.name, values


def _pacing(health: Health) -> _Task:
    pace = health.pace
    values = {
        "real-time factor": f"{pace.real_time_factor:.4g}",
        "real-time factor wanted": f"{health.requested_factor:g}",
        "overruns": pace.overruns,
        "worst lateness (s)": f"{pace.worst_lateness:.6f}",
        "slipped (s)": f"{pace.slipped:.6f}",
    }
    if health.run.name != "running":
        return STALE, health.run.name, values
    if health.requested_factor > 0.0 and pace.real_time_factor < 0.95 * health.requested_factor:
        return WARN, "too slow: lower pacing.real_time_factor or lengthen solver.step", values
    return OK, "on time" if health.requested_factor > 0.0 else "as fast as possible", values


def _commands(commands: CommandHealth) -> _Task:
    counts = commands.counts
    values: dict[str, object] = {
        "accepted": counts.accepted,
        "refused": counts.refused,
        "unrecorded": counts.unrecorded,
        "last refusal": counts.last_refusal,
        "several publishers": ", ".join(commands.publishers.several),
        "publishers of another type": ", ".join(commands.publishers.wrong_type),
    }
    for name, value in commands.in_force._asdict().items():
        values[f"{name} ({UNITS[name]})"] = f"{value:.9g}"
        values[f"{name} age (s)"] = f"{counts.ages[name]:.3f}"
    if commands.timed_out:
        return WARN, "no command within operation.command_timeout", values
    if commands.publishers.wrong_type:
        return WARN, "a publisher of commands has another type: its messages do not arrive", values
    if commands.publishers.several:
        return (
            WARN,
            "several publishers on a command: of their messages the last before an edge counts",
            values,
        )
    return OK, f"{counts.refused} refused" if counts.refused else "all good", values


def _contacts(counters: Counters) -> _Task:
    message = "some event searches met their limit" if counters.capped else "all events located"
    return OK, message, counters._asdict()


def _condition(run: RunHealth, condition: Condition | None) -> _Task:
    if condition is None:
        return STALE, "nothing simulated yet", {}
    values = {
        "looked at (s)": f"{condition.span:.3g}",
        "mean DTE (m)": f"{condition.dte_mean:.6g}",
        "RMS of DTE (m)": f"{condition.dte_rms:.6g}",
        "share of drive flanks": f"{condition.drive_share:.6g}",
        "share of contact loss": f"{condition.apart_share:.6g}",
        "share of back flanks": f"{condition.back_share:.6g}",
        "peak bearing force, driving (N)": f"{condition.driving_peak_force:.6g}",
        "peak bearing force, driven (N)": f"{condition.driven_peak_force:.6g}",
        "mean drive power (W)": f"{condition.drive_power:.6g}",
        "mean mesh loss (W)": f"{condition.mesh_loss:.6g}",
        "mesh loss, share of drive power": f"{_share(condition.mesh_loss, condition.drive_power):.6g}",
    }
    if run.name != "running":
        return STALE, run.name, values
    return OK, "teeth in contact" if condition.apart_share < 1.0 else "teeth apart", values


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan


def _step(checks: Sequence[Check]) -> _Task:
    values = {f"step times {check.name}": f"{check.value:.3g}, limit {check.limit:.3g}" for check in checks}
    failed = [check.message for check in checks if not check.holds]
    if failed:
        return WARN, "; ".join(failed), values
    return OK, "the step bears every rate", values


def _waveform(waves: SurfaceWaves) -> _Task:
    values = {
        "highest surface wave (Hz)": f"{waves.top_wave:.6g}",
        "half the sampling rate (Hz)": f"{waves.nyquist:g}",
    }
    if waves.top_wave > waves.nyquist:
        return (
            OK,
            "the highest surface waves lie above half the sampling rate: they alias in the waveform",
            values,
        )
    return OK, "sampling resolves the surface", values


def _recorder(recorder: RecorderHealth | None, ring: RingHealth | None) -> _Task:
    values: dict[str, object] = {}
    if ring is not None:
        values |= {
            "ring (s)": f"{ring.held:.3f}",
            "ring (bytes)": ring.bytes,
            "last snapshot": ring.snapshot,
        }
    if recorder is None:
        return OK, "off" if ring is None else "keeping the ring", values
    values["path"] = recorder.path
    if recorder.stats is not None:
        values |= recorder.stats._asdict()
    if recorder.error is not None:
        return ERROR, recorder.error, values
    if recorder.stats is not None and recorder.stats.seconds_left < FULL_SOON:
        return WARN, "the disk is full soon: free space or stop recording", values
    return OK, "recording", values


def _viewer(viewer: ViewerHealth | None) -> _Task:
    if viewer is None:
        return OK, "off", {}
    values = {"queued": viewer.queued, "dropped": viewer.dropped}
    if viewer.error is not None:
        return ERROR, viewer.error, values
    return OK, "showing", values
