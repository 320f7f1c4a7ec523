"""The recorder at work: splits, checkpoints, the ring, and what may happen to the place it writes to."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from gear_dynamics_ros import recording
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.realtime import recording_control
from gear_dynamics_ros.realtime.mailbox import Mailbox
from gear_dynamics_ros.realtime.recording_control import RecordingControl
from gear_dynamics_ros.realtime.session import Session
from gear_dynamics_ros.recording import recorder as recorder_module
from gear_dynamics_ros.recording.ring import Ring
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation import checkpoint
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import NodeNames
from support.processes import run_python, until
from support.recordings import Recorded

CHUNK = 200  # samples


def begin(path: Path, **values: object) -> Recorded:
    return Recorded(path, Parameters.from_flat(values))


def test_checkpoints_lie_an_interval_apart_and_hold_what_a_checkpoint_file_does(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag", **{"recording.checkpoint_interval": 0.005})
    made.steps(10)
    made.run.close()
    (part,) = recording.open(tmp_path / "bag").parts
    assert list(part.checkpoints) == [3 * CHUNK, 6 * CHUNK, 9 * CHUNK]
    file = tmp_path / "file.json"
    file.write_bytes(part.attachment(part.checkpoints[6 * CHUNK]))
    saved = checkpoint.load_checkpoint(file)
    engine = Engine(saved.checkpoint.parameters)
    engine.restore(saved.checkpoint)
    samples = recording.open(tmp_path / "bag").waveform()
    assert engine.advance(CHUNK).samples.tobytes() == samples[6 * CHUNK : 7 * CHUNK].tobytes()
    assert part.stored(part.end).checkpoint.sample == 10 * CHUNK


def test_no_checkpoints_where_none_are_wanted(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag", **{"recording.checkpoint_interval": 0.0})
    made.steps(3)
    made.run.close()
    (part,) = recording.open(tmp_path / "bag").parts
    assert not part.checkpoints and part.end


def test_a_new_file_after_a_simulated_time(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag", **{"recording.split_duration": 0.01})
    made.steps(12)
    made.run.close()
    bag = recording.open(tmp_path / "bag")
    assert [part.first_sample for part in bag.parts] == [0, 5 * CHUNK, 10 * CHUNK]
    assert verify_recording(bag).difference is None


def test_a_new_file_at_a_size(tmp_path: Path) -> None:
    size = 2_500_000
    made = begin(tmp_path / "bag", **{"recording.split_size": size, "solver.step": 1e-5})

    def in_third_file() -> bool:
        made.steps(10)
        return made.recorder.stats.parts > 2

    # its thread lies behind the engine by an unknown number of chunks
    until(in_third_file, "a third file")
    made.run.close()
    bag = recording.open(tmp_path / "bag")
    assert len(bag.parts) > 2
    # a file is noticed to be full when a chunk of it has been written, and ends with what is queued by then
    assert all(size <= part.size for part in bag.parts[:-1])
    assert len(bag.waveform()) == made.engine.sample
    for part in bag.parts:
        assert verify_recording(recording.open(part.path)).difference is None


def test_a_split_that_waits_is_not_asked_for_twice(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag")
    made.steps(1)
    # the recorder's thread can't take anything while its lock is held
    with made.recorder._changed:
        made.recorder.split(made.engine.checkpoint())
        assert made.recorder.part_bytes == 0
    made.run.close()
    assert made.recorder.part_bytes > 0


def test_a_split_size_that_is_no_file_is_refused() -> None:
    with pytest.raises(UsageError, match=r"recording\.split_size = 1000 B is too small"):
        Parameters.from_flat({"recording.split_size": 1000})


def test_too_little_room_is_refused_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(GearboxError, match=r"less than recording\.minimum_free = 1\.1.*: free space"):
        begin(tmp_path / "bag", **{"recording.minimum_free": 1 << 50})
    assert list(tmp_path.iterdir()) == []


def until_stopped(made: Recorded) -> str:
    """Step until the recorder has noticed something, and chunks after that; returns what it says."""
    for _ in range(20_000):
        made.steps(1)
        if made.recorder.error is not None:
            break
    made.steps(2)
    made.run.close()
    assert made.recorder.error is not None and "\n" not in made.recorder.error
    return made.recorder.error


def test_recording_stops_in_time_before_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_SECONDS", 0.01)
    volume = os.statvfs(tmp_path)
    kept_free = volume.f_bavail * volume.f_frsize - 300_000_000
    made = begin(tmp_path / "bag", **{"solver.step": 1e-5, "recording.minimum_free": kept_free})
    made.steps(50)
    assert made.recorder.error is None
    with tempfile.TemporaryFile(dir=tmp_path) as other:
        os.posix_fallocate(other.fileno(), 0, 600_000_000)
        error = until_stopped(made)
    assert "are free there, less than recording.minimum_free" in error
    stats = made.recorder.stats
    bag = recording.open(tmp_path / "bag")
    assert bag.complete and len(bag.waveform()) >= CHUNK
    assert stats.lost > 0
    handed = made.engine.sample // CHUNK
    # what a chunk makes, ten messages at most and nine at least, is kept whole or counted as lost
    assert 9 * handed <= stats.lost + sum(topic.messages for topic in bag.topics) <= 10 * handed + 2


@pytest.mark.parametrize("what", ["folder", "file", "another in its place"])
def test_a_folder_that_is_taken_away_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_SECONDS", 0.01)
    path = tmp_path / "bag"
    made = begin(path, **{"solver.step": 1e-5})
    made.steps(10)
    if what == "file":
        (path / "bag_0.mcap").unlink()
    else:
        shutil.move(path, tmp_path / "elsewhere")
    if what == "another in its place":
        path.mkdir()
        (path / "bag_0.mcap").write_bytes(b"mine")
    error = until_stopped(made)
    assert "was moved or removed, with what was written" in error and str(path) in error
    assert made.engine.sample > 10 * CHUNK
    if what == "another in its place":
        assert [file.name for file in path.iterdir()] == ["bag_0.mcap"]
        assert (path / "bag_0.mcap").read_bytes() == b"mine"


FULL_AT_A_SPLIT = """
import resource, sys, time
from pathlib import Path
from gear_dynamics_ros.parameters import Parameters
from support.recordings import Recorded
made = Recorded(Path(sys.argv[1]), Parameters.from_flat({"solver.step": 1e-5}))
made.steps(20)
made.recorder.split(made.engine.checkpoint())
while made.recorder.stats.parts < 2:
    time.sleep(0.01)
# not even the start of another part fits
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
made.recorder.split(made.engine.checkpoint())
made.steps(20)
made.run.close()
print(made.recorder.error)
"""


def test_a_disk_that_is_full_at_a_split_leaves_the_parts_before(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    done = run_python(FULL_AT_A_SPLIT, path)
    assert done.returncode == 0, done.stderr
    assert "File too large" in done.stdout
    first = recording.open(path / "bag_0.mcap")
    assert first.complete and len(first.waveform()) == 20 * CHUNK


def test_flushed_is_what_a_reader_finds_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_SECONDS", 0.05)
    made = begin(tmp_path / "bag", **{"solver.step": 1e-5})
    looks = 0
    while looks < 5:
        made.steps(20)
        flushed = made.recorder.stats.flushed
        if flushed:
            found = recording.open(tmp_path / "bag")
            assert sum(topic.messages for topic in found.topics) >= flushed
            looks += 1
    made.run.close()
    assert made.recorder.stats.flushed == made.recorder.stats.messages


def test_a_ring_writes_the_last_of_a_run_and_goes_on(tmp_path: Path) -> None:
    parameters = Parameters.from_flat(
        {
            "recording.path": str(tmp_path / "bag"),
            "recording.mode": "ring",
            "recording.ring_duration": 0.032,
        }
    )
    engine = Engine(parameters)
    run = Run(engine, Encoder(parameters, 0))
    recordings = RecordingControl(run, 0, NodeNames("/cell/box"))
    with pytest.raises(GearboxError, match="there is no ring"):
        recordings.cut()
    recordings.arm()
    for steps, name in ((3, "bag"), (40, "bag_2")):
        for _ in range(steps):
            run.step()
        path = recordings.write(recordings.cut())
        assert path == tmp_path / name
        found = recording.open(path)
        assert found.complete and found.node == "/cell/box"
        assert found.end_sample == engine.sample
        assert min(engine.sample, 16 * CHUNK) <= found.end_sample - found.first_sample <= 18 * CHUNK
        assert found.commands[0][1] == engine.commands
        assert verify_recording(found).difference is None
    assert recordings.ring is not None and 16 * CHUNK <= recordings.ring.samples <= 18 * CHUNK
    assert recordings.ring.size < 19 * 50_000


def test_a_ring_forgets(tmp_path: Path) -> None:
    parameters = Parameters.from_flat({"recording.ring_duration": 0.01, "solver.step": 1e-5})
    engine = Engine(parameters)
    ring = Ring(engine)
    run = Run(engine, Encoder(parameters, 0), [ring])
    sizes = []
    for _ in range(200):
        run.step()
        sizes.append(ring.size)
    assert max(sizes[20:]) < 5 * 50_000


def test_a_choice_of_topics_verifies_as_far_as_it_goes(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag", **{"recording.topics": ["waveform", "energy"]})
    made.steps(5)
    made.run.close()
    bag = recording.open(tmp_path / "bag")
    names = {topic.name.rpartition("/")[2]: topic.messages for topic in bag.topics}
    assert names == {"waveform": 5, "energy": 5, "applied": 1, "event": 1}
    result = verify_recording(bag)
    assert (result.difference, result.messages, result.samples) == (None, 10, 5 * CHUNK)


def test_without_the_waveform_there_is_nothing_to_verify(tmp_path: Path) -> None:
    made = begin(tmp_path / "bag", **{"recording.topics": ["dte"]})
    made.steps(5)
    made.run.close()
    bag = recording.open(tmp_path / "bag")
    assert len(list(bag.messages("dte"))) == 5
    with pytest.raises(GearboxError, match=r"no waveform to compare: add waveform to recording\.topics"):
        verify_recording(bag)


NOT_EVEN_A_BEGINNING = """
import resource, sys
from pathlib import Path
from gear_dynamics_ros.errors import GearboxError
from gear_dynamics_ros.parameters import Parameters
from support.recordings import Recorded
resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
try:
    Recorded(Path(sys.argv[1]), Parameters())
except GearboxError as error:
    print(error)
"""


def test_a_disk_on_which_nothing_fits_is_told_and_nothing_stays(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    done = run_python(NOT_EVEN_A_BEGINNING, path)
    assert done.returncode == 0, done.stderr
    assert f"can't write in '{path}': File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []


FULL_MEANWHILE = """
import resource, sys
from pathlib import Path
from gear_dynamics_ros.parameters import Parameters
from support.recordings import Recorded
values = {"solver.step": 1e-5, "recording.minimum_free": 0}
made = Recorded(Path(sys.argv[1]), Parameters.from_flat(values))
handed = []
write = made.recorder.write
made.recorder.write = lambda records: (handed.extend(records), write(records))
if sys.argv[2] == "split":
    made.steps(5)
    made.recorder.split(made.engine.checkpoint())
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
made.steps(150)
made.run.close()
stats = made.recorder.stats
print(made.recorder.error, len(handed), stats.messages, stats.lost, sep="|")
"""


@pytest.mark.parametrize(("first", "limit"), [("", 1_500_000), ("", 3_300_000), ("split", 600_000)])
def test_what_a_full_disk_took_is_counted_to_the_message(tmp_path: Path, first: str, limit: int) -> None:
    path = tmp_path / "bag"
    done = run_python(FULL_MEANWHILE, path, first, limit)
    assert done.returncode == 0, done.stderr
    error, *counts = done.stdout.strip().split("|")
    handed, written, lost = map(int, counts)
    assert "File too large" in error and lost > 0
    assert written + lost == handed
    assert sum(topic.messages for topic in recording.open(path).topics) == written


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    parameters = Parameters.from_flat({"recording.path": str(tmp_path / "bag"), "recording.mode": "ring"})
    session = Session(Engine(parameters), Mailbox(parameters, 0), [], NodeNames(), lambda _: None)
    session.begin_recording(beside=False)
    yield session
    session.finish("over")


def test_a_recording_that_stopped_makes_way_for_another(session: Session, tmp_path: Path) -> None:
    session.start_recording().result()
    shutil.rmtree(tmp_path / "bag")
    stopped = session.recordings.current
    assert stopped is not None
    until(lambda: stopped.error, "the recorder notices")
    with pytest.raises(GearboxError, match="was moved or removed, with what was written"):
        session.split().result()
    (tmp_path / "bag").mkdir()
    assert session.start_recording().result() == f"recording to {tmp_path / 'bag_2'}"
    assert session.recordings.errors == (stopped.error,)
    assert session.split().result() == "split"
    with pytest.raises(GearboxError, match="already recording to"):
        session.start_recording().result()
    assert session.end_recording().result() == f"recorded {tmp_path / 'bag_2'}"
    assert session.recordings.errors == (stopped.error,)


def test_a_recording_begun_after_a_fault_goes_on_through_the_reset(tmp_path: Path) -> None:
    parameters = Parameters.from_flat(
        {
            "recording.path": str(tmp_path / "bag"),
            "operation.control": "torque",
            "operation.load_torque": 0.0,
            "operation.speed_limit": 1640.0,
            "pacing.real_time_factor": 0.0,
        }
    )
    ended = threading.Event()
    session = Session(Engine(parameters), Mailbox(parameters, 0), [], NodeNames(), lambda _: ended.set())
    session.begin_recording(beside=False)
    session.start()
    assert ended.wait(60.0)
    assert session.start_recording().result() == f"recording to {tmp_path / 'bag_2'}"
    ended.clear()
    assert session.reset().result() == "back at the start state"
    assert ended.wait(60.0)
    session.finish("over")
    assert session.recordings.errors == ()
    for name in ("bag", "bag_2"):
        assert verify_recording(recording.open(tmp_path / name)).difference is None


def test_a_name_that_another_thread_takes_meanwhile_is_left_to_it(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = iter([tmp_path / "bag", tmp_path / "bag_2", tmp_path / "bag", tmp_path / "bag_3"])
    monkeypatch.setattr(recording_control, "_free", lambda _: next(names))
    (tmp_path / "bag").mkdir()
    assert session.snapshot().result() == f"recorded {tmp_path / 'bag_2'}"
    assert session.start_recording().result() == f"recording to {tmp_path / 'bag_3'}"
