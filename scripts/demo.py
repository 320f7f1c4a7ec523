"""The main job, end to end: node, commands over topics, recording, viewer file, verification, figures."""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent
PROFILE = SOURCE / "config" / "profiles" / "demo.yaml"
PARAMETERS = SOURCE / "config" / "gearbox.yaml"
STOP_SECONDS = 60.0
POLL_SECONDS = 0.1
# On Linux, domains above 101 share their UDP ports with the ephemeral range.
DOMAINS = range(1, 102)


def main() -> int:
    """Run the demo; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--output", type=Path, default=Path("demo"), metavar="DIR", help="folder for the results"
    )
    output: Path = parser.parse_args().output
    bag, stream, figures = output / "recording", output / "gearbox.rrd", output / "figures"
    layouts = tuple(output.glob(f"{stream.stem}.*.rbl"))
    played_report = output / "test_run.html"
    clear(output, (bag, stream, figures, played_report, *layouts))
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(random.choice(DOMAINS)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    settings = {
        "operation.speed": "200.0",
        "recording.path": str(bag),
        "rerun.mode": "save",
        "rerun.path": str(stream),
    }
    overrides = [word for name, value in settings.items() for word in ("-p", f"{name}:={value}")]
    say(f"playing {PROFILE.relative_to(SOURCE)} to the node gearbox: run-up, load step, torque reversal")
    # drive starts first: what the gearbox records before drive has joined is of no use.
    options = ("--lockstep", "--wait", "60", "--report", str(played_report))
    drive = start("drive", str(PROFILE), *options, environment=environment)
    gearbox = start(
        "gearbox", "--ros-args", "--params-file", str(PARAMETERS), *overrides, environment=environment
    )
    try:
        played = wait_for(drive, gearbox)
    finally:
        stop(drive)
        stopped = stop(gearbox)
    if played or stopped:
        print(f"demo: error: drive exited with {played}, gearbox with {stopped}", file=sys.stderr)
        return 1
    say("re-simulating the recording and comparing every sample")
    tool("replay", "verify", str(bag))
    say("drawing")
    tool("analyze", str(bag), "--output", str(figures))
    print(
        f"\nRecording  {bag}   (replay info {bag}; ros2 bag info {bag}; opens in Foxglove and PlotJuggler)"
        f"\nViewer     {stream}   (rerun {stream})"
        f"\nTest run   {played_report}   (opens in a browser: the expectations, each with its plot)"
        f"\nReport     {figures / 'report.html'}   (opens in a browser: checks, condition, energy, figures)"
        f"\nPictures   {figures}   (start with {figures / 'overview.png'})"
        f"\nThe tools are in {Path(sysconfig.get_path('scripts'))}"
    )
    return 0


def clear(output: Path, results: tuple[Path, ...]) -> None:
    """Remove the results of an earlier demo, and nothing else, from ``output``."""
    output.mkdir(parents=True, exist_ok=True)
    for result in results:
        if result.is_dir():
            shutil.rmtree(result)
        else:
            result.unlink(missing_ok=True)


def start(name: str, *words: str, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start one of the package's commands in a process group of its own."""
    return subprocess.Popen([executable(name), *words], env=environment, start_new_session=True)


def wait_for(drive: subprocess.Popen[bytes], gearbox: subprocess.Popen[bytes]) -> int:
    """Exit code of ``drive``; 1 at once if the gearbox ends before it."""
    while drive.poll() is None:
        if gearbox.poll() is not None:
            return 1
        time.sleep(POLL_SECONDS)
    return int(drive.returncode)


def stop(process: subprocess.Popen[bytes]) -> int:
    """Interrupt the process as Ctrl-C does and wait until its files are finished; returns its exit code."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        return process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def tool(*words: str) -> None:
    """Run one of the package's tools; a failure ends the demo."""
    code = subprocess.run([executable(words[0]), *words[1:]]).returncode
    if code:
        sys.exit(code)


def executable(name: str) -> str:
    """Path of a console script of this Python."""
    return str(Path(sysconfig.get_path("scripts")) / name)


def say(what: str) -> None:
    """Tell what is being done."""
    print(f"== {what}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
