"""replay: what may be done with a recording, each verb in a file of its own."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from gear_dynamics_ros.cli.common import guarded
from gear_dynamics_ros.cli.replay_diff import add_diff
from gear_dynamics_ros.cli.replay_export import add_export
from gear_dynamics_ros.cli.replay_info import add_info
from gear_dynamics_ros.cli.replay_publish import add_publish
from gear_dynamics_ros.cli.replay_recover import add_recover
from gear_dynamics_ros.cli.replay_verify import add_verify


def replay_main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="replay",
        description="What may be done with recordings; replay VERB --help tells more.",
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for add in (add_info, add_verify, add_recover, add_diff, add_export, add_publish):
        add(verbs)
    return guarded(lambda arguments: int(arguments.command(arguments)), parser, argv)


if __name__ == "__main__":
    sys.exit(replay_main())
