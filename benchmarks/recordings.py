"""Cost and speed of recording, reading and verifying, beside what others make of the same files."""

from __future__ import annotations

import os
import random
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from speed import parameters_of

from gear_dynamics_ros import recording
from gear_dynamics_ros.messages.encoder import Encoder, Record
from gear_dynamics_ros.parameters import Parameters, updated
from gear_dynamics_ros.recording import layout
from gear_dynamics_ros.recording.recorder import Recorder
from gear_dynamics_ros.recording.recorder_sink import RecorderSink
from gear_dynamics_ros.recording.recover import recover
from gear_dynamics_ros.replay.verify import verify_recording
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.topics import TOPICS, full_topic_name

SHARE_AIMED_AT = 0.25  # of a core, at 100 kHz and all channels
VERIFY_AIMED_AT = 3.0  # times real time, improved model, two cores
DURATION = 6.0  # s of simulated time in what is written and read
VERIFIED = 4.0
HANDED = 4.0  # s of wall time in which chunks are handed over at their pace
TURNS = 3
SEEKS = 50
SPLIT = 0.5  # s
WINDOW = 0.01  # s
WAVEFORM = full_topic_name(TOPICS["waveform"])

Lines = list[str]


def tables() -> Lines:
    """Everything, a table each."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        made = chunks_made(parameters_of("gearbox"))
        return [
            *writing(made, place),
            "",
            *handing(made, place),
            "",
            *reading(record(made, place / "read"), place),
            "",
            *verifying(place),
        ]


def chunks_made(parameters: Parameters) -> list[list[Record]]:
    """The messages of DURATION, chunk by chunk."""
    engine, encoder = Engine(parameters), Encoder(parameters, 0)
    return [encoder.chunk(engine.advance()) for _ in range(round(DURATION / parameters.solver.chunk))]


def record(made: Sequence[Sequence[Record]], path: Path) -> Path:
    """Recording of what was made."""
    parameters = parameters_of("gearbox")
    recorder = Recorder(path, Engine(parameters).checkpoint(), 0)
    for records in made:
        recorder.write(records)
    recorder.close()
    return path


def writing(made: Sequence[Sequence[Record]], place: Path) -> Lines:
    """Throughput and processor time of the recorder, and of others that write the same messages."""
    size = sum(len(record.data) for records in made for record in records)
    ways: dict[str, Callable[[Path], float]] = {
        "this recorder": partial(_cpu_of_recorder, made),
        "mcap.writer.Writer, zstd": partial(_cpu_of_mcap, made),
        "plain file, no format": partial(_cpu_of_file, made),
    }
    figures: dict[str, list[tuple[float, float, int]]] = {name: [] for name in ways}
    for turn in range(TURNS):
        for number, (name, write) in enumerate(ways.items()):
            path = place / f"written_{turn}_{number}"
            began = time.perf_counter()
            cpu = write(path)
            wall = time.perf_counter() - began
            figures[name].append((wall, cpu, _bytes(path)))
    lines = [
        f"Writing {DURATION:g} s of all topics ({size / 1e6:.0f} MB of messages), down to the disk:",
        "",
        "| way | MB/s | processor time for 1 s of simulated time, s | goal | MB on disk for 1 s |",
        "|---|---|---|---|---|",
    ]
    for name, turns in figures.items():
        wall, cpu, stored = (statistics.median(column) for column in zip(*turns, strict=True))
        share = cpu / DURATION
        met = "met" if share < SHARE_AIMED_AT else f"missed by {100 * (share / SHARE_AIMED_AT - 1):.0f} %"
        goal = f"below {SHARE_AIMED_AT:g}, {met}" if name == "this recorder" else ""
        lines.append(
            f"| {name} | {size / wall / 1e6:.0f} | {share:.3f} | {goal} | {stored / DURATION / 1e6:.2f} |"
        )
    return lines


def _bytes(path: Path) -> int:
    files = path.glob("*.mcap") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def _cpu_of_recorder(made: Sequence[Sequence[Record]], path: Path) -> float:
    """Processor time of the recorder's thread, s."""
    parameters = parameters_of("gearbox")
    recorder = Recorder(path, Engine(parameters).checkpoint(), 0)
    began = _clock_of(recorder)
    for records in made:
        recorder.write(records)
    while recorder.stats.queued:
        time.sleep(0.001)
    spent = _clock_of(recorder) - began
    recorder.close()
    return spent


def _clock_of(recorder: Recorder) -> float:
    assert recorder._thread.ident is not None
    return time.clock_gettime(time.pthread_getcpuclockid(recorder._thread.ident))


def _cpu_of_mcap(made: Sequence[Sequence[Record]], path: Path) -> float:
    began = time.thread_time()
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="benchmark")
        channels = {}
        for key, topic in TOPICS.items():
            schema = writer.register_schema(topic.type, "ros2msg", layout.schema(topic.type))
            channels[key] = writer.register_channel(full_topic_name(topic), "cdr", schema)
        for records in made:
            for entry in records:
                writer.add_message(channels[entry.topic], entry.time_ns, entry.data, entry.time_ns)
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    return time.thread_time() - began


def _cpu_of_file(made: Sequence[Sequence[Record]], path: Path) -> float:
    began = time.thread_time()
    with path.open("wb") as stream:
        for records in made:
            for entry in records:
                stream.write(entry.data)
        stream.flush()
        os.fsync(stream.fileno())
    return time.thread_time() - began


def handing(made: Sequence[Sequence[Record]], place: Path) -> Lines:
    """How long handing over holds the engine, at the pace of real time and with a split every SPLIT."""
    parameters = updated(parameters_of("gearbox"), {"recording.split_duration": SPLIT})
    engine = Engine(parameters)
    recorder = Recorder(place / "handed", engine.checkpoint(), 0)
    sink = RecorderSink(recorder, engine)
    chunk = engine.advance()
    held = []
    due = time.perf_counter()
    for records in made[: round(HANDED / parameters.solver.chunk)]:
        due += parameters.solver.chunk
        time.sleep(max(0.0, due - time.perf_counter()))
        # Time goes on without the kernel's work: only what the sink takes is of interest here.
        engine.sample += len(chunk)
        began = time.perf_counter()
        sink.write(chunk, records)
        held.append(1e6 * (time.perf_counter() - began))
    parts = recorder.stats.parts
    recorder.close()
    median, late, worst = np.median(held), np.quantile(held, 0.99), max(held)
    return [
        f"Handing a chunk over every {1e3 * parameters.solver.chunk:g} ms, checkpoints included, a new file "
        f"every {SPLIT:g} s ({parts} files): held for",
        "",
        "| median, us | p99, us | largest, us |",
        "|---|---|---|",
        f"| {median:.0f} | {late:.0f} | {worst:.0f} |",
    ]


def reading(path: Path, place: Path) -> Lines:
    """Reading samples back, and finding a window."""
    bag = recording.open(path)
    size = (bag.end_sample - bag.first_sample) * len(bag.channel_names) * 8
    ways: dict[str, Callable[[], int]] = {
        "`blocks()`, all channels": lambda: sum(block.values.nbytes for block in bag.blocks()),
        '`window(channels=["dte"])`': lambda: bag.window(channels=["dte"]).values.nbytes and size,
        "rosbags AnyReader": lambda: _read_by_rosbags(path),
        "mcap, mcap-ros2-support": lambda: _read_by_mcap(path),
    }
    lines = [
        f"Reading the waveform back ({size / 1e6:.0f} MB of doubles):",
        "",
        "| way | MB/s | times real time |",
        "|---|---|---|",
    ]
    for name, read in ways.items():
        wall = _median(partial(_require, read, size))
        lines.append(f"| {name} | {size / wall / 1e6:.0f} | {DURATION / wall:.1f} |")
    generator = random.Random(1)
    times = [generator.uniform(0.0, DURATION - WINDOW) for _ in range(SEEKS)]
    opened = [_timed(lambda: recording.open(path)) for _ in range(TURNS)]
    sought = [_timed(partial(bag.window, at, at + WINDOW)) for at in times]
    recovered = [_timed(partial(recover, path, place / f"recovered_{turn}")) for turn in range(TURNS)]
    return [
        *lines,
        "",
        "| opening, ms | window of 10 ms anywhere, ms | p95, ms | recovering, MB/s |",
        "|---|---|---|---|",
        f"| {1e3 * statistics.median(opened):.1f} | {1e3 * statistics.median(sought):.1f} "
        f"| {1e3 * np.quantile(sought, 0.95):.1f} | {bag.size / statistics.median(recovered) / 1e6:.0f} |",
    ]


def _read_by_rosbags(path: Path) -> int:
    read = 0
    with AnyReader([path]) as reader:
        connections = [entry for entry in reader.connections if entry.topic == WAVEFORM]
        for connection, _, raw in reader.messages(connections):
            read += reader.deserialize(raw, connection.msgtype).data.nbytes
    return read


def _read_by_mcap(path: Path) -> int:
    read = 0
    for file in path.glob("*.mcap"):
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for *_, message in reader.iter_decoded_messages(topics=[WAVEFORM]):
                read += 8 * len(message.data)
    return read


def verifying(place: Path) -> Lines:
    """Speed of replay verify on one core and on all, beside the engine alone on as many, in turns."""
    cores = sorted(os.sched_getaffinity(0))
    lines = [
        f"Verifying {VERIFIED:g} s, every message of every chunk compared; beside it the engine alone, a "
        "thread on each core and in turns with it. Times real time:",
        "",
        f"| parameters | model | verify, one core | verify, {len(cores)} cores | goal "
        f"| engine alone, {len(cores)} cores | verify of engine |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in ("gearbox", "paper"):
        for model in ("traditional", "compared", "improved"):
            parameters = parameters_of(name, model=model)
            bag = recording.open(_simulated(parameters, place / f"verified_{name}_{model}"))
            with _confined(cores[:1]):
                alone = VERIFIED / _median(partial(_verify, bag))
            turns = [
                (
                    VERIFIED / _timed(partial(_verify, bag)),
                    VERIFIED / _timed(partial(_engines, parameters, cores)),
                )
                for _ in range(TURNS)
            ]
            verified, engine = (statistics.median(column) for column in zip(*turns, strict=True))
            share = statistics.median(ours / theirs for ours, theirs in turns)
            goal = ""
            if model == "improved":
                missed = f"missed by {100 * (1 - verified / VERIFY_AIMED_AT):.0f} %"
                goal = f"at least {VERIFY_AIMED_AT:g}, {'met' if verified >= VERIFY_AIMED_AT else missed}"
            lines.append(
                f"| {name}.yaml | {model} | {alone:.2f} | {verified:.2f} | {goal} | {engine:.2f} "
                f"| {100 * share:.0f} % |"
            )
    return lines


def _engines(parameters: Parameters, cores: Sequence[int]) -> None:
    """VERIFIED by engines alone, a share each."""
    samples = round(VERIFIED / parameters.solver.sample_interval / len(cores))
    with ThreadPoolExecutor(len(cores)) as workers:
        list(workers.map(lambda _: Engine(parameters).advance(samples), cores))


def _simulated(parameters: Parameters, path: Path) -> Path:
    engine = Engine(parameters)
    recorder = Recorder(path, engine.checkpoint(), 0)
    run = Run(engine, Encoder(parameters, 0), [RecorderSink(recorder, engine)], duration=VERIFIED)
    while not run.state.ended:
        run.step()
    run.close()
    return path


def _verify(bag: recording.Recording) -> None:
    if (found := verify_recording(bag).difference) is not None:
        raise RuntimeError(f"{bag.path}: {found}")


@contextmanager
def _confined(cores: Sequence[int]) -> Iterator[None]:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _require(read: Callable[[], int], size: int) -> None:
    if (found := read()) != size:
        raise RuntimeError(f"read {found} bytes of {size}")


def _median(act: Callable[[], object]) -> float:
    act()
    return statistics.median(_timed(act) for _ in range(TURNS))


def _timed(act: Callable[[], object]) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began
