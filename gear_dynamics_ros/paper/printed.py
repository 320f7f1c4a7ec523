"""Every number that the paper's section 3 prints, as data, in its own units: um, N, %, rpm."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

from gear_dynamics_ros.paper.cases import MODELS, RESTITUTION_SCAN, speed_scan


class Comparability(StrEnum):
    """How a printed number can be compared with a computed one."""

    YES = "yes"
    ORDER_OF_MAGNITUDE = "order of magnitude"
    NO = "no"


class PrintedNumber(NamedTuple):
    """One number of the paper."""

    id: str
    where: str  # figure and conditions
    quantity: str
    unit: str
    printed: float
    case: str  # named case or scan that gives it
    comparable: Comparability = Comparability.YES
    reason: str = ""  # why it can't be compared, or in magnitude only
    scale: float = 0.0  # what a difference is measured against; 0: the printed number itself


_YES, _ORDER, _NO = Comparability
_CHAOTIC: Final = "the motion is chaotic there, and such a share rests on a few moments of a run"
_ONSETS: Final = (("5a-t", "traditional", 5340.0), ("5a-c", "compared", 3575.0), ("5a-i", "improved", 5725.0))
_DRIVE_SHARES: Final = {
    ("5c-1", 2000): (100.0, 97.9406, 98.7719),
    ("5c-2", 2520): (100.0, 87.8189, 86.3783),
}
_BACK_SPEEDS: Final = (8740.0, 5350.0, 6750.0)
_BACK_SHARES: Final = (0.0266, 0.0015, 0.7406)
_PENETRATIONS: Final = {
    "traditional": ("6-1", 4.3875, 6.0145),
    "compared": ("6-2/compared", 0.0, 2.3108),
    "improved": ("6-2/improved", 0.0, 1.7165),
}
_MEAN_FORCES: Final = (519.1513, 374.1020, 353.5846)
_LARGEST_FORCES: Final = (604.0786, 1956.5671, 1121.2492)
_DTE_RANGES: Final = (
    ("7-1", "fig 7, 15000 rpm, restitution 0.2", "restitution 0.2", 17.4948, 40.2586),
    ("7-2", "fig 7, 15000 rpm, restitution 0.6", "restitution 0.6", 16.6860, 41.0608),
    ("7-3", "fig 7, 15000 rpm, restitution 1.0", "restitution 1", 12.4809, 43.8921),
    ("9-1", "fig 9, 15500 rpm, Ra 0.8 um, D 1.1", "roughness 0.8 um", 17.7342, 39.9415),
    ("9-2", "fig 9, 15500 rpm, Ra 1.6 um, D 1.1", "roughness 1.6 um", 17.7285, 42.0288),
    ("9-3", "fig 9, 15500 rpm, Ra 3.2 um, D 1.1", "roughness 3.2 um", 17.4548, 45.5643),
    ("9-4", "fig 9, 15500 rpm, Ra 0.8 um, D 1.5", "dimension 1.5", 17.3602, 39.9969),
    ("9-5", "fig 9, 15500 rpm, Ra 0.8 um, D 1.9", "dimension 1.9", 17.6256, 39.0442),
)


def _over_speed() -> list[PrintedNumber]:
    numbers = [
        PrintedNumber(name, "fig 5a", f"first chaotic speed, {model}", "rpm", value, speed_scan(model))
        for name, model, value in _ONSETS
    ]
    for (name, speed), values in _DRIVE_SHARES.items():
        numbers += [
            PrintedNumber(
                f"{name}/{model}",
                f"fig 5c, {speed} rpm",
                f"share of time on the drive flank, {model}",
                "%",
                value,
                f"{model} at {speed} rpm",
            )
            for model, value in zip(MODELS, values, strict=True)
        ]
    numbers.append(
        PrintedNumber(
            "5c-3",
            "fig 5c, 2000 to 2520 rpm",
            "least share of time on the drive flank, traditional",
            "%",
            100.0,
            speed_scan("traditional"),
        )
    )
    for model, first_speed, share in zip(MODELS, _BACK_SPEEDS, _BACK_SHARES, strict=True):
        scan = speed_scan(model)
        first = f"first speed with back-flank contact, {model}"
        there = f"share of time on the back flank there, {model}"
        numbers += [
            PrintedNumber(f"5c-4/{model}", "fig 5c", first, "rpm", first_speed, scan),
            PrintedNumber(f"5c-5/{model}", "fig 5c", there, "%", share, scan, _ORDER, _CHAOTIC),
        ]
    for model, share, largest_speed in (("compared", 1.6718, 6250.0), ("improved", 0.7406, 6750.0)):
        scan = speed_scan(model)
        largest = f"largest share of time on the back flank, {model}"
        numbers += [
            PrintedNumber(f"5c-6/{model}/share", "fig 5c", largest, "%", share, scan),
            PrintedNumber(
                f"5c-6/{model}/speed", "fig 5c", f"speed of the {largest}", "rpm", largest_speed, scan
            ),
        ]
    numbers += [
        PrintedNumber(
            f"5c-7/{speed}",
            f"fig 5c, {speed} rpm",
            "share of time on the back flank, traditional",
            "%",
            share,
            f"traditional at {speed} rpm",
            _ORDER,
            _CHAOTIC,
        )
        for speed, share in ((9940, 0.0406), (11640, 0.0297))
    ]
    return numbers


def _at_film_speed() -> list[PrintedNumber]:
    where = "fig 6, 16500 rpm"
    numbers = []
    for model, (name, least, largest) in _PENETRATIONS.items():
        case = f"{model} at 16500 rpm"
        numbers += [
            PrintedNumber(
                f"{name}/min", where, f"least penetration, {model}", "um", least, case, scale=least or largest
            ),
            PrintedNumber(f"{name}/max", where, f"largest penetration, {model}", "um", largest, case),
        ]
    for model, mean, largest in zip(MODELS, _MEAN_FORCES, _LARGEST_FORCES, strict=True):
        case = f"{model} at 16500 rpm"
        impossible = model == "compared"
        numbers += [
            PrintedNumber(
                f"6-3/{model}",
                where,
                f"mean bearing contact force, {model}",
                "N",
                mean,
                case,
                _NO if impossible else _YES,
                "without a film the mean force can't lie below T_M / r_b" if impossible else "",
            ),
            PrintedNumber(
                f"6-4/{model}", where, f"largest bearing contact force, {model}", "N", largest, case
            ),
        ]
    film = "the film lowers the largest"
    case = "improved at 16500 rpm"
    numbers += [
        PrintedNumber("6-5/penetration", where, f"{film} penetration by", "um", 0.5943, case),
        PrintedNumber("6-5/force", where, f"{film} bearing contact force by", "N", 835.3179, case),
    ]
    return numbers


def _of_one_model() -> list[PrintedNumber]:
    numbers = []
    for name, where, case, least, largest in _DTE_RANGES:
        numbers += [
            PrintedNumber(f"{name}/min", where, "least DTE", "um", least, case),
            PrintedNumber(f"{name}/max", where, "largest DTE", "um", largest, case),
        ]
    for name, kind in (("largest", "largest"), ("mean", "mean")):
        quantity = f"restitution at which the {kind} bearing contact force is greatest"
        numbers.append(
            PrintedNumber(f"8-1/{name}", "fig 8, 15000 rpm", quantity, "1", 0.08, RESTITUTION_SCAN)
        )
    return sorted(numbers, key=lambda number: number.id)


PRINTED_NUMBERS: Final[tuple[PrintedNumber, ...]] = (*_over_speed(), *_at_film_speed(), *_of_one_model())
