"""Help and refused options: at once, without the compiler, the kernel and ROS."""

from __future__ import annotations

import json
from types import FunctionType
from typing import Final

from gear_dynamics_ros.cli import start
from support.processes import run_python

REPLAY_VERBS: Final = ("info", "verify", "recover", "diff", "export", "publish", "view")
COMMANDS: Final = [
    ["gearbox"],
    ["drive"],
    ["simulate"],
    ["replay"],
    *(["replay", verb] for verb in REPLAY_VERBS),
    ["analyze"],
    ["sweep"],
    ["identify"],
    ["reproduce"],
    ["urdf"],
]
CALL: Final = """
import contextlib
import io
import json
import sys

sys.modules.update(dict.fromkeys(["numba", "llvmlite", "rclpy", "matplotlib", "rerun"]))

from gear_dynamics_ros.cli import start
from gear_dynamics_ros.urdf import __main__ as urdf


def call(program, *arguments):
    sys.argv = [program, *arguments]
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            code = urdf.urdf_main() if program == "urdf" else getattr(start, program)()
        except SystemExit as leaving:
            code = leaving.code
    return code, output.getvalue(), errors.getvalue()


print(json.dumps([call(*command) for command in json.loads(sys.argv[1])]))
"""


def call(*commands: list[str]) -> list[tuple[int, str, str]]:
    """Exit code and streams of each, where compiler, ROS and pictures can't be imported."""
    done = run_python(CALL, json.dumps(commands))
    assert done.returncode == 0, done.stderr
    return [(code, out, err) for code, out, err in json.loads(done.stdout)]


def test_help_needs_neither_compiler_nor_kernel_nor_ros() -> None:
    for command, answer in zip(COMMANDS, call(*([*words, "--help"] for words in COMMANDS)), strict=True):
        code, output, errors = answer
        assert (code, errors) == (0, ""), command
        assert output.startswith(f"usage: {' '.join(command)}"), command


def test_every_executable_is_asked_for_help() -> None:
    functions = [value for value in vars(start).values() if isinstance(value, FunctionType)]
    own = {function.__name__ for function in functions if function.__module__ == start.__name__}
    assert {name for name in own if not name.startswith("_")} == {words[0] for words in COMMANDS} - {"urdf"}


def test_what_is_refused_needs_no_compiler() -> None:
    simulate = ["simulate", "--output", "x", "--duration"]
    answers = call(["gearbox", "--bogus"], [*simulate, "-1"], [*simulate, "1", "--set", "gears.mass=0"])
    for code, output, errors in answers:
        assert (code, output) == (2, "") and "error: " in errors


def test_the_gearbox_leaves_what_is_for_ros_to_ros() -> None:
    for_ros = ["gearbox", "--ros-args", "--help"]
    (code, _, errors), (helped, output, _) = call(for_ros, [*for_ros, "--", "--help"])
    assert code == 1 and "rclpy: not found" in errors
    assert helped == 0 and output.startswith("usage: gearbox")
