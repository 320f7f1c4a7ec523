"""The groups of parameters: to add a parameter, add a field here, or in tree.py for one outside all groups.

A group does not check its values: ``Parameters`` does, once the tree is complete. SI units throughout.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, Final

from gear_dynamics_ros.parameters.decimals import exact_decimal
from gear_dynamics_ros.parameters.specification import parameter
from gear_dynamics_ros.topics import TOPICS

MOST_HARMONICS: Final = 32
MOST_PROCESSORS: Final = 4096
NANOSECOND: Final = Fraction(1, 10**9)  # s


def _harmonics(default: float, help: str, *, unit: str = "", limit: float) -> Any:
    return parameter(
        (default,),
        help,
        unit=unit,
        minimum=-limit,
        maximum=limit,
        length=(1, MOST_HARMONICS),
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class GearParameters:
    """One gear of the pair."""

    teeth: int = parameter(40, "number of teeth Z of this gear", minimum=5, maximum=1000)
    mass: float = parameter(1.0, "mass m of this gear", unit="kg", minimum=1e-9, maximum=1e6)
    inertia: float = parameter(
        2.23e-3, "moment of inertia J about the shaft", unit="kg m^2", minimum=1e-15, maximum=1e6
    )


@dataclass(frozen=True, slots=True)
class GearPairParameters:
    """Geometry and inertia of the two gears."""

    module: float = parameter(0.003, "module M of both gears", unit="m", minimum=1e-6, maximum=1.0)
    pressure_angle: float = parameter(
        0.3490658503988659,
        "nominal pressure angle alpha_0",
        unit="rad",
        minimum=1e-3,
        maximum=math.pi / 3.0,
        exclusive_maximum=True,
    )
    backlash: float = parameter(
        50.0e-6, "total backlash 2 b_0 along the line of action", unit="m", minimum=1e-9, maximum=0.1
    )
    driving: GearParameters = field(default_factory=GearParameters)
    driven: GearParameters = field(default_factory=GearParameters)


@dataclass(frozen=True, slots=True)
class MeshParameters:
    """Stiffness, damping and static transmission error of the mesh, as Fourier series in the mesh phase."""

    stiffness: float = parameter(
        3.0e8, "mean mesh stiffness k_m", unit="N/m", minimum=1.0, maximum=1e13, runtime=True
    )
    stiffness_cos: tuple[float, ...] = _harmonics(
        0.08,
        "cosine amplitudes of the stiffness at 1, 2, ... times the mesh frequency, relative to the mean",
        limit=1.0,
    )
    stiffness_sin: tuple[float, ...] = _harmonics(
        0.0,
        "sine amplitudes of the stiffness, relative to the mean; a missing harmonic counts as 0",
        limit=1.0,
    )
    damping_ratio: float = parameter(
        0.1, "damping ratio xi_2 of the mesh", minimum=0.0, maximum=10.0, runtime=True
    )
    error_mean: float = parameter(
        0.0, "mean static transmission error e_m", unit="m", minimum=-0.1, maximum=0.1, runtime=True
    )
    error_cos: tuple[float, ...] = _harmonics(
        9.2e-6,
        "cosine amplitudes of the static transmission error at 1, 2, ... times the mesh frequency",
        unit="m",
        limit=0.1,
    )
    error_sin: tuple[float, ...] = _harmonics(
        0.0,
        "sine amplitudes of the static transmission error; a missing harmonic counts as 0",
        unit="m",
        limit=0.1,
    )


@dataclass(frozen=True, slots=True)
class ToothSurfaceParameters:
    """Roughness profile of the flanks of one gear."""

    roughness: float = parameter(
        0.8e-6,
        "mean roughness Ra of the tooth flanks; 0: smooth flanks",
        unit="m",
        minimum=0.0,
        maximum=1e-2,
        runtime=True,
    )
    fractal_dimension: float = parameter(
        1.1,
        "fractal dimension D of the surface profile",
        minimum=1.0,
        exclusive_minimum=True,
        maximum=2.0,
        exclusive_maximum=True,
    )
    offset: float = parameter(
        0.0,
        "phase psi of all waves of the surface profile",
        unit="rad",
        minimum=-2.0 * math.pi,
        maximum=2.0 * math.pi,
    )


@dataclass(frozen=True, slots=True)
class SurfaceParameters:
    """Fractal roughness profiles of both gears."""

    scale: float = parameter(
        1.5,
        "frequency ratio lambda of successive waves of the surface profile",
        minimum=1.0,
        exclusive_minimum=True,
        maximum=100.0,
    )
    waves: int = parameter(8, "number N of waves in the surface profile", minimum=1, maximum=32)
    driving: ToothSurfaceParameters = field(default_factory=ToothSurfaceParameters)
    driven: ToothSurfaceParameters = field(default_factory=ToothSurfaceParameters)


@dataclass(frozen=True, slots=True)
class MaterialParameters:
    """Elastic material of one bearing part."""

    youngs_modulus: float = parameter(210.0e9, "Young's modulus E", unit="Pa", minimum=1.0, maximum=1e14)
    poissons_ratio: float = parameter(
        0.3, "Poisson's ratio nu", minimum=-1.0, exclusive_minimum=True, maximum=0.5
    )


@dataclass(frozen=True, slots=True)
class BearingParameters:
    """Journal bearing of one gear."""

    clearance: float = parameter(
        27.0e-6,
        "radial clearance b_b at which shaft and sleeve touch; must be less than oil_clearance",
        unit="m",
        minimum=1e-9,
        maximum=0.1,
    )
    length: float = parameter(13.0e-3, "length L of the bearing", unit="m", minimum=1e-6, maximum=10.0)
    diameter: float = parameter(50.0e-3, "diameter D of the bearing", unit="m", minimum=1e-6, maximum=10.0)
    oil_clearance: float = parameter(
        150.0e-6,
        "radial clearance C of the oil film; must be more than clearance",
        unit="m",
        minimum=1e-9,
        maximum=0.1,
    )
    restitution: float = parameter(
        0.2, "coefficient of restitution eta of the contact", minimum=0.05, maximum=1.0, runtime=True
    )
    kelvin_stiffness: float = parameter(
        1.0e8,
        "contact stiffness k_b; used by model traditional only",
        unit="N/m",
        minimum=1.0,
        maximum=1e13,
        runtime=True,
    )
    kelvin_damping: float = parameter(
        2000.0,
        "contact damping c_b; used by model traditional only",
        unit="N s/m",
        minimum=0.0,
        maximum=1e9,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class BearingPairParameters:
    """Both bearings: what they have in common, and each one."""

    shaft: MaterialParameters = field(default_factory=MaterialParameters)
    sleeve: MaterialParameters = field(default_factory=MaterialParameters)
    minimum_impact_speed: float = parameter(
        1.0e-3,
        "lower limit v_min of the impact speed in the contact law",
        unit="m/s",
        minimum=1e-9,
        maximum=100.0,
        runtime=True,
    )
    driving: BearingParameters = field(default_factory=BearingParameters)
    driven: BearingParameters = field(default_factory=BearingParameters)


@dataclass(frozen=True, slots=True)
class OilParameters:
    """Oil film of both bearings; used by model improved only."""

    viscosity: float = parameter(
        2.28e-2, "dynamic viscosity mu of the oil", unit="Pa s", minimum=0.0, maximum=1e3, runtime=True
    )
    eccentricity_limit: float = parameter(
        0.98,
        "relative eccentricity above which the film force stays at its value there",
        minimum=0.1,
        maximum=0.999,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class GovernorParameters:
    """PI governor that sets the drive torque with operation.control = speed."""

    proportional: float = parameter(
        0.5,
        "proportional gain of the speed governor",
        unit="N m s/rad",
        minimum=0.0,
        maximum=1e6,
        runtime=True,
    )
    integral: float = parameter(
        5.0, "integral gain of the speed governor", unit="N m/rad", minimum=0.0, maximum=1e9, runtime=True
    )
    torque_limit: float = parameter(
        200.0,
        "largest drive torque of the governor in either direction",
        unit="N m",
        minimum=1e-9,
        maximum=1e6,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class OperationParameters:
    """Start state, commands in force at the start, and what limits or replaces them."""

    control: str = parameter(
        "speed",
        "source of the drive torque; torque: the torque command; speed: a PI governor that holds the speed",
        choices=("torque", "speed"),
        runtime=True,
    )
    speed: float = parameter(
        1623.156,
        "start speed of the driving gear and speed set-point; its magnitude must not exceed speed_limit",
        unit="rad/s",
        minimum=-1e6,
        maximum=1e6,
        runtime=True,
    )
    drive_torque: float = parameter(
        30.0, "torque T_M on the driving shaft", unit="N m", minimum=-1e6, maximum=1e6, runtime=True
    )
    load_torque: float = parameter(
        30.0,
        "torque T_L on the driven shaft; positive: against forward rotation",
        unit="N m",
        minimum=-1e6,
        maximum=1e6,
        runtime=True,
    )
    load_law: str = parameter(
        "constant",
        "constant: load_torque itself; brake: load_torque tanh(omega_2 / 1 rad/s), against the motion",
        choices=("constant", "brake"),
        runtime=True,
    )
    load_viscous: float = parameter(
        0.0,
        "viscous load on the driven shaft: torque per speed",
        unit="N m s/rad",
        minimum=0.0,
        maximum=1e6,
        runtime=True,
    )
    speed_limit: float = parameter(
        5000.0,
        "largest speed of either gear; the run ends when it is exceeded",
        unit="rad/s",
        minimum=1e-6,
        maximum=1e6,
        runtime=True,
    )
    governor: GovernorParameters = field(default_factory=GovernorParameters)
    command_timeout: float = parameter(
        0.0,
        "wall time without a command until on_timeout applies; 0: never",
        unit="s",
        minimum=0.0,
        maximum=1e9,
        runtime=True,
    )
    on_timeout: str = parameter(
        "hold",
        "hold: keep the last commands; release: both torques to 0",
        choices=("hold", "release"),
        runtime=True,
    )
    initial: str = parameter(
        "touching",
        "start state, drive flanks in contact; touching: at operation.speed; rest: both speeds 0",
        choices=("touching", "rest"),
    )


@dataclass(frozen=True)  # no slots: cached_property keeps its result in __dict__
class SolverParameters:
    """Grid of simulated time: steps, samples, chunks."""

    step: float = parameter(2.0e-6, "fixed integration step", unit="s", minimum=1e-9, maximum=1e-2)
    sample_interval: float = parameter(
        1.0e-5,
        "interval between waveform samples: a whole number of nanoseconds and of steps",
        unit="s",
        minimum=1e-9,
        maximum=1.0,
    )
    chunk: float = parameter(
        2.0e-3,
        "simulated time of one engine call, a whole number of samples; commands act from its first sample on",
        unit="s",
        minimum=1e-9,
        maximum=10.0,
    )

    @cached_property
    def sample_interval_ns(self) -> int:
        """Sample interval in nanoseconds, exact."""
        return int(exact_decimal(self.sample_interval) / NANOSECOND)

    @cached_property
    def steps_per_sample(self) -> int:
        """Integration steps in a sample interval, exact."""
        return int(exact_decimal(self.sample_interval) / exact_decimal(self.step))

    @cached_property
    def samples_per_chunk(self) -> int:
        """Samples in a chunk, exact."""
        return int(exact_decimal(self.chunk) / exact_decimal(self.sample_interval))


@dataclass(frozen=True, slots=True)
class PacingParameters:
    """Simulated time against wall time."""

    real_time_factor: float = parameter(
        1.0,
        "simulated time per wall time; 0: as fast as possible",
        minimum=0.0,
        maximum=1e6,
        runtime=True,
    )
    duration: float = parameter(
        0.0, "simulated time after which the run ends; 0: no end", unit="s", minimum=0.0, maximum=1e9
    )
    on_overrun: str = parameter(
        "slip",
        "after a late chunk; slip: simulated time stays behind; catch_up: the next chunks are made at once, "
        "up to catch_up_limit; error: the run ends",
        choices=("slip", "catch_up", "error"),
        runtime=True,
    )
    catch_up_limit: float = parameter(
        0.1,
        "largest delay that catch_up makes up for; what exceeds it is lost, as with slip",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
        runtime=True,
    )
    priority: int = parameter(
        0,
        "real-time priority (SCHED_FIFO) of the thread that computes, on Linux; 0: as any other thread",
        minimum=0,
        maximum=99,
    )
    processors: str = parameter(
        "", "processors that the thread that computes may run on, on Linux, as '2' or '0,2-3'; empty: all"
    )
    lock_memory: bool = parameter(
        False, "whether the memory of the node stays resident, so that the system never swaps it out"
    )

    @property
    def processor_numbers(self) -> frozenset[int]:
        """The numbers in ``processors``. Raises ValueError if they are not written as a list of ranges."""
        numbers: set[int] = set()
        for entry in filter(None, self.processors.replace(" ", "").split(",")):
            first, _, last = entry.partition("-")
            if not (first.isdecimal() and (last.isdecimal() or entry == first)):
                raise ValueError(entry)
            lowest, highest = int(first), int(last or first)
            if not lowest <= highest < MOST_PROCESSORS:
                raise ValueError(entry)
            numbers.update(range(lowest, highest + 1))
        return frozenset(numbers)


@dataclass(frozen=True, slots=True)
class SteppingParameters:
    """The service ~/step."""

    chunks: int = parameter(
        1,
        "number of chunks that one call of ~/step simulates while paused",
        minimum=1,
        maximum=1_000_000,
        runtime=True,
    )
    timeout: float = parameter(
        10.0,
        "wall time after which a call of ~/step fails",
        unit="s",
        minimum=1e-6,
        maximum=3600.0,
        runtime=True,
    )


@dataclass(frozen=True, slots=True)
class CheckpointParameters:
    """The services ~/save_checkpoint and ~/restore_checkpoint."""

    path: str = parameter(
        "", "file that ~/save_checkpoint writes and ~/restore_checkpoint reads; empty: no file"
    )


@dataclass(frozen=True, slots=True)
class RecordingParameters:
    """What is recorded, where to, and in which files."""

    path: str = parameter("", "folder to create for the recording; it must not exist; empty: no recording")
    mode: str = parameter(
        "continuous",
        "continuous: record everything; ring: keep the last ring_duration in memory and write it when "
        "~/snapshot is called or a fault ends the run",
        choices=("continuous", "ring"),
    )
    ring_duration: float = parameter(
        5.0,
        "least simulated time in the ring; 1 s takes 23 MB of memory with the default parameters",
        unit="s",
        minimum=1e-6,
        maximum=3600.0,
    )
    split_size: int = parameter(
        0, "file size at which a new file begins; 0: never", unit="B", minimum=0, maximum=1 << 50
    )
    split_duration: float = parameter(
        0.0,
        "simulated time after which a new file begins; 0: never",
        unit="s",
        minimum=0.0,
        maximum=1e9,
    )
    checkpoint_interval: float = parameter(
        1.0,
        "simulated time between checkpoints in the recording, where a replay can start; 0: none",
        unit="s",
        minimum=0.0,
        maximum=1e9,
    )
    topics: tuple[str, ...] = parameter(
        tuple(TOPICS),
        "topics to record, by short name; applied_command and event are always recorded",
        choices=tuple(TOPICS),
        length=(1, len(TOPICS)),
    )
    minimum_free: int = parameter(
        10_000_000, "free disk space below which recording stops", unit="B", minimum=0, maximum=1 << 50
    )


@dataclass(frozen=True, slots=True)
class RerunParameters:
    """Stream to the Rerun viewer."""

    mode: str = parameter(
        "none",
        "destination of the Rerun stream; save: a file; serve: viewers that connect; connect: one viewer",
        choices=("none", "save", "serve", "connect"),
    )
    path: str = parameter("", "file to write, for mode save")
    port: int = parameter(
        9876, "port on 127.0.0.1 to which viewers connect, for mode serve", minimum=1, maximum=65535
    )
    web_port: int = parameter(
        9090,
        "port on 127.0.0.1 of the page that shows the run in a browser, for mode serve; 0: no page",
        minimum=0,
        maximum=65535,
    )
    url: str = parameter("rerun+http://127.0.0.1:9876/proxy", "address of the viewer, for mode connect")
