"""Chunks, commands and events as ROS 2 messages in CDR, without ROS.

The same bytes are published and recorded.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
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
from gear_dynamics_ros.topics import ARRAY, CLOCK, JOINT_STATE, STRING, WRENCH


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
        self._joint_state = _StampedMessage(_joints_at_rest(self._joints), _JOINT_NUMBERS)
        self._bearings = {
            gear: _StampedMessage(_zero_wrench(bearing_frame(prefix, gear)), _FORCE_AND_TORQUE)
            for gear in ("driving", "driven")
        }

    def require_stampable(self, sample: int) -> None:
        """Raise GearboxError if the time of ``sample`` is beyond the stamps of ROS."""
        require_stampable(self._epoch_ns + sample * self._interval_ns)

    def chunk(self, chunk: Chunk) -> list[Record]:
        """All messages of one chunk, with the stamp of its last sample; none if the chunk is empty."""
        if not len(chunk):
            return []
        time_ns = self._epoch_ns + chunk.last_ns
        # -0.0 is 0.0, which says more to a reader; the waveform keeps the bits.
        last = dict(zip(COLUMN, (chunk.samples[-1] + 0.0).tolist(), strict=False))
        payloads = {
            "joint_states": self._joint_states(time_ns, last, chunk.angles[-1].tolist()),
            "dte": _float64(last["dte"]),
            "mesh_force": _float64(last["mesh_force"]),
            "pressure_angle": _float64(last["pressure_angle"]),
            "driving_bearing_force": self._bearing_force(time_ns, last, "driving"),
            "driven_bearing_force": self._bearing_force(time_ns, last, "driven"),
            "meshing_state": _int8(_flank(last["meshing_state"])),
            "energy": self._energy.pack(chunk.energies[None, :]),
        }
        if len(chunk.impacts):
            payloads["impacts"] = self._impacts.pack(chunk.impacts)
        if self._ticks(chunk):
            payloads["clock"] = serialize(CLOCK, message_class(CLOCK)(clock=stamp(time_ns)))
        payloads["waveform"] = self._waveform.pack(self._selected(chunk.samples))
        return [Record(topic, time_ns, data) for topic, data in payloads.items()]

    def applied(self, commands: Commands, sample: int) -> Record:
        """Message of ``commands``, in force from ``sample`` on."""
        time_ns = self._epoch_ns + sample * self._interval_ns
        message = joint_state(
            time_ns,
            self._shafts,
            (),
            (commands.speed, math.nan),
            (commands.drive_torque, commands.load_torque),
        )
        return Record("applied_command", time_ns, serialize(JOINT_STATE, message))

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

    def _ticks(self, chunk: Chunk) -> bool:
        """Whether a multiple of 1/clock_rate lies in the chunk, independent of the start of the run."""
        if not self._clock_ns:
            return False
        next_tick_ns = -(-chunk.start_ns // self._clock_ns) * self._clock_ns
        return next_tick_ns < chunk.start_ns + len(chunk) * chunk.interval_ns

    def _joint_states(self, time_ns: int, last: dict[str, float], angles: list[float]) -> bytes:
        return self._joint_state.pack(
            time_ns,
            *angles,
            last["dte"],
            len(self._joints),
            last["driving_speed"],
            last["driven_speed"],
            last["dte_rate"],
            len(self._joints),
            last["drive_torque"],
            last["load_torque"],
            last["mesh_force"],
        )

    def _bearing_force(self, time_ns: int, last: dict[str, float], gear: str) -> bytes:
        return self._bearings[gear].pack(
            time_ns,
            last[f"{gear}_contact_force_x"] + last[f"{gear}_film_force_x"],
            last[f"{gear}_contact_force_y"] + last[f"{gear}_film_force_y"],
            *_OTHER_COMPONENTS,
        )

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


def _zero_wrench(frame_id: str) -> bytes:
    zero = message_class("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
    wrench = message_class("geometry_msgs/msg/Wrench")(force=zero, torque=zero)
    return serialize(WRENCH, message_class(WRENCH)(header=_header(0, frame_id), wrench=wrench))
