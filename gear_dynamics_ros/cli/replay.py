"""``replay VERB``: inspect, verify, repair, compare, export, play and show recordings."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from gear_dynamics_ros.cli.replay_diff import add_diff
from gear_dynamics_ros.cli.replay_export import add_export
from gear_dynamics_ros.cli.replay_info import add_info
from gear_dynamics_ros.cli.replay_publish import add_publish
from gear_dynamics_ros.cli.replay_recover import add_recover
from gear_dynamics_ros.cli.replay_verify import add_verify
from gear_dynamics_ros.cli.replay_view import add_view
from gear_dynamics_ros.system.command import run_command


def replay_main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``replay``; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="replay",
        description="Inspect, verify, repair, compare, export, play and show recordings. "
        "See replay VERB --help.",
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for add in (add_info, add_verify, add_recover, add_diff, add_export, add_publish, add_view):
        add(verbs)
    return run_command(lambda arguments: int(arguments.command(arguments)), parser, argv)


if __name__ == "__main__":
    sys.exit(replay_main())
