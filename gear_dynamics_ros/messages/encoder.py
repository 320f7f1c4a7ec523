"""Chunks, commands and events as ROS 2 messages in CDR, without ROS.

The same bytes are published and recorded.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import (
    CHANNELS,
    COLUMN,
    ENERGIES,
    IMPACTS,
    PACE,
)
from gear_dynamics_ros.chunk import Chunk, Commands, Counters
from gear_dynamics_ros.messages.cdr import message_class, require_stampable, serialize, stamp
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.topics import ARRAY, CHUNK_TOPICS, CLOCK, JOINT_STATE, STRING, WRENCH


class Record(NamedTuple):
    """One message, ready to be published and recorded."""

    topic: str  # key in TOPICS
    time_ns: int
    data: bytes


def bearing_frame(prefix: str, gear: str) -> str:
    """Name of the frame of a bearing; ``gear`` is one of GEARS, ``prefix`` is joint_prefix."""
    return f"{prefix}{gear}_bearing"


def waveform_message(names: Sequence[str], samples: NDArray[np.float64], row: str = "sample") -> Any:
    """Float64MultiArray of samples (n, len(names)); ``row`` is the label of the first dimension."""
    dimension = message_class("std_msgs/msg/MultiArrayDimension")
    rows, columns = samples.shape
    layout = message_class("std_msgs/msg/MultiArrayLayout")(
        dim=[
            dimension(label=row, size=rows, stride=rows * columns),
            dimension(label=",".join(names), size=columns, stride=columns),
        ],
        data_offset=0,
    )
    return message_class(ARRAY)(layout=layout, data=samples.reshape(-1))


def joint_state(
    time_ns: int,
    names: Iterable[str],
    position: Sequence[float],
    velocity: Sequence[float],
    effort: Sequence[float],
) -> Any:
    """JointState stamped ``time_ns``; each of the three sequences may be empty."""
    return message_class(JOINT_STATE)(
        header=_header(time_ns, ""),
        name=list(names),
        position=np.array(position, dtype=np.float64),
        velocity=np.array(velocity, dtype=np.float64),
        effort=np.array(effort, dtype=np.float64),
    )


@dataclass(frozen=True, slots=True)
class _End:
    """The last sample of a chunk: its stamp in ns, and its values by the name of the channel."""

    time_ns: int
    values: NDArray[np.float64]

    def __getitem__(self, channel: str) -> float:
        return float(self.values[COLUMN[channel]])


class Encoder:
    """Makes the messages of one run. Stamps are ``epoch_ns`` plus simulated time, ns.

    Raises GearboxError if ``epoch_ns`` is beyond the stamps of ROS.
    """

    def __init__(self, parameters: Parameters, epoch_ns: int) -> None:
        prefix = parameters.joint_prefix
        require_stampable(epoch_ns)
        self._epoch_ns = epoch_ns
        self._interval_ns = parameters.solver.sample_interval_ns
        self._shafts = (f"{prefix}driving", f"{prefix}driven")
        self._joints = (*self._shafts, f"{prefix}mesh")
        self._channels = tuple(parameters.waveform_channels)
        self._columns = [COLUMN[name] for name in self._channels]
        self._all_channels = self._columns in (list(range(len(CHANNELS))), list(range(len(COLUMN))))
        self._waveform = _RowPacker("sample", self._channels)
        self._energy = _RowPacker("sample", [energy.name for energy in ENERGIES])
        self._clock_ns = parameters.clock_period_ns
        self._impacts = _RowPacker("impact", [entry.name for entry in IMPACTS])
        self._pacing = _RowPacker("report", [entry.name for entry in PACE])
        self._encode: dict[str, Callable[[Chunk, _End], bytes]] = {
            "joint_states": self._joint_states,
            "dte": lambda _, end: _float64(end["dte"]),
            "mesh_force": lambda _, end: _float64(end["mesh_force"]),
            "pressure_angle": lambda _, end: _float64(end["pressure_angle"]),
            "driving_bearing_force": partial(self._bearing_force, "driving"),
            "driven_bearing_force": partial(self._bearing_force, "driven"),
            "meshing_state": lambda _, end: _int8(_flank(end["meshing_state"])),
            "energy": lambda chunk, _: self._energy.pack(chunk.energies[None, :]),
            "impacts": self._impact_rows,
            "clock": self._clock,
            "waveform": lambda chunk, _: self._waveform.pack(self._selected(chunk.samples)),
        }
        self._joint_state = _StampedMessage(_joints_at_rest(self._joints), _JOINT_NUMBERS)
        self._applied = _StampedMessage(_no_commands(self._shafts), _APPLIED_NUMBERS)
        self._bearings = {
            gear: _StampedMessage(_zero_wrench(bearing_frame(prefix, gear)), _FORCE_AND_TORQUE)
            for gear in ("driving", "driven")
        }

    def require_stampable(self, sample: int) -> None:
        """Raise GearboxError if the time of ``sample`` is beyond the stamps of ROS."""
        require_stampable(self._epoch_ns + sample * self._interval_ns)

    def chunk(self, chunk: Chunk, wanted: Collection[str] = CHUNK_TOPICS) -> list[Record]:
        """The messages of one chunk on ``wanted`` topics, with the stamp of its last sample.

        In the order of CHUNK_TOPICS; none if the chunk is empty.
        """
        if not (len(chunk) and wanted):
            return []
        time_ns = self._epoch_ns + chunk.last_ns
        # -0.0 is 0.0, which says more to a reader; the waveform keeps the bits.
        end = _End(time_ns, chunk.samples[-1] + 0.0)
        payloads = ((topic, encode(chunk, end)) for topic, encode in self._encode.items() if topic in wanted)
        return [Record(topic, time_ns, data) for topic, data in payloads if data]

    def applied(self, commands: Commands, sample: int) -> Record:
        """Message of ``commands``, in force from ``sample`` on."""
        time_ns = self._epoch_ns + sample * self._interval_ns
        return Record("applied_command", time_ns, self._applied.pack(time_ns, *_applied_numbers(commands)))

    def event(
        self, kind: str, sample: int, message: str, counters: Counters, **details: Mapping[str, Any]
    ) -> Record:
        """Message of an operator event before ``sample``; ``kind`` is one of EVENTS.

        ``details`` are entries of its kind, such as the changed parameters.
        """
        elapsed_ns = sample * self._interval_ns
        content = {"sample": sample, "time": elapsed_ns / 1e9, "event": kind, "message": message}
        text = json.dumps(content | {"counters": counters._asdict()} | details)
        data = serialize(STRING, message_class(STRING)(data=text))
        return Record("event", self._epoch_ns + elapsed_ns, data)

    def pacing(self, time_ns: int, row: Sequence[float]) -> Record:
        """Message of a report of the pacing: ``row`` has the columns PACE."""
        data = self._pacing.pack(np.array([row], dtype=np.float64))
        return Record("pacing", time_ns, data)

    def model_info(self, time_ns: int, text: str) -> Record:
        """Message of the description ``text`` of the model, valid from ``time_ns`` on."""
        return Record("model_info", time_ns, serialize(STRING, message_class(STRING)(data=text)))

    def _clock(self, chunk: Chunk, end: _End) -> bytes:
        """Empty unless a multiple of 1/clock_rate lies in the chunk, whenever the run started."""
        if not self._clock_ns:
            return b""
        next_tick_ns = -(-chunk.start_ns // self._clock_ns) * self._clock_ns
        if next_tick_ns >= chunk.start_ns + len(chunk) * chunk.interval_ns:
            return b""
        return serialize(CLOCK, message_class(CLOCK)(clock=stamp(end.time_ns)))

    def _joint_states(self, chunk: Chunk, end: _End) -> bytes:
        return self._joint_state.pack(
            end.time_ns,
            *chunk.angles[-1].tolist(),
            end["dte"],
            len(self._joints),
            end["driving_speed"],
            end["driven_speed"],
            end["dte_rate"],
            len(self._joints),
            end["drive_torque"],
            end["load_torque"],
            end["mesh_force"],
        )

    def _bearing_force(self, gear: str, _: Chunk, end: _End) -> bytes:
        return self._bearings[gear].pack(
            end.time_ns,
            end[f"{gear}_contact_force_x"] + end[f"{gear}_film_force_x"],
            end[f"{gear}_contact_force_y"] + end[f"{gear}_film_force_y"],
            *_OTHER_COMPONENTS,
        )

    def _impact_rows(self, chunk: Chunk, _: _End) -> bytes:
        return self._impacts.pack(chunk.impacts) if len(chunk.impacts) else b""

    def _selected(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        return samples if self._all_channels else np.ascontiguousarray(samples[:, self._columns])


class _RowPacker:
    """Makes CDR of rows with fixed names. All bytes before the numbers are made once for each row count."""

    def __init__(self, row: str, names: Sequence[str]) -> None:
        self._row = row
        self._names = names
        self._prefixes: dict[int, bytes] = {}

    def pack(self, rows: NDArray[np.float64]) -> bytes:
        prefix = self._prefixes.get(len(rows))
        if prefix is None:
            whole = serialize(ARRAY, waveform_message(self._names, rows, self._row))
            prefix = self._prefixes[len(rows)] = whole[: len(whole) - rows.nbytes]
        # The CDR header says little endian; the byte order of NumPy may be another.
        return b"".join((prefix, rows.astype("<f8", order="C", copy=False).data))


class _StampedMessage:
    """Makes CDR of a message that is constant except for the stamp of its header and its last numbers."""

    def __init__(self, example: bytes, numbers: str) -> None:
        """``numbers`` is the struct format of the numbers; all other bytes are those of ``example``."""
        self._constant = example[_STAMP_END : len(example) - struct.calcsize(f"<{numbers}")]
        self._whole = struct.Struct(f"<4siI{len(self._constant)}s{numbers}")

    def pack(self, time_ns: int, *numbers: float) -> bytes:
        return self._whole.pack(_CDR_LITTLE_ENDIAN, *divmod(time_ns, 1_000_000_000), self._constant, *numbers)


# The messages of every chunk are packed by hand: the general serialiser takes several times as long.
_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_STAMP_END = len(_CDR_LITTLE_ENDIAN) + 8
# Position, velocity and effort; before the last two their number of entries, padded to eight bytes.
_JOINT_NUMBERS = "3dQ3dQ3d"
# Velocity and effort of two shafts; before the last its number of entries, padded to eight bytes.
_APPLIED_NUMBERS = "2dQ2d"
_FORCE_AND_TORQUE = "6d"
_OTHER_COMPONENTS = (0.0,) * 4  # force along z, torques


def _float64(value: float) -> bytes:
    return _CDR_LITTLE_ENDIAN + struct.pack("<d", value)


def _int8(value: int) -> bytes:
    return _CDR_LITTLE_ENDIAN + struct.pack("<b", value)


def _flank(state: float) -> int:
    return int(state) if math.isfinite(state) else 0


def _header(time_ns: int, frame_id: str) -> Any:
    return message_class("std_msgs/msg/Header")(stamp=stamp(time_ns), frame_id=frame_id)


def _joints_at_rest(joints: Sequence[str]) -> bytes:
    zeros = [0.0] * len(joints)
    return serialize(JOINT_STATE, joint_state(0, joints, zeros, zeros, zeros))


def _applied_numbers(commands: Commands) -> tuple[float, ...]:
    effort = (commands.drive_torque, commands.load_torque)
    return (commands.speed, math.nan, len(effort), *effort)


def _no_commands(shafts: Sequence[str]) -> bytes:
    zeros = [0.0] * len(shafts)
    return serialize(JOINT_STATE, joint_state(0, shafts, (), zeros, zeros))


def _zero_wrench(frame_id: str) -> bytes:
    zero = message_class("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
    wrench = message_class("geometry_msgs/msg/Wrench")(force=zero, torque=zero)
    return serialize(WRENCH, message_class(WRENCH)(header=_header(0, frame_id), wrench=wrench))
