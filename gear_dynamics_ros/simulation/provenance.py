"""What made a run besides its parameters: two runs can differ in their bits only where this differs."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gear_dynamics_ros import __version__


class Origin(NamedTuple):
    """Program and machine."""

    version: str  # of this package
    kernel_hash: str  # SHA-256 of the kernel's source
    processor: str  # name, and what of it the compiler uses
    compiler: str
    libraries: str


@cache
def present() -> Origin:
    """Of this process."""
    # Here, because whoever only reads recordings need not load the compiler.
    import numba
    from llvmlite import binding

    from gear_dynamics_ros.simulation.engine import kernel_hash

    features = binding.get_host_cpu_features().flatten()
    digest = hashlib.sha256(features.encode()).hexdigest()[:8]
    llvm = ".".join(map(str, binding.llvm_version_info))
    return Origin(
        version=__version__,
        kernel_hash=kernel_hash(),
        processor=f"{processor()} ({binding.get_host_cpu_name()}, features {digest})",
        compiler=f"numba {numba.__version__}, LLVM {llvm}",
        libraries=f"numpy {np.__version__}, {' '.join(platform.libc_ver()).strip() or platform.system()}",
    )


def processor() -> str:
    """Its name, as far as the system tells."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def differences(recorded: Origin) -> list[str]:
    """What of the program or the machine differs from this process, a line each."""
    names = ("version", "kernel hash", "processor", "compiler", "libraries")
    return [
        f"{name}: recorded by {theirs or 'one that did not say'}, this is {ours}"
        for name, theirs, ours in zip(names, recorded, present(), strict=True)
        if theirs != ours
    ]
