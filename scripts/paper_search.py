"""Searches for what the source paper leaves open, and writes what no set gave together as a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gear_dynamics_ros.cli.options import require_workers
from gear_dynamics_ros.cli.progress import Progress
from gear_dynamics_ros.identification.journal import FitJournal
from gear_dynamics_ros.identification.trials import Trials
from gear_dynamics_ros.paper.parameter_sets import PARAMETER_FILE
from gear_dynamics_ros.paper.search import PaperTrial, search_paper
from gear_dynamics_ros.paper.search_page import PaperSearch, search_page
from gear_dynamics_ros.paper.search_space import PaperSearchSpace, one_restitution, own_restitutions
from gear_dynamics_ros.parameters import load_parameters
from gear_dynamics_ros.system.command import run_command
from gear_dynamics_ros.system.files import output_file
from gear_dynamics_ros.system.threads import processor_count

SOURCE = Path(__file__).resolve().parent.parent
SEED = 1
SEARCHES = {
    "One restitution where the paper names none": one_restitution,
    "A restitution for each section that names none": own_restitutions,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run both searches; returns the exit code."""
    parser = argparse.ArgumentParser(prog="paper_search", description=__doc__)
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="page to write")
    parser.add_argument(
        "--trials",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the trials: an interrupted search in it goes on",
    )
    parser.add_argument("--generations", type=int, default=1, metavar="N", help="of each search (default: 1)")
    parser.add_argument("--workers", type=int, metavar="N", help="threads (default: one a processor)")
    return run_command(_search, parser, argv)


def _search(arguments: argparse.Namespace) -> int:
    require_workers(arguments.workers)
    searches = [
        PaperSearch(title, space, _trials(space, arguments, str(number)))
        for number, (title, space) in enumerate(_spaces().items(), start=1)
    ]
    with output_file(arguments.output) as stream:
        stream.write(search_page(searches, "make paper_search").encode())
    print(arguments.output)
    return 0


def _spaces() -> dict[str, PaperSearchSpace]:
    base = load_parameters(SOURCE / PARAMETER_FILE)
    return {title: of(base) for title, of in SEARCHES.items()}


def _trials(space: PaperSearchSpace, arguments: argparse.Namespace, name: str) -> list[PaperTrial]:
    request = {
        "parameters": space.base.to_flat(),
        "unknowns": [unknown.label for unknown in space.unknowns],
        "seed": SEED,
    }
    folder = arguments.trials / name
    journal = (FitJournal.reopen if folder.exists() else FitJournal.create)(folder, request)
    workers = arguments.workers or processor_count()
    count = arguments.generations
    with Trials(space, journal, workers, lambda: "") as trials, Progress("searching", count) as progress:
        return search_paper(space, trials, count, SEED, progress)


if __name__ == "__main__":
    sys.exit(main())
