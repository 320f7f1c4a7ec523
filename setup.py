"""Where files that are not modules go; everything else stands in setup.cfg."""

from pathlib import Path

from setuptools import setup

PACKAGE = "gear_dynamics_ros"
SHARE = Path("share") / PACKAGE


def shared(pattern: str) -> list[tuple[str, list[str]]]:
    """Files that match, each in the folder of its own name under share."""
    return [(str(SHARE / path.parent), [str(path)]) for path in sorted(Path().glob(pattern))]


setup(
    # In setup.cfg it becomes an object that colcon can't read.
    python_requires=">=3.11",
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (str(SHARE), ["package.xml"]),
        (f"lib/{PACKAGE}", [str(path) for path in sorted(Path().glob("executables/*"))]),
        *shared("config/**/*.yaml"),
        *shared("config/*.xml"),
        *shared("examples/*.py"),
        *shared("launch/*.launch.py"),
        *shared("sros2/*.xml"),
        *shared("urdf/*.urdf"),
    ],
)
