"""Everything that does not change from file to file stands in setup.cfg."""

from pathlib import Path

from setuptools import setup

PACKAGE = "gear_dynamics_ros"
SHARE = Path("share") / PACKAGE
# colcon calls this from a build folder as well, always with the source as working directory.
SOURCE = Path()


def shared(pattern: str) -> list[tuple[str, list[str]]]:
    """Files that match, each in the folder of its own name under share."""
    return [(str(SHARE / path.parent), [str(path)]) for path in sorted(SOURCE.glob(pattern))]


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (str(SHARE), ["package.xml"]),
        (f"lib/{PACKAGE}", [str(path) for path in sorted(SOURCE.glob("executables/*"))]),
        *shared("config/**/*.yaml"),
        *shared("launch/*.launch.py"),
    ],
)
