"""From the results of the runs to each of the paper's numbers, in the units of the print."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.paper.cases import MODELS, NAMED_CASES, RESTITUTION_SCAN, speed_scan
from gear_dynamics_ros.paper.results import CaseResult, PaperResults

MICRO: Final = 1e6  # um in a metre
PERCENT: Final = 100.0
# A single chaotic speed is not the onset: chaos that begins goes on for at least this, rpm.
LEAST_STRETCH: Final = 100.0
# Spread of the Poincaré section that shows in a bifurcation diagram whose axis is 60 um long, m.
VISIBLE_SPREAD: Final = 6e-6
FORCE: Final = "driving_contact_force"  # gears and bearings are equal: the driving side stands for both
PENETRATION: Final = "driving_penetration"


class MeasuredRange(NamedTuple):
    """Least and greatest value of a quantity, SI units."""

    least: float
    greatest: float

    @property
    def length(self) -> float:
        """Difference of the two."""
        return self.greatest - self.least


def dte_range(result: CaseResult) -> MeasuredRange:
    """Range of the DTE, m."""
    return MeasuredRange(result.point.scalars["dte_min"], result.point.scalars["dte_max"])


def penetration_range(result: CaseResult) -> MeasuredRange:
    """Range of the penetration, m; 0 where the shaft leaves its sleeve."""
    scalars = result.point.scalars
    return MeasuredRange(*(_at_least_0(scalars[f"{PENETRATION}_{kind}"]) for kind in ("min", "max")))


def _at_least_0(value: float) -> float:
    return value if math.isnan(value) else max(0.0, value)


def is_chaotic(result: CaseResult) -> bool:
    """Whether the motion is chaotic, and widely enough to show in a bifurcation diagram."""
    return result.regime == "chaotic" and result.point.scalars["section_spread"] >= VISIBLE_SPREAD


def onset_of_chaos(scan: Sequence[CaseResult]) -> float | None:
    """First speed in rpm from which on the motion is chaotic at every speed for LEAST_STRETCH.

    At least two speeds belong to the stretch, or all that are left. None if there is no such speed.
    """
    for index, result in enumerate(scan):
        speed = result.case.speed
        stretch = [other for other in scan[index:] if other.case.speed <= speed + LEAST_STRETCH]
        if len(stretch) < 2:
            stretch = list(scan[index : index + 2])
        if all(is_chaotic(other) for other in stretch):
            return speed
    return None


def first_back_flank(scan: Sequence[CaseResult]) -> CaseResult | None:
    """The first speed at which the teeth touch on the back flank, None if they never do."""
    return next((result for result in scan if result.point.scalars["back_share"] > 0.0), None)


def largest_back_flank(scan: Sequence[CaseResult]) -> CaseResult | None:
    """The speed with the largest share of time on the back flank, None if it is 0 throughout."""
    touching = [result for result in scan if result.point.scalars["back_share"] > 0.0]
    return max(touching, key=lambda result: result.point.scalars["back_share"], default=None)


def column(scan: Iterable[CaseResult], name: str) -> NDArray[np.float64]:
    """The scalar ``name`` along a scan, SI units, NaN where a run ended before."""
    return np.array([result.point.scalars[name] for result in scan])


def greatest_at(scan: Sequence[CaseResult], name: str) -> CaseResult | None:
    """Where along a scan the scalar ``name`` is greatest, None if it is nowhere known."""
    values = column(scan, name)
    return None if np.isnan(values).all() else scan[int(np.nanargmax(values))]


NumberMeasure = Callable[[PaperResults], float | None]


def _scalar(case: str, name: str, scale: float) -> NumberMeasure:
    return lambda results: scale * results.at(case).point.scalars[name]


def _speed(result: CaseResult | None) -> float | None:
    return None if result is None else result.case.speed


def _back_share(result: CaseResult | None) -> float | None:
    return None if result is None else PERCENT * result.point.scalars["back_share"]


def _least_drive_share(results: PaperResults) -> float:
    scan = results.scan(speed_scan("traditional"))
    named = (NAMED_CASES[f"traditional at {speed} rpm"].speed for speed in (2000, 2520))
    low, high = named
    return PERCENT * min(r.point.scalars["drive_share"] for r in scan if low <= r.case.speed <= high)


def _restitution_of_greatest(name: str) -> NumberMeasure:
    def measure(results: PaperResults) -> float | None:
        found = greatest_at(results.scan(RESTITUTION_SCAN), name)
        return None if found is None else found.case.restitution

    return measure


def _of_scan(model: str, act: Callable[[Sequence[CaseResult]], float | None]) -> NumberMeasure:
    return lambda results: act(results.scan(speed_scan(model)))


def _over_speed() -> dict[str, NumberMeasure]:
    measures: dict[str, NumberMeasure] = {"5c-3": _least_drive_share}
    for model in MODELS:
        measures |= {
            f"5a-{model[0]}": _of_scan(model, onset_of_chaos),
            f"5c-1/{model}": _scalar(f"{model} at 2000 rpm", "drive_share", PERCENT),
            f"5c-2/{model}": _scalar(f"{model} at 2520 rpm", "drive_share", PERCENT),
            f"5c-4/{model}": _of_scan(model, lambda scan: _speed(first_back_flank(scan))),
            f"5c-5/{model}": _of_scan(model, lambda scan: _back_share(first_back_flank(scan))),
        }
    for model in ("compared", "improved"):
        measures |= {
            f"5c-6/{model}/share": _of_scan(model, lambda scan: _back_share(largest_back_flank(scan))),
            f"5c-6/{model}/speed": _of_scan(model, lambda scan: _speed(largest_back_flank(scan))),
        }
    for speed in (9940, 11640):
        measures[f"5c-7/{speed}"] = _scalar(f"traditional at {speed} rpm", "back_share", PERCENT)
    return measures


def _film_lowers(results: PaperResults, name: str, scale: float) -> float:
    compared, improved = (
        results.at(f"{model} at 16500 rpm").point.scalars[name] for model in ("compared", "improved")
    )
    return scale * (compared - improved)


def _range_of(
    case: str, measure: Callable[[CaseResult], MeasuredRange], scale: float
) -> tuple[NumberMeasure, NumberMeasure]:
    return (
        lambda results: scale * measure(results.at(case)).least,
        lambda results: scale * measure(results.at(case)).greatest,
    )


def _of_cases() -> dict[str, NumberMeasure]:
    measures: dict[str, NumberMeasure] = {
        "6-5/penetration": lambda results: _film_lowers(results, f"{PENETRATION}_max", MICRO),
        "6-5/force": lambda results: _film_lowers(results, f"{FORCE}_max", 1.0),
        "8-1/largest": _restitution_of_greatest(f"{FORCE}_max"),
        "8-1/mean": _restitution_of_greatest(f"{FORCE}_mean"),
    }
    for model in MODELS:
        case = f"{model} at 16500 rpm"
        name = "6-1" if model == "traditional" else f"6-2/{model}"
        measures[f"{name}/min"], measures[f"{name}/max"] = _range_of(case, penetration_range, MICRO)
        measures[f"6-3/{model}"] = _scalar(case, f"{FORCE}_mean", 1.0)
        measures[f"6-4/{model}"] = _scalar(case, f"{FORCE}_max", 1.0)
    for name, case in {
        "7-1": "restitution 0.2",
        "7-2": "restitution 0.6",
        "7-3": "restitution 1",
        "9-1": "roughness 0.8 um",
        "9-2": "roughness 1.6 um",
        "9-3": "roughness 3.2 um",
        "9-4": "dimension 1.5",
        "9-5": "dimension 1.9",
    }.items():
        measures[f"{name}/min"], measures[f"{name}/max"] = _range_of(case, dte_range, MICRO)
    return measures


# By the id of the printed number; None where the runs do not show what is asked for.
MEASURES: Final[Mapping[str, NumberMeasure]] = {**_over_speed(), **_of_cases()}
