"""``paper.json`` and ``paper.md``: what agrees with the paper, what does not, and why."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from gear_dynamics_ros.paper.cases import (
    MODELS,
    SECTIONS_WITHOUT_RESTITUTION,
    Effort,
    ParameterSet,
    speed_scan,
)
from gear_dynamics_ros.paper.claims import MIXED
from gear_dynamics_ros.paper.markdown import markdown_table
from gear_dynamics_ros.paper.momentum import MomentumBalance, momentum_balances
from gear_dynamics_ros.paper.parameter_sets import PARAMETER_FILE
from gear_dynamics_ros.paper.verdicts import AGREEMENT, ComparedNumber, PaperComparison
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.sweeps.point import DONE

UNITS: Final[Mapping[str, str]] = {"um": "µm", "1": ""}  # as the page writes them
SIGNIFICANT: Final = 5  # digits of our numbers


class PaperReport(NamedTuple):
    """All comparisons, and how they were made."""

    effort: Effort
    one_set: PaperComparison
    by_section: PaperComparison
    refined: PaperComparison


def paper_json(report: PaperReport) -> str:
    """Text of paper.json: a list of the numbers, then of the claims; ``ours`` is of the one set."""
    numbers = [
        {
            "id": found.number.id,
            "where": found.number.where,
            "quantity": found.number.quantity,
            "unit": found.number.unit,
            "printed": found.number.printed,
            "ours": found.ours,
            "difference": found.difference,
            "comparable": str(found.number.comparable),
            "verdict": found.verdict,
            "ours_by_section": other.ours,
            "verdict_by_section": other.verdict,
        }
        for found, other in zip(report.one_set.numbers, report.by_section.numbers, strict=True)
    ]
    claims = [
        {
            "claim": found.claim.number,
            "text": found.claim.text,
            "holds": found.judgement.holds,
            "evidence": found.judgement.evidence,
            "holds_by_section": other.judgement.holds,
            "evidence_by_section": other.judgement.evidence,
            "holds_refined": refined.judgement.holds,
            "evidence_refined": refined.judgement.evidence,
        }
        for found, other, refined in zip(
            report.one_set.claims, report.by_section.claims, report.refined.claims, strict=True
        )
    ]
    entries: list[dict[str, Any]] = [*numbers, *claims]
    return f"{json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def paper_page(report: PaperReport, figures: Sequence[tuple[str, str]]) -> str:
    """Text of paper.md; ``figures`` are pairs of file name and caption."""
    parts = [
        "# The paper's results, reproduced",
        _introduction(report),
        "## Totals",
        _totals(report),
        "## Numbers",
        _numbers(report),
        "## Claims",
        _claims(report),
        "## The mean bearing force at 16500 rpm",
        _momentum(momentum_balances(report.one_set.results)),
        "## With the refined equations",
        _refined(report),
        "## Parameters",
        _parameters(report),
        "## Figures",
        *(f"![{caption}]({name})\n\n{caption}" for name, caption in figures),
    ]
    return "\n\n".join(parts) + "\n"


def _introduction(report: PaperReport) -> str:
    measurement = report.effort.measurement
    return (
        f"Written by `reproduce` ({report.effort.name} run: {measurement.transient} mesh periods dropped, "
        f"{measurement.keep} kept, {measurement.steps_per_period} steps a period; speeds every "
        f"{report.effort.speed_step} rpm and those that the text names). Every run starts with the drive "
        f"flank touching, and uses the published equations with `{PARAMETER_FILE}`.\n\n"
        "The paper leaves some parameters open, among them the restitution of sections 3.1, 3.2 and 3.4. "
        "*One set* has one restitution for all of them, *by section* has one for each section.\n\n"
        "- Forces are those of the bearing contact on the driving gear; the driven gear is equal.\n"
        "- Shares are of time, from located contact events. A range is that of all steps.\n"
        "- A motion is chaotic where neighbours separate and the 0-1 test agrees, as `sweep` has it. The "
        "first chaotic speed begins a stretch of at least 100 rpm whose sections spread over 6 µm or more."
    )


def _totals(report: PaperReport) -> str:
    rows = []
    for title, comparison in (("one set", report.one_set), ("by section", report.by_section)):
        totals = comparison.totals
        rows.append(
            (
                title,
                f"{totals.agreeing} of {totals.comparable} "
                f"({100.0 * totals.agreeing / totals.comparable:.0f} %)",
                f"{totals.true} of {totals.claims}",
                str(totals.mixed),
                str(totals.claims - totals.true - totals.mixed),
            )
        )
    head = ("parameters", f"numbers within {100.0 * AGREEMENT:.0f} %", "claims true", "mixed", "false")
    return markdown_table(head, rows)


def _numbers(report: PaperReport) -> str:
    rows = []
    for found, other in zip(report.one_set.numbers, report.by_section.numbers, strict=True):
        number = found.number
        rows.append(
            (
                number.id,
                number.where,
                _with_unit(number.quantity, number.unit),
                f"{number.printed:g}",
                *_ours(found),
                *_ours(other),
            )
        )
    head = ("id", "where", "quantity", "printed", "one set", "verdict", "by section", "verdict")
    reasons = {
        f"- {found.number.id}: {found.number.reason}."
        for found in report.one_set.numbers
        if found.number.reason
    }
    return (
        f"{markdown_table(head, rows)}\n\nDifferences are relative to the printed number; where 0 is "
        "printed, to the greatest value of the same quantity.\n\nNot comparable, or in magnitude only:\n\n"
        + "\n".join(sorted(reasons))
    )


def _ours(found: ComparedNumber) -> tuple[str, str]:
    ours = "-" if found.ours is None else f"{found.ours:.{SIGNIFICANT}g}"
    relative = "" if found.relative is None else f" ({100.0 * found.relative:+.1f} %)"
    return ours, f"{found.verdict}{relative}"


def _with_unit(quantity: str, unit: str) -> str:
    text = UNITS.get(unit, unit)
    return f"{quantity} ({text})" if text else quantity


def _holds(value: bool | str) -> str:
    return MIXED if value == MIXED else str(bool(value)).lower()


def _claims(report: PaperReport) -> str:
    return "\n\n".join(
        f"**{one.claim.number}.** {one.claim.text}\n\n"
        f"- one set: **{_holds(one.judgement.holds)}**. {one.judgement.evidence}\n"
        f"- by section: **{_holds(other.judgement.holds)}**. {other.judgement.evidence}"
        for one, other in zip(report.one_set.claims, report.by_section.claims, strict=True)
    )


def _momentum(balances: Sequence[MomentumBalance]) -> str:
    rows = [
        (
            balance.model,
            f"{balance.mesh_force:.2f}",
            f"{balance.vector:.2f}",
            f"{balance.bearing_force:.2f}",
            f"{balance.contact_force:.2f}",
            f"{balance.printed:.2f}",
            "yes" if balance.possible else f"no: below {balance.limit:.2f} N",
        )
        for balance in balances
    ]
    head = (
        "model",
        "mean mesh force (N)",
        "magnitude of the mean force of bearing and film (N)",
        "mean magnitude of it (N)",
        "mean magnitude of the contact force (N)",
        "printed mean bearing force (N)",
        "possible",
    )
    return (
        "Speed and centres of the gears do not drift. So the mean mesh force is T_M / r_b = "
        f"{balances[0].limit:.2f} N, and the mean over time of the force of bearing and film on a gear is "
        "opposite to it. The mean of a magnitude is never less than the magnitude of the mean. Without a "
        "film the bearing contact alone carries the shaft: its mean force can't lie below "
        f"{balances[0].limit:.2f} N, whatever the parameters. With a film the contact can carry less.\n\n"
        f"{markdown_table(head, rows)}\n\n"
        "The paper prints 374.10 N for compared. No torque gives both this and the 519.15 N of traditional, "
        "which by itself is 2.4 % too low. No parameter was fitted to the impossible one."
    )


def _refined(report: PaperReport) -> str:
    rows = [
        (
            str(one.claim.number),
            one.claim.text,
            _holds(one.judgement.holds),
            _holds(refined.judgement.holds),
            refined.judgement.evidence,
        )
        for one, refined in zip(report.one_set.claims, report.refined.claims, strict=True)
    ]
    head = ("claim", "text", "published", "refined", "with the refined equations")
    totals = report.refined.totals
    return (
        "The same runs with `mesh_geometry: exact`, `mesh_damping: contact`, `restitution_law: exact` and "
        f"`mesh_phase: actual`: of {totals.claims} claims {totals.true} hold, {totals.mixed} are mixed.\n\n"
        f"{_ended_runs(report)}\n\n{markdown_table(head, rows)}"
    )


def _ended_runs(report: PaperReport) -> str:
    """How many runs over speed gave no number, in words."""
    counts = []
    for comparison in (report.one_set, report.refined):
        scans = {model: comparison.results.scan(speed_scan(model)) for model in MODELS}
        counts.append(
            ", ".join(
                f"{sum(result.point.status != DONE for result in scan)} of {len(scan)} in {model}"
                for model, scan in scans.items()
            )
        )
    return (
        "Where the centres are pressed together until no backlash is left, a run ends, gives no number, and "
        f"is a white gap in the figure. Over speed that happens to {counts[1]} with the refined equations, "
        f"to {counts[0]} with the published ones."
    )


def _parameters(report: PaperReport) -> str:
    sets = [comparison.results.parameter_set for comparison in (report.one_set, report.by_section)]
    columns = [_open_values(one.parameters) for one in sets]
    rows: list[Sequence[str]] = [
        (name, value, other, unit) for (name, value, unit), (_, other, _) in zip(*columns, strict=True)
    ]
    rows += [
        (f"restitution, section {section}", *(_restitution(one, section) for one in sets), "")
        for section in SECTIONS_WITHOUT_RESTITUTION
    ]
    return (
        f"What the paper leaves open; *one set* is `{PARAMETER_FILE}`. [paper_search.md](paper_search.md) "
        "has the ranges in which it was looked for, and what no set gave together.\n\n"
        + markdown_table(("parameter", "one set", "by section", "unit"), rows)
    )


def _open_values(parameters: Parameters) -> list[tuple[str, str, str]]:
    """Name, value and unit of what the paper leaves open, but the restitution."""
    mesh, surface, bearing = parameters.mesh, parameters.surface, parameters.bearings.driving
    return [
        ("static error, mesh orders 1, 2, ...: cosine", _list(mesh.error_cos, 1e6), "µm"),
        ("static error: sine", _list(mesh.error_sin, 1e6), "µm"),
        ("mesh stiffness, relative: cosine", _list(mesh.stiffness_cos, 1.0), ""),
        ("mesh stiffness, relative: sine", _list(mesh.stiffness_sin, 1.0), ""),
        ("bearing clearance", f"{1e6 * bearing.clearance:g}", "µm"),
        ("bearing length", f"{1e3 * bearing.length:g}", "mm"),
        ("bearing diameter", f"{1e3 * bearing.diameter:g}", "mm"),
        ("oil clearance", f"{1e6 * bearing.oil_clearance:g}", "µm"),
        ("Kelvin stiffness", f"{bearing.kelvin_stiffness:g}", "N/m"),
        ("Kelvin damping", f"{bearing.kelvin_damping:g}", "N s/m"),
        ("least impact speed", f"{parameters.bearings.minimum_impact_speed:g}", "m/s"),
        ("surface: ratio of waves", f"{surface.scale:g}", ""),
        ("surface: number of waves", f"{surface.waves}", ""),
        ("surface: offset, driving", f"{surface.driving.offset:g}", "rad"),
        ("surface: offset, driven", f"{surface.driven.offset:g}", "rad"),
    ]


def _restitution(one: ParameterSet, section: str) -> str:
    everywhere = one.parameters.bearings.driving.restitution
    return f"{one.restitution_by_section.get(section, everywhere):g}"


def _list(values: Sequence[float], scale: float) -> str:
    return ", ".join(f"{scale * value:g}" for value in values)
