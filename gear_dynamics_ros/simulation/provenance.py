"""What made a run besides its parameters: two runs can differ in their bits only where this differs."""

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
# Every source file that decides the bits: from parameters to constants, the kernel, and who calls it.
MODEL_SOURCES = ("physics/**/*.py", "simulation/engine.py")


class Provenance(NamedTuple):
    """Program and machine. A text is empty where a recording does not say."""

    version: str  # of this package
    kernel_hash: str  # SHA-256 of the source of physics/kernel
    model_hash: str  # SHA-256 of the source of all that decides the bits
    processor: str  # name, and what of it the compiler uses
    compiler: str
    libraries: str  # those that compute: numpy, scipy (makes the damping factor), libc


@cache
def current_provenance() -> Provenance:
    """Of this process."""
    # Loaded here: who only reads a recording need not wait for the compiler.
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
    """Name of the processor, as far as the system tells."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def provenance_differences(recorded: Provenance) -> list[str]:
    """What of the program or the machine differs from this process, a line each."""
    return [
        f"{name.replace('_', ' ')}: recorded by {theirs or 'one that did not say'}, this is {ours}"
        for name, theirs, ours in zip(Provenance._fields, recorded, current_provenance(), strict=True)
        if theirs != ours
    ]
