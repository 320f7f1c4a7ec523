"""The clock that others follow, and torques released because no command came: both come out again."""

from __future__ import annotations

import json
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gear_dynamics_ros import recording
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.cli.replay import replay_main
from gear_dynamics_ros.events import START, TIMEOUT
from gear_dynamics_ros.messages.cdr import message_class, serialize
from gear_dynamics_ros.parameters import Parameters, change_values
from gear_dynamics_ros.realtime.engine_thread import EngineThread
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import FLOAT64
from support.altering import alter, on_topic
from support.processes import until
from support.recordings import Recorded

SHORT = {"solver.chunk": 3e-4, "operation.control": "torque"}
RELEASE = {"operation.command_timeout": 0.05, "operation.on_timeout": "release"}


def recorded(path: Path, **values: Any) -> tuple[Run, RecorderSink]:
    made = Recorded(path, Parameters.from_flat({**SHORT, **values}))
    return made.run, made.sink


@given(
    st.lists(st.sampled_from(["step", "step", "time out", "hold", "release", "reset", "split", "load"])),
    st.sampled_from([0.0, 300.0, 1000.0, 3333.0, 1.0 / 3e-4]),
    st.sampled_from([0.0, 9e-4]),
)
@settings(max_examples=40, deadline=None)
def test_time_outs_and_the_clock_come_out_again(deeds: list[str], rate: float, interval: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        run, sink = recorded(path, clock_rate=rate, **RELEASE, **{"recording.checkpoint_interval": interval})
        timeouts = 0
        for deed in [*deeds, "step"]:
            if deed == "time out":
                run.time_out()
                timeouts += 1
            elif deed in ("hold", "release"):
                run.change(change_values(run.engine.parameters, {"operation.on_timeout": deed}))
            elif deed == "reset":
                run.reset()
            elif deed == "split":
                sink.split()
            else:
                run.step(run.engine.commands._replace(load_torque=21.0) if deed == "load" else None)
        run.close()
        found = recording.open(path)
        result = verify_recording(found)
        assert result.difference is None and result.samples == found.end_sample
        assert [event.kind for event in found.events].count(TIMEOUT) == timeouts
        for part in found.parts:
            assert verify_recording(recording.open(part.path)).difference is None


@pytest.mark.parametrize(
    ("rate", "chunks"), [(1000.0, [0, 3, 6, 10, 13, 16, 20]), (1.0 / 3e-4, range(22)), (0.0, [])]
)
def test_the_clock_stands_in_each_chunk_with_a_multiple_of_its_period(
    tmp_path: Path, rate: float, chunks: Any
) -> None:
    run, _ = recorded(tmp_path / "bag", clock_rate=rate)
    for _ in range(22):
        run.step()
    run.close()
    bag = recording.open(tmp_path / "bag")
    ticks = [(time_ns, message.clock.nanosec) for time_ns, message in bag.messages("clock")]
    assert ticks == [((30 * chunk + 29) * 10_000,) * 2 for chunk in chunks]


@pytest.mark.parametrize("number", [0, 4])
def test_a_clock_told_otherwise_or_left_out_is_found(tmp_path: Path, number: int) -> None:
    run, _ = recorded(tmp_path / "bag", clock_rate=1000.0, **{"recording.checkpoint_interval": 6e-4})
    for _ in range(20):
        run.step()
    run.close()

    def late(message: Any) -> None:
        message.clock.nanosec += 1

    seen: list[str] = []

    def drop(topic: str, data: bytes) -> bytes | None:
        seen.extend([topic] if topic == "clock" else [])
        return None if topic == "clock" and len(seen) == number + 1 else data

    for name, change in (("late", on_topic("clock", number, late)), ("dropped", drop)):
        altered = alter(tmp_path / "bag", tmp_path / name, message=change)
        difference = verify_recording(recording.open(altered)).difference
        assert difference is not None and difference.what.startswith("clock")


class _Watcher:
    """A sink that can be waited on until the run is as wanted."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._changed = threading.Condition()

    def wanted(self) -> tuple[str, ...]:
        return ()

    def write(self, *_: object) -> None:
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Nothing to finish."""

    def until(self, wanted: Commands) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self._run.engine.commands == wanted, 120.0)


def offer(live: EngineThread, load: float) -> None:
    data = serialize(FLOAT64, message_class(FLOAT64)(data=load))
    live.mailbox.offer("load_torque_command", {"load_torque": load}, data, time.monotonic_ns())


def live_run(path: Path, **values: Any) -> tuple[EngineThread, _Watcher]:
    run, _ = recorded(path, **RELEASE | values, **{"pacing.real_time_factor": 0.2, "solver.step": 1e-5})
    watcher = _Watcher(run)
    run.attach(watcher)
    live = EngineThread(run, Mailbox(run.engine.parameters, time.monotonic_ns()), lambda: None)
    live.start()
    return live, watcher


def test_torques_are_released_once_and_return_with_a_command(tmp_path: Path) -> None:
    live, watcher = live_run(tmp_path / "bag")
    offer(live, 21.0)
    watcher.until(Commands(0.0, 0.0, 1623.156))
    offer(live, 22.0)
    watcher.until(Commands(0.0, 22.0, 1623.156))
    watcher.until(Commands(0.0, 0.0, 1623.156))
    # What else puts a torque in force is released again, and that is told too.
    wanted = change_values(live.run.engine.parameters, {"operation.load_torque": 12.0})
    live.call(lambda: live.change(wanted))
    watcher.until(Commands(0.0, 0.0, 1623.156))
    live.stop()
    live.run.close()
    bag = recording.open(tmp_path / "bag")
    assert verify_recording(bag).difference is None
    assert [event.kind for event in bag.events] == [START, TIMEOUT, TIMEOUT, "parameters", TIMEOUT]
    released = [event for event in bag.events if event.kind == TIMEOUT]
    assert all(event.commands == {"drive_torque": 0.0, "load_torque": 0.0} for event in released)
    assert released[0].message == "no command for 0.05 s: torques released"
    in_force = dict(bag.commands)
    assert [in_force[event.sample] for event in released] == [Commands(0.0, 0.0, 1623.156)] * 3


def test_held_commands_are_told_and_stay(tmp_path: Path) -> None:
    live, _ = live_run(tmp_path / "bag", **{"operation.on_timeout": "hold"})
    offer(live, 21.0)
    until(lambda: live.timed_out, "a time-out")
    live.stop()
    live.run.close()
    bag = recording.open(tmp_path / "bag")
    assert verify_recording(bag).difference is None
    (told,) = (event for event in bag.events if event.kind == TIMEOUT)
    assert (told.message, told.commands) == ("no command for 0.05 s: commands held", {})
    assert bag.commands[-1][1] == Commands(30.0, 21.0, 1623.156)


@pytest.mark.parametrize("entry", ["commands", "event", "sample"])
def test_a_release_told_otherwise_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], entry: str
) -> None:
    run, _ = recorded(tmp_path / "bag", **RELEASE)
    run.step()
    run.time_out()
    run.step()
    run.close()

    def change(message: Any) -> None:
        content = json.loads(message.data)
        changed = {"commands": {"drive_torque": 1.0}, "event": "pause", "sample": 31}
        message.data = json.dumps(content | {entry: changed[entry]})

    path = alter(tmp_path / "bag", tmp_path / "x", message=on_topic("event", 1, change))
    assert replay_main(["verify", str(path)]) == 1
    error = capsys.readouterr().err
    assert "event" in error or "commands" in error
