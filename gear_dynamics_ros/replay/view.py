"""Shows a recording in Rerun: what a live viewer draws, from the messages that were recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNEL_NAMES, IMPACTS, PACE
from gear_dynamics_ros.chunk import Commands
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import updated
from gear_dynamics_ros.recording.reader import Recording
from gear_dynamics_ros.system.files import new_named_file, require_new
from gear_dynamics_ros.viewer import require_rerun

if TYPE_CHECKING:
    from gear_dynamics_ros.viewer.destinations import Destination
    from gear_dynamics_ros.viewer.run_block import RunBlock

BLOCK_SPAN: Final = 0.25  # s of simulated time drawn at once
SENT_BLOCKS: Final = 8  # blocks sent at once
FLUSH_TIMEOUT: Final = 60.0  # s of wall time
PACE_COLUMN: Final = {entry.name: i for i, entry in enumerate(PACE)}

Rows = NDArray[np.float64]


def require_viewable(recording: Recording) -> None:
    """Raise UsageError if ``recording`` lacks what the pictures need, or Rerun can't be imported."""
    recording.require_topic("waveform")
    missing = [name for name in CHANNEL_NAMES if name not in recording.channel_names]
    if missing:
        raise UsageError(
            f"{recording.path} has no channel {', '.join(missing)}: the viewer needs all of them: "
            "record without waveform_channels"
        )
    require_rerun("replay view shows a recording in Rerun")


@contextmanager
def file_of(recording: Recording, path: Path) -> Iterator[Destination]:
    """The new .rrd file ``path`` to draw ``recording`` into; it appears, with its layouts, at the end.

    Raises UsageError if one of the files exists or can't be made.
    """
    from gear_dynamics_ros.viewer.destinations import FileDestination, layout_files

    layouts = [beside for _, beside in layout_files(path)]
    for beside in layouts:
        require_new(beside)
    try:
        with new_named_file(path) as draft:
            target = FileDestination(recording.parameters, draft, path)
            yield target
            target.disconnect()
    except BaseException:
        for beside in layouts:
            beside.unlink(missing_ok=True)
        raise


@contextmanager
def server_of(recording: Recording, port: int, web_port: int) -> Iterator[Destination]:
    """A server on the loopback interface that shows ``recording`` in a browser until the block ends.

    Raises UsageError if a port is taken.
    """
    from gear_dynamics_ros.viewer.destinations import server_of_recording

    parameters = updated(recording.parameters, {"rerun.port": port, "rerun.web_port": web_port})
    target = server_of_recording(parameters)
    try:
        yield target
    finally:
        target.disconnect()
        target.close()


def draw_recording(
    recording: Recording, first: int, end: int, target: Destination, progress: Callable[[int], None]
) -> None:
    """Draw the samples ``first`` to before ``end`` into ``target``; ``progress`` gets how many are done.

    Raises GearboxError if samples are missing or a message is damaged.
    """
    target.open()
    display = target.display
    interval = recording.parameters.solver.sample_interval
    for event in recording.events:
        if first <= event.sample <= end:
            display.log_event(event)
    if "pacing" in recording.recorded:
        for _, rows in recording.rows("pacing"):
            for row in rows:
                time = float(row[PACE_COLUMN["time"]])
                if first <= time / interval <= end:
                    display.draw_pace(time, float(row[PACE_COLUMN["real_time_factor"]]))
    for number, block in enumerate(recorded_blocks(recording, first, end)):
        display.draw(block)
        if number % SENT_BLOCKS == 0:
            display.canvas.send()
            target.flush(FLUSH_TIMEOUT)
        progress(block.first_sample + len(block.rows) - first)
    display.finish()
    display.canvas.send()
    target.flush(FLUSH_TIMEOUT)


def recorded_blocks(recording: Recording, first: int, end: int) -> Iterator[RunBlock]:
    """Blocks of the samples ``first`` to before ``end``, with commands, energies and impacts.

    One block at a time is in memory.
    """
    from gear_dynamics_ros.viewer.run_block import RunBlock, joined

    size = max(1, round(BLOCK_SPAN / recording.parameters.solver.sample_interval))
    energies, impacts = _Reader(recording, "energy"), _Reader(recording, "impacts")
    for samples in recording.pieces(first, end, CHANNEL_NAMES, size):
        begin, stop = samples.first, samples.first + len(samples)
        ended = [rows for _, rows in impacts.until(begin, stop)]
        latest = energies.until(begin, stop)[-1:]
        yield RunBlock(
            begin,
            joined([samples.values]),
            _commands(recording, begin, stop),
            [(sample, rows[-1]) for sample, rows in latest],
            np.concatenate(ended) if ended else np.empty((0, len(IMPACTS))),
        )


class _Reader:
    """Reads the rows of one topic along with the samples."""

    def __init__(self, recording: Recording, topic: str) -> None:
        self._recording = recording
        self._messages = recording.rows(topic) if topic in recording.recorded else iter(())
        self._next: tuple[int, Rows] | None = None

    def until(self, first: int, end: int) -> list[tuple[int, Rows]]:
        """Sample and rows of each message of the samples ``first`` to before ``end``."""
        found: list[tuple[int, Rows]] = []
        while True:
            if self._next is None:
                message = next(self._messages, None)
                if message is None:
                    return found
                self._next = self._recording.sample_of(message[0]), np.array(message[1])
            sample, rows = self._next
            if sample >= end:
                return found
            if sample >= first:
                found.append((sample, rows))
            self._next = None


def _commands(recording: Recording, first: int, end: int) -> list[tuple[int, Commands]]:
    """Commands in force at the sample ``first``, then those that begin before ``end``."""
    in_force = recording.start.commands
    later: list[tuple[int, Commands]] = []
    for sample, commands in recording.commands:
        if sample <= first:
            in_force = commands
        elif sample < end:
            later.append((sample, commands))
    return [(first, in_force), *later]
