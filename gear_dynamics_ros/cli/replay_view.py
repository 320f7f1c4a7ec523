"""``replay view BAG``: a recording as a Rerun file, or in a browser."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any, Final

from gear_dynamics_ros import recording
from gear_dynamics_ros.cli.faults import warn_of_faults
from gear_dynamics_ros.cli.options import add_span
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import specifications
from gear_dynamics_ros.replay.view import draw_recording, file_of, require_viewable, server_of
from gear_dynamics_ros.system.processes import noted_signals

SIGNAL_INTERVAL: Final = 0.1  # s between two looks for a signal


def add_view(verbs: Any) -> None:
    """Add the verb to argparse's subparsers."""
    parser = verbs.add_parser(
        "view",
        help="show a recording in Rerun: gears, forces, orbits, curves",
        description="Draw a recording, as the node's viewer does, into a new Rerun file with its layouts "
        "(.rbl) beside it, or serve it to a browser on this machine until Ctrl-C.",
    )
    parser.add_argument("bag", metavar="BAG", help="recording: a folder or a single .mcap file")
    add_span(parser)
    parser.add_argument("--output", type=Path, metavar="F.rrd", help="new file (default: BAG with .rrd)")
    parser.add_argument("--serve", action="store_true", help="write no file; print the URL for a browser")
    for name, parameter in (("--port", "rerun.port"), ("--web-port", "rerun.web_port")):
        row = specifications()[parameter]
        parser.add_argument(
            name, type=int, metavar="N", default=row.default, help=f"{row.help} (default: {row.default})"
        )
    parser.set_defaults(command=_view)


def _view(arguments: argparse.Namespace) -> int:
    if arguments.serve and arguments.output is not None:
        raise UsageError("--serve writes no file: leave --output out, or --serve")
    bag = recording.open(arguments.bag)
    require_viewable(bag)
    first, end = bag.require_window(arguments.start, arguments.end)
    if first == end:
        raise UsageError(f"{bag.path} has no samples: nothing to show")
    warn_of_faults("replay", bag)
    if arguments.serve:
        return _serve(bag, first, end, arguments.port, arguments.web_port)
    path = _default_output(Path(arguments.bag)) if arguments.output is None else arguments.output
    with file_of(bag, path) as target, Progress("drawn", end - first) as progress:
        draw_recording(bag, first, end, target, progress)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; open it with: rerun {path}")
    return 0


def _serve(bag: recording.Recording, first: int, end: int, port: int, web_port: int) -> int:
    with server_of(bag, port, web_port) as target:
        with Progress("drawn", end - first) as progress:
            draw_recording(bag, first, end, target, progress)
        with noted_signals() as received:
            print(f"{target.address}\nCtrl-C ends it", flush=True)
            while not received:
                time.sleep(SIGNAL_INTERVAL)
    return 0


def _default_output(bag: Path) -> Path:
    return bag.with_name(f"{bag.resolve().name.removesuffix('.mcap')}.rrd")
