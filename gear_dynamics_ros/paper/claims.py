"""The claims of the paper's section 3 and its conclusions, each with the checks that judge it.

A claim holds if all of its checks do, it does not if none does, and it is mixed otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.paper.cases import (
    DIMENSIONS,
    MODELS,
    RESTITUTION_SCAN,
    RESTITUTIONS,
    ROUGHNESSES,
    speed_scan,
)
from gear_dynamics_ros.paper.measures import (
    FORCE,
    MICRO,
    PERCENT,
    MeasuredRange,
    column,
    dte_range,
    first_back_flank,
    greatest_at,
    is_chaotic,
    largest_back_flank,
    onset_of_chaos,
    penetration_range,
)
from gear_dynamics_ros.paper.results import CaseResult, PaperResults
from gear_dynamics_ros.paper.tooth_profiles import profiles_over_dimension, profiles_over_roughness
from gear_dynamics_ros.paper.waveforms import apart_share, lifts_per_period, loop_area, section_of
from gear_dynamics_ros.sweeps.point import spectrum_orders

MIXED: Final = "mixed"
MIDDLE_SPEEDS: Final = (6000.0, 12000.0)  # rpm, where the paper sees chaos and back flanks above all
CLEAR_SHARE: Final = 1e-3  # of the time on the back flank, that a figure shows
MOST_SPEEDS: Final = 0.9  # share of the speeds that counts as the whole range
FAR_FEWER: Final = 0.5  # of what is compared with
CLOSED_LOOP: Final = 0.01  # of the largest loop, below which a loop is a curve
SMALL_CHANGE: Final = 0.1  # of a quantity that hardly changes
SLIGHT_CHANGE: Final = 0.05
NEAR_RESTITUTION: Final = 0.03  # of the peaks of figure 8
GEAR: Final = "driving"  # gears and bearings are equal


class ClaimCheck(NamedTuple):
    """One part of a claim: what is compared, with its numbers, and whether it is as claimed."""

    text: str
    passed: bool


class Judgement(NamedTuple):
    """Whether a claim holds, and the numbers that say so."""

    holds: bool | str  # True, False or MIXED
    evidence: str


class Claim(NamedTuple):
    """A claim of the paper."""

    number: int
    text: str
    checks: Callable[[PaperResults], Sequence[ClaimCheck]]


def judge(checks: Sequence[ClaimCheck]) -> Judgement:
    """The judgement that all checks of a claim make together."""
    passed = [check.passed for check in checks]
    holds: bool | str = all(passed) or (MIXED if any(passed) else False)
    evidence = "; ".join(f"{check.text}: {'yes' if check.passed else 'no'}" for check in checks)
    return Judgement(holds, evidence)


def _scans(results: PaperResults) -> dict[str, list[CaseResult]]:
    return {model: results.scan(speed_scan(model)) for model in MODELS}


def _middle(scan: Sequence[CaseResult]) -> list[CaseResult]:
    low, high = MIDDLE_SPEEDS
    return [result for result in scan if low <= result.case.speed <= high]


def _chaotic_share(scan: Sequence[CaseResult]) -> float:
    return float(np.mean([is_chaotic(result) for result in scan]))


def _dte_length(scan: Sequence[CaseResult]) -> float:
    """Mean over a scan of the length of the range of DTE, um."""
    return MICRO * float(np.nanmean(column(scan, "dte_max") - column(scan, "dte_min")))


def _rpm(speed: float | None) -> str:
    return "none" if speed is None else f"{speed:.0f} rpm"


def _earlier(speed: float | None, other: float | None) -> bool:
    """Whether ``speed`` (rpm) exists and lies below ``other``, which may be missing."""
    return speed is not None and (other is None or speed < other)


def chaos_of_the_new_bearing(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 1."""
    scans = _scans(results)
    old, new = scans["traditional"], scans["compared"]
    begins = [onset_of_chaos(scan) for scan in (new, old)]
    shares = [PERCENT * _chaotic_share(scan) for scan in (new, old)]
    lengths = [_dte_length(scan) for scan in (new, old)]
    middle = [PERCENT * _chaotic_share(_middle(scan)) for scan in (new, old)]
    return [
        ClaimCheck(
            f"chaos begins at {_rpm(begins[0])} in compared, {_rpm(begins[1])} in traditional",
            _earlier(*begins),
        ),
        ClaimCheck(
            f"{shares[0]:.0f} % of the speeds are chaotic in compared, {shares[1]:.0f} %",
            shares[0] > shares[1],
        ),
        ClaimCheck(
            f"DTE ranges over {lengths[0]:.1f} µm in compared, {lengths[1]:.1f} µm in traditional (means)",
            lengths[0] > lengths[1],
        ),
        ClaimCheck(
            f"from 6000 to 12000 rpm {middle[0]:.0f} % against {middle[1]:.0f} % are chaotic",
            middle[0] > middle[1],
        ),
    ]


def order_by_the_film(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 2."""
    scans = _scans(results)
    with_film, without = scans["improved"], scans["compared"]
    shares = [PERCENT * _chaotic_share(scan) for scan in (with_film, without)]
    tamed = [
        a.case.speed
        for a, b in zip(with_film, without, strict=True)
        if is_chaotic(b) and not is_chaotic(a) and a.regime == "periodic"
    ]
    return [
        ClaimCheck(
            f"{shares[0]:.0f} % of the speeds are chaotic in improved, {shares[1]:.0f} % in compared",
            shares[0] < shares[1],
        ),
        ClaimCheck(f"at {len(tamed)} speeds chaos of compared is periodic with the film", bool(tamed)),
    ]


def fluctuation_of_dte(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 3."""
    lengths = {model: _dte_length(scan) for model, scan in _scans(results).items()}
    return [
        ClaimCheck(
            f"DTE ranges over {lengths[model]:.1f} µm in {model}, {lengths['traditional']:.1f} µm in "
            "traditional (means over speed)",
            lengths[model] > lengths["traditional"],
        )
        for model in ("compared", "improved")
    ]


def back_flanks(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 4."""
    scans = _scans(results)
    found = {model: first_back_flank(scan) for model, scan in scans.items()}
    first = {model: None if result is None else result.case.speed for model, result in found.items()}
    largest = {
        model: 0.0 if best is None else best.point.scalars["back_share"]
        for model, best in {
            "compared": largest_back_flank(_middle(scans["compared"])),
            "traditional": largest_back_flank([r for r in scans["traditional"] if r.case.speed >= 6000.0]),
        }.items()
    }
    return [
        *(
            ClaimCheck(
                f"back flanks first touch at {_rpm(first[model])} in {model}, "
                f"{_rpm(first['traditional'])} in traditional",
                _earlier(first[model], first["traditional"]),
            )
            for model in ("compared", "improved")
        ),
        ClaimCheck(
            f"largest share of compared from 6000 to 12000 rpm is {PERCENT * largest['compared']:.3f} %",
            largest["compared"] >= CLEAR_SHARE,
        ),
        ClaimCheck(
            f"largest share of traditional from 6000 rpm is {PERCENT * largest['traditional']:.3f} %",
            largest["traditional"] < CLEAR_SHARE,
        ),
    ]


def fluctuation_of_shares(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 5."""
    changes = {
        model: PERCENT * float(np.nanmean(np.abs(np.diff(column(scan, "drive_share")))))
        for model, scan in _scans(results).items()
    }
    return [
        ClaimCheck(
            f"from speed to speed the drive-flank share changes by {changes[model]:.2f} % in {model}, "
            f"{changes['traditional']:.2f} % in traditional (means)",
            changes[model] > changes["traditional"],
        )
        for model in ("compared", "improved")
    ]


def largest_mesh_force(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 6."""
    ldmf = {model: column(scan, "ldmf") for model, scan in _scans(results).items()}
    means = {model: float(np.nanmean(values)) for model, values in ldmf.items()}
    known = ~np.isnan(ldmf["improved"] + ldmf["compared"])
    lower = float(np.mean((ldmf["improved"] < ldmf["compared"])[known])) if known.any() else 0.0
    return [
        ClaimCheck(
            f"mean LDMF is {means['compared']:.2f} in compared, {means['traditional']:.2f} in traditional",
            means["compared"] > means["traditional"],
        ),
        ClaimCheck(
            f"mean LDMF is {means['improved']:.2f} with the film", means["improved"] < means["compared"]
        ),
        ClaimCheck(f"the film lowers it at {PERCENT * lower:.0f} % of the speeds", lower >= MOST_SPEEDS),
    ]


def regimes_with_bearing_and_film(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 7."""
    found = {model: results.at(f"{model} at 16500 rpm") for model in MODELS}
    lines = {model: MICRO * between_orders(result) for model, result in found.items()}
    expected = {"traditional": "periodic", "compared": "chaotic", "improved": "periodic"}
    return [
        *(
            ClaimCheck(f"{model} is {found[model].regime} at 16500 rpm", found[model].regime == regime)
            for model, regime in expected.items()
        ),
        ClaimCheck(
            f"between the orders DTE has {lines['compared']:.2f} µm (rms) in compared, "
            f"{lines['traditional']:.2f} µm in traditional",
            lines["compared"] > lines["traditional"],
        ),
        ClaimCheck(
            f"{lines['improved']:.2f} µm with the film", lines["improved"] < FAR_FEWER * lines["compared"]
        ),
    ]


def between_orders(result: CaseResult) -> float:
    """Root of the sum of squared amplitudes of DTE between the orders of the mesh frequency, m."""
    amplitudes = result.point.arrays["dte_spectrum"]
    orders = spectrum_orders(len(result.point.arrays["section_dte"]))
    between = (np.abs(orders - np.round(orders)) > ORDER_WIDTH) & (orders < 1.0)
    return float(np.sqrt(np.sum(amplitudes[between] ** 2)))


ORDER_WIDTH: Final = 0.03  # half width of a line at a whole order


def separation_from_the_sleeve(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 8."""
    ranges = {model: penetration_range(results.at(f"{model} at 16500 rpm")) for model in MODELS}
    means = {
        model: MICRO * results.at(f"{model} at 16500 rpm").point.scalars["driving_penetration_mean"]
        for model in MODELS
    }
    old = ranges["traditional"]
    checks = [ClaimCheck(f"least penetration of traditional is {MICRO * old.least:.2f} µm", old.least > 0.0)]
    for model in ("compared", "improved"):
        samples = results.waveforms.get(f"{model} at 16500 rpm")
        apart = PERCENT * apart_share(samples, GEAR) if samples else 0.0
        lifts = lifts_per_period(samples, GEAR) if samples else 0.0
        checks += [
            ClaimCheck(
                f"{model} is apart for {apart:.1f} % of the time, {lifts:.2f} times a mesh period",
                ranges[model].least <= 0.0,
            ),
            ClaimCheck(
                f"mean penetration is {means['traditional']:.2f} µm in traditional, {means[model]:.2f} µm in "
                f"{model}",
                means["traditional"] > means[model],
            ),
            ClaimCheck(
                f"it ranges over {MICRO * old.length:.2f} µm and {MICRO * ranges[model].length:.2f} µm",
                old.length < ranges[model].length,
            ),
        ]
    return checks


def hysteresis(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 9."""
    waveforms = [results.waveforms.get(f"restitution {eta:g}") for eta in RESTITUTIONS]
    areas = [float("nan") if samples is None else 1e3 * loop_area(samples, GEAR) for samples in waveforms]
    texts = ", ".join(f"{area:.4f}" for area in areas)
    return [
        ClaimCheck(
            f"at eta 0.2, 0.6, 1 the loop encloses {texts} mJ a mesh period",
            _falls(areas),
        ),
        ClaimCheck(
            f"at eta 1 it encloses {abs(areas[-1]):.6f} mJ, which is next to nothing",
            abs(areas[-1]) < CLOSED_LOOP * areas[0],
        ),
    ]


def _falls(values: Sequence[float]) -> bool:
    return bool(np.all(np.diff(values) < 0.0))


def _rises(values: Sequence[float]) -> bool:
    return bool(np.all(np.diff(values) > 0.0))


def _list(values: Sequence[float], digits: int = 2) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def dispersion_with_restitution(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 10."""
    found = [results.at(f"restitution {eta:g}") for eta in RESTITUTIONS]
    lengths = [MICRO * dte_range(result).length for result in found]
    spreads = [MICRO * result.point.scalars["section_spread"] for result in found]
    lines = [MICRO * between_orders(result) for result in found]
    etas = ", ".join(f"{eta:g}" for eta in RESTITUTIONS)
    return [
        ClaimCheck(f"DTE ranges over {_list(lengths)} µm at eta {etas}", _rises(lengths)),
        ClaimCheck(f"the Poincaré points spread over {_list(spreads)} µm", _rises(spreads)),
        ClaimCheck(f"below the mesh frequency DTE has {_list(lines)} µm (rms)", _rises(lines)),
    ]


def forces_over_restitution(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 11."""
    scan = results.scan(RESTITUTION_SCAN)
    apart = [r.case.restitution or 0.0 for r in scan if r.point.scalars[f"{FORCE}_min"] == 0.0]
    span = f"{len(apart)} of {len(scan)} eta" + (f", from {apart[0]:g} to {apart[-1]:g}" if apart else "")
    checks = [ClaimCheck(f"the least bearing force is 0 at {span}", bool(apart))]
    for kind, name in (("largest", "max"), ("mean", "mean")):
        best = greatest_at(scan, f"{FORCE}_{name}")
        eta = None if best is None else best.case.restitution
        near = eta is not None and abs(eta - 0.08) <= NEAR_RESTITUTION
        checks.append(ClaimCheck(f"the {kind} force peaks at eta {eta}", near))
    return checks


def effect_of_roughness(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 12."""
    names = [f"roughness {1e6 * roughness:g} um" for roughness in ROUGHNESSES]
    found = [results.at(name) for name in names]
    lengths = [MICRO * dte_range(result).length for result in found]
    angles = [_angle_spread(results, name) for name in names]
    return [
        ClaimCheck(f"DTE ranges over {_list(lengths)} µm at Ra 0.8, 1.6, 3.2 µm", _rises(lengths)),
        ClaimCheck(f"the motion at Ra 0.8 µm is {found[0].regime}", found[0].regime == "periodic"),
        ClaimCheck(f"that at Ra 3.2 µm is {found[-1].regime}", found[-1].regime == "chaotic"),
        ClaimCheck(f"the pressure angle at mesh phase 0 spreads over {_list(angles, 4)} deg", _rises(angles)),
    ]


def _angle_spread(results: PaperResults, name: str) -> float:
    """Spread of the pressure angle at mesh phase 0, deg."""
    samples = results.waveforms.get(name)
    return (
        float("nan") if samples is None else float(np.rad2deg(np.ptp(section_of(samples, "pressure_angle"))))
    )


def effect_of_dimension(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 13."""
    found = [results.at(f"dimension {dimension:g}") for dimension in DIMENSIONS]
    ranges = [dte_range(result) for result in found]
    lengths = [MICRO * length.length for length in ranges]
    spreads = [MICRO * result.point.scalars["section_spread"] for result in found]
    rough = [dte_range(results.at(f"roughness {1e6 * roughness:g} um")) for roughness in ROUGHNESSES]
    by_dimension, by_roughness = (PERCENT * _change(values) for values in (ranges, rough))
    regimes = [str(result.regime) for result in found]
    return [
        ClaimCheck(
            f"DTE ranges over {_list(lengths)} µm at D 1.1, 1.5, 1.9",
            lengths[-1] < lengths[0] and abs(by_dimension) < PERCENT * SLIGHT_CHANGE,
        ),
        ClaimCheck(f"the Poincaré points spread over {_list(spreads)} µm", _rises(spreads)),
        ClaimCheck(f"the motion is {', '.join(regimes)}", set(regimes) == {"periodic"}),
        ClaimCheck(
            f"over D the range changes by {by_dimension:.1f} %, over Ra by {by_roughness:.1f} %",
            abs(by_roughness) > abs(by_dimension),
        ),
    ]


def _change(ranges: Sequence[MeasuredRange]) -> float:
    """Relative change of the length from the first to the last."""
    return ranges[-1].length / ranges[0].length - 1.0


def shape_of_the_profile(results: PaperResults) -> Sequence[ClaimCheck]:
    """Claim 14."""
    parameters = results.parameter_set.parameters
    rough, fractal = profiles_over_roughness(parameters), profiles_over_dimension(parameters)
    heights = [MICRO * profile.peak_height for profile in rough]
    counts = [profile.peaks_per_tooth for profile in fractal]
    other_counts = [profile.peaks_per_tooth for profile in rough]
    other_heights = [MICRO * profile.peak_height for profile in fractal]
    return [
        ClaimCheck(f"peaks are {_list(heights)} µm high at Ra 0.8, 1.6, 3.2 µm", _rises(heights)),
        ClaimCheck(f"their number is {_list(other_counts, 1)} a tooth", _hardly_changes(other_counts)),
        ClaimCheck(f"their number is {_list(counts, 1)} a tooth at D 1.1, 1.5, 1.9", _rises(counts)),
        ClaimCheck(f"they are {_list(other_heights)} µm high", _hardly_changes(other_heights)),
    ]


def _hardly_changes(values: Sequence[float]) -> bool:
    known: NDArray[np.float64] = np.array(values)
    return bool(np.ptp(known) <= SMALL_CHANGE * known[0])


CLAIMS: Final[tuple[Claim, ...]] = (
    Claim(
        1,
        "With the new bearing model chaos begins at a lower speed than in the traditional one; its chaotic "
        "region is larger and its amplitudes are greater, above all between 6000 and 12000 rpm.",
        chaos_of_the_new_bearing,
    ),
    Claim(
        2,
        "The film narrows the chaotic region again; some regions turn from chaotic to multi-periodic.",
        order_by_the_film,
    ),
    Claim(3, "DTE fluctuates more in compared and improved than in traditional.", fluctuation_of_dte),
    Claim(
        4,
        "Back-flank contact begins at lower speeds in compared and improved than in traditional; compared "
        "shows it clearly between 6000 and 12000 rpm; traditional hardly at all between 6000 and 18000 rpm.",
        back_flanks,
    ),
    Claim(
        5,
        "Shares of meshing and separation fluctuate more with speed in compared and improved than in "
        "traditional.",
        fluctuation_of_shares,
    ),
    Claim(
        6,
        "The new bearing model raises LDMF to some extent; the film lowers it over the whole speed range.",
        largest_mesh_force,
    ),
    Claim(
        7,
        "At 16500 rpm traditional is periodic, compared chaotic, improved periodic again; compared has "
        "subharmonics, far fewer with the film.",
        regimes_with_bearing_and_film,
    ),
    Claim(
        8,
        "At 16500 rpm traditional never separates from its sleeve; compared and improved do, often. "
        "Traditional's penetration is larger but varies less.",
        separation_from_the_sleeve,
    ),
    Claim(
        9,
        "The hysteresis loop of bearing force over penetration shrinks as the restitution grows and is a "
        "curve at 1.",
        hysteresis,
    ),
    Claim(
        10,
        "The range of DTE and the spread of the Poincaré points grow with the restitution; subharmonics "
        "appear.",
        dispersion_with_restitution,
    ),
    Claim(
        11,
        "In some stretches of the restitution the least bearing force is zero; largest and mean force peak "
        "near 0.08.",
        forces_over_restitution,
    ),
    Claim(
        12,
        "The range of DTE grows with roughness; the motion goes from periodic to chaotic by Ra 3.2 µm; the "
        "pressure angle goes with it.",
        effect_of_roughness,
    ),
    Claim(
        13,
        "Fractal dimension hardly matters: the range of DTE falls slightly, the trajectory thickens, the "
        "motion stays periodic. Roughness matters more than dimension.",
        effect_of_dimension,
    ),
    Claim(
        14,
        "At one fractal dimension the peaks of the profile grow with roughness while their number does not; "
        "at one roughness the number of peaks grows with the dimension while their height hardly does.",
        shape_of_the_profile,
    ),
)
