"""Files that are installed beside the package: config, launch."""

from __future__ import annotations

import sysconfig
from collections.abc import Iterator
from pathlib import Path

from gear_dynamics_ros.errors import GearboxError

PACKAGE = "gear_dynamics_ros"


def _share_directories() -> Iterator[Path]:
    # A build with symbolic links leads to the checkout, whose files are up to date.
    here = Path(__file__).resolve().parents[1]
    if (here.parent / "package.xml").is_file():
        yield here.parent
    for prefix in here.parents:
        yield prefix / "share" / PACKAGE
    yield Path(sysconfig.get_path("data")) / "share" / PACKAGE


def share_file(name: str) -> Path:
    """Path of a shared file such as ``config/gearbox.yaml``, in a checkout or installed by pip or colcon.

    Raises GearboxError if it is not found.
    """
    for directory in _share_directories():
        path = directory / name
        if path.is_file():
            return path
    raise GearboxError(f"{name}: not found in share/{PACKAGE}; install the package again")
