"""Program and machine that computed a run.

Two runs with the same parameters, commands and start can differ in their bits only if this differs.
"""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from pathlib import Path
from typing import NamedTuple

import gear_dynamics_ros
from gear_dynamics_ros import __version__
from gear_dynamics_ros.physics.kernel.sources import hash_of_files, kernel_hash

PACKAGE = Path(gear_dynamics_ros.__file__).parent
# Every source file that decides the bits: constants from parameters, the kernel, and its caller.
MODEL_SOURCES = (
    "channels.py",
    "chunk.py",
    "parameters/*.py",
    "physics/**/*.py",
    "simulation/engine.py",
    "simulation/run.py",
    "simulation/start_state.py",
)


class Provenance(NamedTuple):
    """Program and machine. A text is empty if a recording does not have it."""

    version: str  # of this package
    kernel_hash: str  # SHA-256 of the source of physics/kernel
    model_hash: str  # SHA-256 of all source files that decide the bits
    processor: str  # its name, and the features that the compiler uses
    compiler: str
    libraries: str  # that compute: numpy, scipy (for the damping factor), libc


@cache
def current_provenance() -> Provenance:
    """Provenance of this process."""
    # Imported here, so that programs that only read recordings need not wait for the compiler.
    import numba
    import numpy as np
    import scipy
    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    digest = hashlib.sha256(features.encode()).hexdigest()[:8]
    llvm = ".".join(map(str, binding.llvm_version_info))
    libc = " ".join(platform.libc_ver()).strip() or platform.system()
    return Provenance(
        version=__version__,
        kernel_hash=kernel_hash(),
        model_hash=model_hash(),
        processor=f"{processor_name()} ({binding.get_host_cpu_name()}, features {digest})",
        compiler=f"numba {numba.__version__}, LLVM {llvm}",
        libraries=f"numpy {np.__version__}, scipy {scipy.__version__}, {libc}",
    )


@cache
def model_hash() -> str:
    """SHA-256 of every source file that decides the bits, as hexadecimal text."""
    return hash_of_files(PACKAGE, (path for pattern in MODEL_SOURCES for path in PACKAGE.glob(pattern)))


def processor_name() -> str:
    """Name of the processor, as the system reports it."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def provenance_differences(recorded: Provenance) -> list[str]:
    """The fields of ``recorded`` that differ from this process, as one line each."""
    return [
        f"{name.replace('_', ' ')}: recorded by {theirs or 'an unknown one'}, this is {ours}"
        for name, theirs, ours in zip(Provenance._fields, recorded, current_provenance(), strict=True)
        if theirs != ours
    ]
