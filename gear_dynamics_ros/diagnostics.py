"""The gearbox's health as diagnostic_msgs tells it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from gear_dynamics_ros.commands import Tally
from gear_dynamics_ros.live import Live
from gear_dynamics_ros.pacing import Pace
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.physics.step_check import Check
from gear_dynamics_ros.recording.writer import Recorder, Stats
from gear_dynamics_ros.signals import Counters
from gear_dynamics_ros.viewer import Viewer

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class RunHealth(NamedTuple):
    state: str  # running, paused, inactive, ended
    reason: str  # why it ended
    time: float  # simulated, s
    expected: bool  # ended because pacing.duration was reached


class CommandHealth(NamedTuple):
    tally: Tally
    age: float  # wall time since the last good command, s; NaN: there was none
    timed_out: bool


class RecorderHealth(NamedTuple):
    path: str
    stats: Stats
    error: str | None


class ViewerHealth(NamedTuple):
    queued: int
    dropped: int
    error: str | None


class Health(NamedTuple):
    run: RunHealth
    pace: Pace
    wanted_factor: float
    commands: CommandHealth
    counters: Counters
    recorder: RecorderHealth | None
    viewer: ViewerHealth | None


def health(live: Live, recorder: Recorder | None, viewer: Viewer | None, wanted_factor: float) -> Health:
    """How everything stands; the pace since the last call."""
    state = (
        "ended" if live.ended else "inactive" if not live.active else "paused" if live.paused else "running"
    )
    tally = live.mailbox.tally()
    age = live.mailbox.age(time.monotonic_ns()) if tally.accepted else math.nan
    return Health(
        run=RunHealth(state, live.ended, live.time, live.run.completed and not live.run.tripped),
        pace=live.pace(),
        wanted_factor=wanted_factor,
        commands=CommandHealth(tally, age, live.timed_out),
        counters=live.counters,
        recorder=None
        if recorder is None
        else RecorderHealth(str(recorder.path), recorder.stats, recorder.error),
        viewer=None if viewer is None else ViewerHealth(viewer.queued, viewer.dropped, viewer.error),
    )


class Surface(NamedTuple):
    """Highest wave of the tooth surfaces beside what the waveform can show, Hz."""

    top_wave: float
    nyquist: float


def surface(parameters: Parameters, speed: float) -> Surface:
    """The highest surface wave at the driving speed ``speed`` in rad/s."""
    gears, ladder = parameters.gears, parameters.surface.scale ** (parameters.surface.waves - 1)
    rough = max(parameters.surface.driving.roughness, parameters.surface.driven.roughness) > 0.0
    waves = gears.driving.teeth * ladder if rough else 0.0
    return Surface(waves * abs(speed) / (2.0 * math.pi), 0.5 / parameters.solver.sample_interval)


def statuses(name: str, node: str, health: Health, waves: Surface, checks: Sequence[Check]) -> list[Any]:
    """One DiagnosticStatus a task; ``name`` heads each, ``node`` is the hardware_id."""
    tasks = {
        "run": _run(health.run),
        "pacing": _pacing(health),
        "commands": _commands(health.commands),
        "contacts": _contacts(health.counters),
        "step": _step(checks),
        "waveform": _waveform(waves),
        "recorder": _recorder(health.recorder),
        "viewer": _viewer(health.viewer),
    }
    return [
        DiagnosticStatus(
            level=level,
            name=f"{name}: {task}",
            message=message,
            hardware_id=node,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        for task, (level, message, values) in tasks.items()
    ]


def array(found: list[Any], time_ns: int) -> Any:
    """DiagnosticArray stamped ``time_ns``."""
    message = DiagnosticArray(status=found)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    return message


_Task = tuple[bytes, str, Mapping[str, object]]


def _run(run: RunHealth) -> _Task:
    values = {"state": run.state, "simulated time (s)": f"{run.time:.9g}"}
    if run.reason and not run.expected:
        return ERROR, f"{run.reason}; call ~/reset to recover", values
    return OK, run.reason or run.state, values


def _pacing(health: Health) -> _Task:
    pace = health.pace
    values = {
        "real-time factor": f"{pace.real_time_factor:.4g}",
        "real-time factor wanted": f"{health.wanted_factor:g}",
        "overruns": pace.overruns,
        "worst lateness (s)": f"{pace.worst_lateness:.6f}",
    }
    if health.run.state != "running":
        return OK, health.run.state, values
    if health.wanted_factor > 0.0 and pace.real_time_factor < 0.95 * health.wanted_factor:
        return WARN, "too slow: lower pacing.real_time_factor or lengthen solver.step", values
    return OK, "on time" if health.wanted_factor > 0.0 else "as fast as possible", values


def _commands(commands: CommandHealth) -> _Task:
    tally = commands.tally
    values = {
        "age (s)": f"{commands.age:.3f}",
        "accepted": tally.accepted,
        "refused": tally.refused,
        "last refusal": tally.last_refusal,
    }
    if commands.timed_out:
        return WARN, "no command within operation.command_timeout", values
    return OK, f"{tally.refused} refused" if tally.refused else "all good", values


def _contacts(counters: Counters) -> _Task:
    message = "some event searches met their limit" if counters.capped else "all events located"
    return OK, message, counters._asdict()


def _step(checks: Sequence[Check]) -> _Task:
    values = {f"step times {check.name}": f"{check.value:.3g}, limit {check.limit:.3g}" for check in checks}
    failed = [check.message for check in checks if not check.holds]
    if failed:
        return WARN, "; ".join(failed), values
    return OK, "the step bears every rate", values


def _waveform(waves: Surface) -> _Task:
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


def _recorder(recorder: RecorderHealth | None) -> _Task:
    if recorder is None:
        return OK, "off", {}
    values = {"path": recorder.path, **recorder.stats._asdict()}
    if recorder.error is not None:
        return ERROR, recorder.error, values
    return OK, "recording", values


def _viewer(viewer: ViewerHealth | None) -> _Task:
    if viewer is None:
        return OK, "off", {}
    values = {"queued": viewer.queued, "dropped": viewer.dropped}
    if viewer.error is not None:
        return ERROR, viewer.error, values
    return OK, "showing", values
