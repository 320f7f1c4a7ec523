"""The files of a fit: fitted parameters, numbers as JSON, residuals as CSV, and a page of text."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.identification.fit import Fit
from gear_dynamics_ros.identification.uncertainty import Uncertainty
from gear_dynamics_ros.parameters import dump_parameters
from gear_dynamics_ros.system.files import output_file

PARAMETERS_FILE: Final = "parameters.yaml"
RESULT_FILE: Final = "result.json"
RESIDUALS_FILE: Final = "residuals.csv"
PAGE_FILE: Final = "report.txt"
CLOSELY_CORRELATED: Final = 0.95
NOISE_CORRELATION: Final = 0.3  # of neighbouring residuals, beyond which they are no noise


def write_fit(fit: Fit, folder: Path, data: str) -> list[Path]:
    """Write all files of ``fit`` to ``folder``; returns their paths. ``data`` names the data in words.

    Raises GearboxError if one can't be written.
    """
    texts = {
        PARAMETERS_FILE: f"# {_heading(fit)}\n{dump_parameters(fit.parameters)}",
        RESULT_FILE: json.dumps(fit_to_json(fit, data), indent=2, allow_nan=False) + "\n",
        RESIDUALS_FILE: _csv(*fit.problem.objective.table(fit.residuals)),
        PAGE_FILE: fit_text(fit, data),
    }
    for name, text in texts.items():
        with output_file(folder / name) as stream:
            stream.write(text.encode())
    return [folder / name for name in texts]


def fit_to_json(fit: Fit, data: str) -> dict[str, Any]:
    """All numbers of a fit; null where there is none."""
    errors = fit.uncertainty
    return {
        "complete": not fit.stopped,
        "stopped": fit.stopped,
        "data": data,
        "residuals": len(fit.residuals),
        "rms": _rms(fit),
        "trials": fit.evaluated,
        "failed_trials": [failures._asdict() for failures in fit.failures.values()],
        "unknowns": [_unknown_to_json(fit, k) for k in range(len(fit.values))],
        "covariance": None if errors is None else _numbers(errors.covariance),
        "correlation": None if errors is None else _numbers(errors.correlation),
        "residual_variance": None if errors is None else errors.variance,
        "degrees_of_freedom": None if errors is None else errors.degrees,
        "not_told_apart": [
            {"flat": each.flat, "singular_ratio": each.ratio, "relative_changes": dict(each.changes)}
            for each in (errors.directions if errors is not None else ())
        ],
        "ending": "" if fit.optimum is None else fit.optimum.ending,
        "fit": dict(fit.problem.objective.summary(fit.residuals)),
    }


def fit_text(fit: Fit, data: str) -> str:
    """The result as a short page."""
    lines = [
        _heading(fit),
        "",
        f"data: {data}",
        f"residuals: {len(fit.residuals)}, rms {_rms(fit):.4g} of their scales",
        f"trials: {fit.evaluated}" + ("" if fit.failures else ", all computed"),
        *(f"  {number} failed, such as: {example}" for number, example in fit.failures.values()),
        "",
        *_value_lines(fit),
        *([] if fit.uncertainty is None else _uncertainty_lines(fit, fit.uncertainty)),
        "",
        *_fit_lines(fit),
    ]
    return "\n".join(lines) + "\n"


def _heading(fit: Fit) -> str:
    if fit.stopped:
        return (
            f"Fit by identify, stopped by {fit.stopped}: the best of {fit.evaluated} trials, without errors; "
            "--resume goes on"
        )
    return f"Fit by identify, complete: {len(fit.values)} values from {len(fit.residuals)} residuals"


def _rms(fit: Fit) -> float:
    return float(np.sqrt(np.mean(fit.residuals**2)))


def _unknown_to_json(fit: Fit, k: int) -> dict[str, Any]:
    unknown, errors = fit.problem.unknowns[k], fit.uncertainty
    return {
        "name": unknown.label,
        "parameters": [str(entry) for entry in unknown.entries],
        "unit": unknown.unit,
        "low": unknown.low,
        "high": unknown.high,
        "value": float(fit.values[k]),
        "standard_error": None if errors is None else _number(errors.standard_errors[k]),
        "at_bound": None if errors is None else errors.at_bound[k],
    }


def _value_lines(fit: Fit) -> list[str]:
    rows = [("parameter", "value", "standard error", "unit", "bounds")]
    for k, (unknown, value) in enumerate(zip(fit.problem.unknowns, fit.values, strict=True)):
        bounds = f"{unknown.low:.6g} to {unknown.high:.6g}"
        rows.append((unknown.label, f"{value:.8g}", _error_text(fit, k), unknown.unit or "1", bounds))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def _error_text(fit: Fit, k: int) -> str:
    errors = fit.uncertainty
    if errors is None:
        return "-"
    if errors.at_bound[k]:
        return "at its bound"
    error = errors.standard_errors[k]
    return f"{error:.3g}" if math.isfinite(error) else "not determined"


def _uncertainty_lines(fit: Fit, errors: Uncertainty) -> list[str]:
    lines = []
    stuck = [unknown.label for unknown, at in zip(fit.problem.unknowns, errors.at_bound, strict=True) if at]
    if stuck:
        lines += ["", "At a bound, which the data would pass; the errors of the others hold for this value:"]
        lines += [f"  {label}" for label in stuck]
    if errors.directions:
        lines += ["", "What the data can't tell apart:"]
        lines += [f"  {direction.text}" for direction in errors.directions]
    pairs = _close_pairs(fit, errors)
    if pairs:
        lines += ["", f"Correlated by more than {CLOSELY_CORRELATED:g}:", *pairs]
    if errors.degrees == 0:
        lines += ["", "No more data than unknowns: the errors take the scales of the data for theirs."]
    return lines


def _close_pairs(fit: Fit, errors: Uncertainty) -> list[str]:
    labels = [unknown.label for unknown in fit.problem.unknowns]
    return [
        f"  {labels[i]} and {labels[j]}: {errors.correlation[i, j]:+.4f}"
        for i in range(len(labels))
        for j in range(i)
        if abs(errors.correlation[i, j]) > CLOSELY_CORRELATED
    ]


def _fit_lines(fit: Fit) -> list[str]:
    summary = fit.problem.objective.summary(fit.residuals)
    lines = []
    for name, entry in summary.get("channels", {}).items():
        lines.append(
            f"{name}: rms of the residuals {entry['residual_rms']:.4g} {entry['unit']}, "
            f"of the channel {entry['channel_rms']:.4g} {entry['unit']}"
        )
        if abs(entry["neighbour_correlation"]) > NOISE_CORRELATION:
            lines.append(
                f"  neighbouring residuals correlate by {entry['neighbour_correlation']:+.2f}: they are no "
                "noise, the model misses something, and the true errors are larger than those above"
            )
    for entry in summary.get("targets", ()):
        lines.append(
            f"{entry['label']}: wanted {entry['value']:.6g}, fitted {entry['fitted']:.6g}, "
            f"off by {entry['residual']:+.3g} scales"
        )
    return lines


def _csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(matrix: NDArray[np.float64]) -> list[list[float | None]]:
    return [[_number(value) for value in row] for row in matrix]
