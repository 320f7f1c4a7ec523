"""The searches as a page: what no set of the open parameters gave together with the rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from gear_dynamics_ros.paper.claims import CLAIMS
from gear_dynamics_ros.paper.markdown import markdown_table
from gear_dynamics_ros.paper.printed import PRINTED_NUMBERS
from gear_dynamics_ros.paper.search import PaperTrial
from gear_dynamics_ros.paper.search_space import COMPARABLE, SEARCHED, PaperSearchSpace

QUANTITIES: Final = {number.id: f"{number.quantity} ({number.where})" for number in PRINTED_NUMBERS}


class PaperSearch(NamedTuple):
    """One search: its space and all of its trials; the first is the set of paper.md."""

    title: str
    space: PaperSearchSpace
    trials: Sequence[PaperTrial]


def search_page(searches: Sequence[PaperSearch], command: str) -> str:
    """The page, Markdown."""
    parts = [
        "# What no set gave together",
        _introduction(command),
        *(part for search in searches for part in _chapter(search)),
        "## The space",
        _ranges(searches[-1].space),
    ]
    return "\n\n".join(parts) + "\n"


def _introduction(command: str) -> str:
    measurement = SEARCHED.measurement
    return (
        f"Written by `{command}`. A differential evolution looked, within what is plausible, for values of "
        "what the source paper leaves open that agree with more of its numbers and claims than those of "
        "[paper.md](paper.md). These are the first trial; the others of the first generation are spread "
        "over the whole space (Sobol's sequence).\n\n"
        f"Each trial runs what [paper.md](paper.md) shows, more coarsely: speeds every {SEARCHED.speed_step} "
        f"rpm and those that the text names, {measurement.transient} mesh periods dropped, "
        f"{measurement.keep} kept, and no exponents: the 0-1 test alone tells what is chaotic. So the "
        "numbers of a trial can differ from those of the full run.\n\n"
        "The tables have what the set of paper.md misses. *Sets* are the trials that agree there. *Best of "
        "them* is the one that agrees with most of all, and *then lost* is what the set of paper.md agrees "
        "with and that one does not."
    )


def _chapter(search: PaperSearch) -> Iterable[str]:
    first, *others = search.trials
    best = max(others, key=_rank)
    better = sum(_rank(trial) > _rank(first) for trial in others)
    yield f"## {search.title}"
    yield (
        f"{len(search.trials)} sets. The set of paper.md agrees with {_totals(first)}, the best of the "
        f"others with {_totals(best)}. {better} agree with more than that set."
    )
    yield markdown_table(
        ("what that set misses", "sets", "best of them", "then lost"),
        [
            *(
                _row(f"{name}: {QUANTITIES[name]}", [t for t in search.trials if name in t.numbers], first)
                for name in COMPARABLE
                if name not in first.numbers
            ),
            *(
                _row(
                    f"claim {claim.number}: {claim.text}",
                    [trial for trial in search.trials if claim.number in trial.claims],
                    first,
                )
                for claim in CLAIMS
                if claim.number not in first.claims
            ),
        ],
    )


def _rank(trial: PaperTrial) -> tuple[int, float]:
    return trial.agreeing, -trial.missing


def _totals(trial: PaperTrial) -> str:
    numbers = f"{len(trial.numbers)} of {len(COMPARABLE)} numbers"
    return f"{numbers} and {len(trial.claims)} of {len(CLAIMS)} claims"


def _row(missed: str, having: Sequence[PaperTrial], first: PaperTrial) -> tuple[str, str, str, str]:
    if not having:
        return missed, "0", "-", "-"
    best = max(having, key=_rank)
    lost = [name for name in COMPARABLE if name in first.numbers - best.numbers]
    lost += [f"claim {number}" for number in sorted(first.claims - best.claims)]
    totals = f"{len(best.numbers)} numbers, {len(best.claims)} claims"
    return missed, str(len(having)), totals, ", ".join(lost) or "nothing"


def _ranges(space: PaperSearchSpace) -> str:
    rows = [
        (
            f"`{unknown.label}`",
            f"{unknown.low:g} to {unknown.high:g}{f' {unknown.unit}' if unknown.unit else ''}",
            "ratios" if unknown.logarithmic else "differences",
        )
        for unknown in dict.fromkeys(space.unknowns)
    ]
    return "Table 1 of the paper fixes everything else.\n\n" + markdown_table(
        ("parameter", "range", "even in"), rows
    )
